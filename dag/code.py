"""What a module's code is, for keys: its syntax tree, that of every module of ours that it imports, and libraries.

To parse a hundred modules takes most of a second, so what was found of a text is kept in a file beside compiled
code (`compiled.folder`), by the text's digest; whoever cannot write there parses again.
"""

import ast
import contextlib
import functools
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lightstage import compiled
from lightstage.dag.sources import ENGINE as ENGINE_PACKAGES
from lightstage.dag.sources import PACKAGE, generation, module_file, source
from lightstage.store.digest import digest_bytes, digest_value
from lightstage.store.errors import DamagedFileError
from lightstage.store.sealed import seal, unseal

NUMERIC: Mapping[str, str] = {
    "colour": "colour-science",
    "cv2": "opencv-contrib-python-headless",
    "numba": "numba",
    "numpy": "numpy",
    "pyamg": "pyamg",
    "scipy": "scipy",
    "skimage": "scikit-image",
}
"""Import name -> distribution, of the libraries that decide numbers."""

SILENT = frozenset({"pydantic", "yaml"})
"""Libraries that a stage may import and that decide none."""

_ENGINE = tuple(f"{PACKAGE}.{name}." for name in ENGINE_PACKAGES)
"""What a stage imports of these is its contract, which cannot change numbers."""

_ANNOTATIONS = {"annotation", "returns", "type_comment", "type_params"}


def code_digest(source: str | bytes) -> str:
    """Digest of what a module does: its syntax tree without docstrings, comments, formatting and annotations.

    The text form is our own, because Python's `ast.dump` differs between versions.
    """
    return digest_bytes(_text(_without_docstrings(compiled.parsed(source))).encode())


def _without_docstrings(tree: ast.AST) -> ast.AST:
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list) and isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            # a text that stands alone, also behind an assignment, says something and does nothing
            node.body = [item for item in body if not _is_text(item)]
    return tree


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _text(node: Any) -> str:
    if isinstance(node, ast.AnnAssign) and node.value is None:
        return f"declare({_text(node.target)})"
    if isinstance(node, ast.AST):
        fields = [
            f"{name}={_text(value)}"
            for name, value in ast.iter_fields(node)
            if name not in _ANNOTATIONS and name not in ("ctx", "kind") and value is not None and value != []
        ]
        return f"{type(node).__name__}({','.join(fields)})"
    if isinstance(node, list):
        return f"[{','.join(_text(item) for item in node)}]"
    return repr(node)


