"""Where compiled code is kept: numba's cache, outside of the installation and right whoever shares it.

The package calls `keep` before numba is imported; from then on numba asks `Place` for each of its functions. The
code goes to $NUMBA_CACHE_DIR where that is set, else to the user's cache folder, else below the store, else
nowhere. numba's own cache has one index a function, which two processes overwrite for each other, and knows only
the function's own file; here each compiled function is a file of its own, named by all that decides its code:

    numba, LLVM, Python and numba's settings
    the processor and its features, the types, the function's bytecode (numba's key)
    the source of the function's module and of the modules of ours that it imports, whose constants and
    functions are compiled into it

and the file tells by its own digest when it is damaged. It is executed, so what another user has written is not
read. Whatever is wrong with a file, the function is compiled anew.
"""

import os
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

_OURS = f"{__package__}."
_STORE = "LIGHTSTAGE_COMPILED"
_HOOK = "NUMBA_CACHE_LOCATOR_CLASSES"
_LOCATORS = f"{__name__}.Place,UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator"
_NO_MATTER = ("NUMBA_CACHE", "NUMBA_DEBUG", "NUMBA_DUMP", "NUMBA_NUM_THREADS")
"""Settings of numba's that change no code begin like this."""
_DIGEST = 32
_UNUSED_DAYS = 90
"""After which a file is removed."""


def keep() -> None:
    """Let numba ask `Place` first."""
    if __name__ not in os.environ.get(_HOOK, ""):
        os.environ[_HOOK] = _LOCATORS
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_LOCATOR_CLASSES = os.environ[_HOOK]


def offer(store: "str | Path") -> None:
    """Name the store below which code may be kept where the user has no cache folder; for this process and those
    that it starts."""
    if "\0" not in str(store):  # which no folder is called, and the store says so
        os.environ[_STORE] = os.path.abspath(store)


def folder() -> Path | None:
    """Where compiled code is kept, or None where nothing can be written."""
    given, store = os.environ.get("NUMBA_CACHE_DIR"), os.environ.get(_STORE)
    users = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    candidates = [given] if given else []
    if os.path.isabs(users):
        candidates.append(os.path.join(users, "lightstage"))
    if store and os.path.exists(os.path.join(store, "store.json")):
        candidates.append(os.path.join(store, "compiled"))
    return _first_writable(tuple(candidates))


@cache
def _first_writable(candidates: tuple[str, ...]) -> Path | None:
    for candidate in candidates:
        try:
            os.makedirs(candidate, exist_ok=True)
        except OSError:
            continue
        if os.access(candidate, os.W_OK | os.X_OK):
            return Path(candidate)
    return None


class Place:
    """One function's place: what numba calls a locator."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._py_file = file  # numba says it where a function cannot be kept
        self._line = function.__code__.co_firstlineno
        self.source = _source(function.__module__)

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> "Place | None":
        """The place of a function of ours; None for another's, so that numba asks its own locators."""
        if not function.__module__.startswith(_OURS) or function.__module__ not in sys.modules:
            return None
        _use_own_files()
        return cls(function, file)

    def ensure_cache_path(self) -> None:
        """Nothing: `folder` has."""

    def get_cache_path(self) -> str:
        """The folder."""
        return str(folder() or "")

    def get_source_stamp(self) -> "Place":
        """numba hands it to `Code`."""
        return self

    def get_disambiguator(self) -> str:
        """What parts two functions of one name."""
        return str(self._line)


