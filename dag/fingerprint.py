"""The keys: what a block is called in the cache, so that it is computed once and never taken for another.

A key is the digest (xxh3, 128 bits) of canonical JSON. From the outside in:

    block key  = { stage key, context, reads }
    stage key  = { engine, stage, version, code, parameters, libraries }
    recipe     = { stage key, contexts of the node's blocks, recipes above }    names a result folder
    node key   = the block keys of a node, in order
    run key    = { request, pipeline file, session, items, source files, all that is installed }      see `recall`

**engine** is ENGINE below, raised by hand when the engine hands something else to kernels than before.

**code** is the syntax tree of the stage's module and of every module of ours that it imports, directly or
through others, without docstrings, comments, formatting and type annotations; not `dag` and `store`, whose
contract cannot change numbers. Helpers count, so an edited helper cannot serve stale results. A module counts
as this process has executed it (`sources`), not as its file stands.

**parameters** are the validated ones with their defaults, so writing a default out changes nothing.

**libraries** are the versions of the numeric libraries (NUMERIC) that those modules import; a library that is
neither there nor in SILENT is refused, so that none is left out by oversight.

**context** is the part of the session's facts and of the calibration items that this block reads: the dark of
its cameras, the transmission of its band. Pictures enter by the digest of their values.

**reads** are the digests of the *values* of the chunks that the block reads, per input and in order, and the shape
and scale in which the kernel gets them. Equal output of a stage above stops the cascade, and compression does not
matter.

Not in any key, because they cannot change results: paths, names of sessions and nodes, worker counts, chunk
compression, dates, hosts, notes of calibration items, log and display options.

A task checks that its own process would make the same stage key and has the same engine, so that a worker with
older code or other libraries refuses instead of storing its numbers under a key that is not theirs.
"""

import ast
import contextlib
import functools
import importlib.metadata
import importlib.util
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from lightstage.dag.sources import ENGINE as ENGINE_PACKAGES
from lightstage.dag.sources import PACKAGE, generation, source
from lightstage.dag.stage import CalibrationPicture, Params, Stage
from lightstage.store.digest import digest_bytes, digest_value

ENGINE = 1

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


def code_digest(source: str) -> str:
    """Digest of what a module does: its syntax tree without docstrings, comments, formatting and annotations.

    The text form is our own, because Python's `ast.dump` differs between versions.
    """
    return digest_bytes(_text(_without_docstrings(_parsed(source))).encode())


_PARSINGS = 20


def _parsed(source: str | bytes) -> ast.Module:
    """The syntax tree. Until Python 3.11.8 and 3.12.2 one thread's parsing may fail because of another's."""
    for _ in range(_PARSINGS):
        with contextlib.suppress(SystemError):
            return ast.parse(source)
    return ast.parse(source)


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


def module_code(name: str) -> Mapping[str, str]:
    """Digest of the code of a module and of the modules of its package that it imports, by module name."""
    return _module_code(name, generation())


@functools.cache
def _module_code(name: str, _generation: int) -> Mapping[str, str]:
    return dict(sorted(_closure(name, {}).items()))


def module_libraries(name: str) -> Mapping[str, str]:
    """Versions of the numeric libraries that a module and the modules of ours that it calls import.

    Raises:
        ModuleNotFoundError: one of them imports a library of which nobody has said whether it decides numbers.
    """
    used = set()
    for module in module_code(name):
        imported = {found.split(".")[0] for found in _imports_of(module)}
        strange = imported - {module.split(".")[0], PACKAGE} - SILENT - sys.stdlib_module_names - set(NUMERIC)
        if strange:
            raise ModuleNotFoundError(
                f"{module} imports {', '.join(sorted(strange))}, which is neither in NUMERIC nor in SILENT of "
                "dag/fingerprint.py, so it cannot be in a key"
            )
        used |= imported & set(NUMERIC)
    if "numba" in used:
        used.add("scipy")  # whose LAPACK numba's linear algebra calls
    return {NUMERIC[name]: _version(NUMERIC[name]) for name in sorted(used)}


_version = functools.cache(importlib.metadata.version)


def _closure(module: str, found: dict[str, str]) -> dict[str, str]:
    if module in found:
        return found
    found[module] = _code_digest(source(module))
    for imported in _imports_of(module):
        if _counts(imported, module):
            _closure(imported, found)
    return found


def _counts(name: str, importer: str) -> bool:
    """Whether a module is ours, or of the importer's package, and not the engine's."""
    top, _, below = name.partition(".")
    return top in (PACKAGE, importer.partition(".")[0]) and below != "" and not name.startswith(_ENGINE)


@functools.cache
def _code_digest(text: bytes) -> str:
    return code_digest(text.decode())


def _imports_of(module: str) -> tuple[str, ...]:
    return _imported(source(module), module)


@functools.cache
def _imported(text: bytes, module: str) -> tuple[str, ...]:
    return tuple(_imports(_parsed(text), module))


def _imports(tree: ast.AST, module: str) -> Iterable[str]:
    """The modules that a module imports, wherever in it the import stands."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")[: -node.level]
                base = ".".join([*parts, *([base] if base else [])])
            for alias in node.names:
                candidate = f"{base}.{alias.name}"
                yield candidate if _is_module(candidate, module) else base


@functools.cache
def _is_module(name: str, importer: str) -> bool:
    if name.split(".")[0] not in (importer.split(".")[0], PACKAGE):
        return False
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def stage_parts(stage: Stage, module: str, params: Params) -> dict[str, Any]:
    """What the stage key is the digest of."""
    return {
        "engine": ENGINE,
        "stage": stage.name,
        "version": stage.version,
        "code": dict(module_code(module)),
        "parameters": params.model_dump(mode="json"),
        "libraries": dict(module_libraries(module)),
    }


def plain_context(context: Any) -> Any:
    """A context as plain data: pictures become the digest of their values."""
    if isinstance(context, CalibrationPicture):
        return {"picture": context.digest}
    if isinstance(context, Mapping):
        return {str(key): plain_context(value) for key, value in context.items()}
    if isinstance(context, list | tuple):
        return [plain_context(value) for value in context]
    return context


def block_key(stage_key: str, context: str, reads: Mapping[str, Sequence[Any]]) -> str:
    """Key of a block: its stage, the digest of its context, and per input the pieces that it reads.

    A piece is the digests of its chunks' values, and how they are handed over: shape, scale, fill.
    """
    return digest_value({"stage": stage_key, "context": context, "reads": {k: list(v) for k, v in reads.items()}})


def recipe(stage_key: str, contexts: Iterable[str], above: Sequence[str]) -> str:
    """What names a node's result folder: everything that decides it but the pictures."""
    return digest_value({"stage": stage_key, "contexts": sorted(set(contexts)), "above": list(above)})