def _imports(tree: ast.AST, module: str) -> Iterator[tuple[str, str]]:
    """What a module imports, wherever in it the import stands."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")[: -node.level]
                base = ".".join([*parts, *([base] if base else [])])
            yield from ((base, alias.name) for alias in node.names)


def module_code(modules: Sequence[str]) -> Mapping[str, str]:
    """Digest of the code of modules and of the modules of ours that they import, by module name."""
    return _module_code(tuple(modules), generation())


@functools.cache
def _module_code(modules: tuple[str, ...], _generation: int) -> Mapping[str, str]:
    digests: dict[str, str] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name not in digests:
            digests[name] = _facts(name).digest
            waiting += [imported for imported in _imports_of(name) if _counts(imported, name)]
    return dict(sorted(digests.items()))


def module_libraries(modules: Sequence[str]) -> Mapping[str, str]:
    """Versions of the numeric libraries that modules and those of ours that they call import.

    Raises:
        ModuleNotFoundError: one of them imports a library of which nobody has said whether it decides numbers.
    """
    return _module_libraries(tuple(modules), generation())


@functools.cache
def _module_libraries(modules: tuple[str, ...], _generation: int) -> Mapping[str, str]:
    used = set()
    for module in module_code(modules):
        imported = {name.split(".")[0] for name in _imports_of(module)}
        strange = imported - {module.split(".")[0], PACKAGE} - SILENT - sys.stdlib_module_names - set(NUMERIC)
        if strange:
            raise ModuleNotFoundError(
                f"{module} imports {', '.join(sorted(strange))}, which is neither in NUMERIC nor in SILENT of "
                "dag/code.py, so it cannot be in a key"
            )
        used |= imported & set(NUMERIC)
    if "numba" in used:
        used.add("scipy")  # whose LAPACK numba's linear algebra calls
    return {NUMERIC[name]: _version(NUMERIC[name]) for name in sorted(used)}


@functools.cache
def _version(distribution: str) -> str:
    # by its folder's name: `importlib.metadata` alone takes a fifth of a short command's time
    wanted = re.compile(rf"{re.sub('[-_.]', '[-_.]', distribution)}-([^-]+)\.dist-info", re.IGNORECASE)
    for folder in sys.path:
        with contextlib.suppress(OSError):
            for name in sorted(os.listdir(folder or ".")):
                if match := wanted.fullmatch(name):
                    return match[1]
    from importlib.metadata import version

    return version(distribution)


def _counts(name: str, importer: str) -> bool:
    """Whether a module is ours, or of the importer's package, and not the engine's."""
    top, _, below = name.partition(".")
    return top in (PACKAGE, importer.partition(".")[0]) and below != "" and not name.startswith(_ENGINE)


def _imports_of(module: str) -> list[str]:
    """The modules that a module imports: of `from a import b`, b where it is one, else a."""
    tops = (PACKAGE, module.partition(".")[0])
    names = []
    for base, inner in _facts(module).imports:
        candidate = f"{base}.{inner}" if inner else base
        ours = base.partition(".")[0] in tops
        names.append(candidate if inner and ours and _is_module(candidate) else base)
    return names


@functools.cache
def _is_module(name: str) -> bool:
    return module_file(name) is not None


@dataclass(frozen=True)
class _Facts:
    """What is known of a module's text."""

    digest: str
    """Of its code."""
    imports: tuple[tuple[str, str], ...]
    """`import a.b`: (a.b, ""); `from a import b`: (a, b)."""


def _facts(module: str) -> _Facts:
    return _memory().facts(module, source(module))


_MOST_TEXTS = 1000
"""That are remembered: some versions of each of our modules."""


@dataclass
class _Memory:
    """What was found of texts, in this process and in those before it."""

    path: Path | None
    known: dict[str, _Facts] = field(default_factory=dict)
    learned: bool = False

    def facts(self, module: str, text: bytes) -> _Facts:
        """What is known of a module's text, found now if need be."""
        key = f"{module} {digest_bytes(text)}"
        if key not in self.known:
            tree = compiled.parsed(text)
            imports = tuple(dict.fromkeys(_imports(tree, module)))
            self.known[key] = _Facts(code_digest(text), imports)
            self.learned = True
        return self.known[key]

    def recall(self) -> None:
        """Take in what other processes have found."""
        if self.path is None:
            return
        with contextlib.suppress(OSError, DamagedFileError, ValueError, KeyError, TypeError):
            if os.stat(self.path).st_uid == os.geteuid():
                plain = unseal(self.path.read_bytes(), self.path)["modules"]
                remembered = {
                    key: _Facts(digest, tuple(map(tuple, names))) for key, (digest, names) in plain.items()
                }
                self.known = remembered | self.known

    def keep(self) -> None:
        """Write down what was found; where that cannot be, the next process finds it again."""
        if not self.learned or self.path is None:
            return
        import tempfile

        self.learned = False
        newest = list(self.known.items())[-_MOST_TEXTS:]
        modules = {key: [facts.digest, facts.imports] for key, facts in newest}
        with contextlib.suppress(OSError):
            descriptor, temporary = tempfile.mkstemp(prefix=".", suffix=".part", dir=self.path.parent)
            with open(descriptor, "wb") as file:
                file.write(seal({"modules": modules}))
            os.replace(temporary, self.path)


@functools.cache
def _memory() -> _Memory:
    folder = compiled.folder()
    # what a text's code is depends on how this file reads it, and on what Python makes of it
    scheme = digest_value([digest_bytes(source(__name__)), sys.version_info[:2], sys.implementation.name])
    memory = _Memory(None if folder is None else folder / f"code-{scheme}.json")
    memory.recall()
    return memory


def keep_memory() -> None:
    """Write down what this process has found of our code, for those after it."""
    _memory().keep()
