"""Our own source files: which there are, what they hold, and what this process has executed of them.

Which files are ours follows from the package's folder itself. What a module does in this process is
decided by the text that it was executed from, not by the file as it stands now: a worker lives on while somebody
edits, and a command may have been started just before. So every module of ours is recorded as it is imported, and
that record is what keys are made from.

Python takes compiled code for good as long as the source's size and whole second of change agree, so that an edit
within the second, or one copied with its times, would execute the code of before. Here compiled code counts only
when it was written after the source was last touched (ctime, which no copy preserves).
"""

import functools
import importlib.util
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

from lightstage.store.digest import digest_bytes, digest_value

PACKAGE = __name__.partition(".")[0]
ROOT = Path(__file__).parent.parent
"""The package's folder: in a checkout one of links to the folders at the top of the repository."""
ENGINE = ("dag", "store")
"""What hands data to kernels and takes it back, wherever they run."""


@dataclass(frozen=True)
class Sources:
    """All our files at one moment. Two that are equal mean that none was touched between them."""

    digests: Mapping[str, str]
    """Path below the root -> digest of its bytes."""
    stamps: tuple[tuple[int, ...], ...]

    @property
    def digest(self) -> str:
        """Of all of them."""
        return digest_value(dict(self.digests))


def read_sources(root: Path = ROOT) -> Sources:
    """Every file below a folder, in all folders; data files too, and of Python's own only what is compiled."""
    digests, stamps = {}, []
    for path in _files(root, ()):
        with open(path, "rb") as file:
            status = os.fstat(file.fileno())
            digests[os.path.relpath(path, root)] = digest_bytes(file.read())
        stamps.append((status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns))
    return Sources(digests, tuple(stamps))


def _files(folder: str | Path, around: Sequence[tuple[int, int]]) -> Iterator[str]:
    status = os.stat(folder)
    place = (status.st_dev, status.st_ino)
    if place in around:
        return  # a link to a folder around it
    for entry in sorted(os.scandir(folder), key=lambda item: item.name):
        if entry.is_dir():
            if entry.name != "__pycache__":
                yield from _files(entry.path, (*around, place))
        elif entry.is_file():
            yield entry.path


_executed: dict[str, bytes] = {}
_imports: list[str] = []


def generation() -> int:
    """Changes whenever a module of ours has been executed: what was said of this process has to be said anew."""
    return len(_imports)


def source(module: str) -> bytes:
    """What a module was executed from, or, when it was not yet, what it would be executed from now.

    Raises:
        ModuleNotFoundError: it is no Python file.
    """
    text = _executed.get(module)
    if text is None:
        path = module_file(module)
        if path is None:
            raise ModuleNotFoundError(f"the source of {module} cannot be found, so it cannot be in a key")
        text = path.read_bytes()
    return text


def module_file(name: str) -> Path | None:
    """Where a module lies, None where there is none. Python's own finder would import what is around it."""
    top, _, below = name.partition(".")
    spec = importlib.util.find_spec(top)
    if spec is None:
        return None
    if not below:
        return None if spec.origin is None else Path(spec.origin)
    for folder in spec.submodule_search_locations or ():
        plain = os.path.join(folder, *below.split("."))
        for file in (f"{plain}.py", f"{plain}/__init__.py"):
            if os.path.isfile(file):
                return Path(file)
    return None


def outdated(sources: Sources) -> list[str]:
    """The modules that this process executed from another text than the files had."""
    return [
        module
        for module, text in sorted(_executed.items())
        if sources.digests.get(_file(module), digest_bytes(text)) != digest_bytes(text)
    ]


def _file(module: str) -> str:
    path = module.removeprefix(f"{PACKAGE}.").replace(".", "/")
    return f"{path}/__init__.py" if hasattr(sys.modules.get(module), "__path__") else f"{path}.py"


def engine() -> str:
    """Digest of the engine and of what it stores with, as this process executes them."""
    return _engine(generation())


@functools.cache
def _engine(_generation: int) -> str:
    texts = {}
    for package in ENGINE:
        for path in _files(ROOT / package, ()):
            name = os.path.relpath(path, ROOT)
            module = name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
            text = _executed.get(f"{PACKAGE}.{module}")
            texts[name] = digest_bytes(Path(path).read_bytes() if text is None else text)
    return digest_value(texts)


def _record(module: str, text: bytes) -> None:
    _executed[module] = text
    _imports.append(module)


class _Loader(SourceFileLoader):
    """Executes a module of ours, and records the text that it was executed from."""

    def get_code(self, fullname: str) -> CodeType | None:
        """The code of the file's present text."""
        path = self.get_filename(fullname)
        text = self.get_data(path)
        code = None
        if _compiled_since(path):
            code = super().get_code(fullname)
            if self.get_data(path) != text:
                code = None  # edited between the two readings
        if code is None:
            code = self.source_to_code(text, path)
        _record(fullname, text)
        return code


def _compiled_since(path: str) -> bool:
    """Whether compiled code may be used: it was written after the source, or there is none, or it could go."""
    compiled = importlib.util.cache_from_source(path)
    try:
        if os.stat(compiled).st_ctime_ns <= os.stat(path).st_ctime_ns:
            os.unlink(compiled)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return True


class _Finder:
    """Finds modules of ours where Python would."""

    @classmethod
    def find_spec(
        cls, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The usual finder's answer, with the loader that records."""
        if name.partition(".")[0] != PACKAGE:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and type(spec.loader) is SourceFileLoader:
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
        return spec


def record_imports() -> None:
    """Record every module of ours from now on, and those that are here already by their files."""
    if _Finder in sys.meta_path:
        return
    # before the usual finder only: whoever stands further ahead, such as a test runner, wants to be asked first
    sys.meta_path.insert(sys.meta_path.index(PathFinder), _Finder)
    for module in list(sys.modules.values()):
        spec = getattr(module, "__spec__", None)
        if spec is not None and spec.name.partition(".")[0] == PACKAGE and type(spec.loader) is SourceFileLoader:
            _record(spec.name, Path(spec.loader.path).read_bytes())