class Code:
    """The compiled code of one function, a file for each processor and set of types; numba loads and saves."""

    def __init__(self, name: str, source: str) -> None:
        self._name, self._source = name, source

    def load(self, key: Any) -> Any:
        """What was saved under a key; None when nothing whole of our own is there."""
        import hashlib
        import pickle
        import time

        path = self._path(key)
        if path is None:
            return None
        try:
            with open(path, "rb") as file:
                found = os.fstat(file.fileno())
                content = file.read()
            if time.time() - found.st_mtime > 86400:
                os.utime(path)
        except OSError:
            return None
        body = memoryview(content)[_DIGEST:]
        if found.st_uid != os.geteuid() or hashlib.sha256(body).digest() != content[:_DIGEST]:
            return None
        return pickle.loads(body)

    def save(self, key: Any, data: Any) -> None:
        """Keep compiled code, if that can be."""
        import contextlib
        import hashlib
        import tempfile

        from numba.core.serialize import dumps

        path = self._path(key)
        if path is None:
            return
        body = dumps(data)
        temporary = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _remove_unused(path.parent)
            descriptor, temporary = tempfile.mkstemp(prefix=".", suffix=".part", dir=path.parent)
            with open(descriptor, "wb") as file:
                file.write(hashlib.sha256(body).digest() + body)
            os.replace(temporary, path)
        except OSError:  # a full disk must not stop the work
            if temporary is not None:
                with contextlib.suppress(OSError):
                    os.unlink(temporary)

    def flush(self) -> None:
        """Nothing: what is stale has another name."""

    def _path(self, key: Any) -> Path | None:
        import hashlib

        import llvmlite
        import numba

        kept = folder()
        settings = sorted(
            f"{name}={value}"
            for name, value in os.environ.items()
            if name.startswith("NUMBA_") and not name.startswith(_NO_MATTER)
        )
        decides = repr((numba.__version__, llvmlite.__version__, sys.version, settings, self._source, key))
        if kept is None or " at 0x" in decides:  # an address: the key is of this process alone
            return None
        return kept / f"{self._name}-{hashlib.sha256(decides.encode()).hexdigest()[:32]}.nbc"


def _use_own_files() -> None:
    """Let numba's cache make `Code` for what lies in a `Place`."""
    from numba.core import caching

    theirs = caching.IndexDataCacheFile
    if getattr(theirs, "of_lightstage", False):
        return

    def files(cache_path: str, filename_base: str, source_stamp: Any) -> Any:
        if isinstance(source_stamp, Place):
            return Code(filename_base, source_stamp.source)
        return theirs(cache_path=cache_path, filename_base=filename_base, source_stamp=source_stamp)

    files.of_lightstage = True  # type: ignore[attr-defined]
    caching.IndexDataCacheFile = files


def _source(module: str) -> str:
    """Digest of the source of a module and of those of ours that it imports."""
    import hashlib

    closure: set[str] = set()
    pending = [module]
    while pending:
        name = pending.pop()
        if name not in closure:
            closure.add(name)
            pending += _imports(name)
    digest = hashlib.sha256()
    for name in sorted(closure):
        digest.update(name.encode() + hashlib.sha256(_text(name)).digest())
    return digest.hexdigest()


@cache
def _text(module: str) -> bytes:
    file = sys.modules[module].__file__
    return Path(file).read_bytes() if file is not None else b""


@cache
def _imports(module: str) -> tuple[str, ...]:
    """The modules of ours that a module has imported."""
    import ast

    def named() -> Iterator[str]:
        for node in ast.walk(parsed(_text(module))):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = [*module.split(".")[: -node.level], *([node.module] if node.module else [])]
                name = ".".join(base) if node.level else str(node.module)
                yield name
                yield from (f"{name}.{alias.name}" for alias in node.names)

    found = {name for name in named() if name.startswith(_OURS) and name in sys.modules}
    return tuple(sorted(found))


_PARSINGS = 20


def parsed(text: "str | bytes") -> Any:
    """The syntax tree. Until Python 3.11.8 and 3.12.2 one thread's parsing may fail because of another's."""
    import ast

    for _ in range(_PARSINGS):
        try:
            return ast.parse(text)
        except SystemError:
            continue
    return ast.parse(text)


@cache
def _remove_unused(where: Path) -> None:
    """Remove what nobody has used for long; once a process."""
    import contextlib
    import time

    before = time.time() - _UNUSED_DAYS * 86400
    for path in where.iterdir():
        with contextlib.suppress(OSError):
            if path.suffix in (".nbc", ".json", ".part") and path.stat().st_mtime < before:
                path.unlink()
