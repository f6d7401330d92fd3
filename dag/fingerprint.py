"""The keys: what a block is called in the cache, so that it is computed once and never taken for another.

A key is the digest (xxh3, 128 bits) of canonical JSON. From the outside in:

    block key  = { stage key, context, reads }
    stage key  = { engine, stage, version, code, parameters, libraries }
    recipe     = { stage key, contexts of the node's blocks, recipes above }    names a result folder
    node key   = the block keys of a node, in order
    run key    = { request, pipeline file, session, items, source files, all that is installed }      see `recall`

**engine** is ENGINE below, raised by hand when the engine hands something else to kernels than before.

**code** is the syntax tree of the stage's module, of those of the functions that it names, and of every module of
ours that they import, directly or through others, without docstrings, comments, formatting and type annotations;
not `dag` and `store`, whose contract cannot change numbers. Helpers count, so an edited helper cannot serve stale
results. A module counts as this process has executed it (`sources`), not as its file stands.

**parameters** are the validated ones with their defaults, so writing a default out changes nothing.

**libraries** are the versions of the numeric libraries that those modules import; a library that is
in neither of the lists of `code` is refused, so that none is left out by oversight.

**context** is the part of the session's facts and of the calibration items that this block reads: the dark of
its cameras, the transmission of its band. Pictures enter by the digest of their values.

**reads** are the digests of the *values* of the chunks that the block reads, per input and piece, and the name,
shape and scale in which the kernel gets them. Equal output of a stage above stops the cascade, and compression
does not matter.

Not in any key, because they cannot change results: paths, names of sessions and nodes, worker counts, chunk
compression, dates, hosts, notes of calibration items, log and display options.

A task checks that its own process would make the same stage key and has the same engine, so that a worker with
older code or other libraries refuses instead of storing its numbers under a key that is not theirs.
"""

import functools
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from lightstage.dag.code import module_code, module_libraries
from lightstage.dag.sources import generation
from lightstage.dag.stage import CalibrationPicture, Params, Stage
from lightstage.store.digest import digest_value

ENGINE = 2


def stage_parts(stage: Stage, module: str, params: Params) -> Mapping[str, Any]:
    """What the stage key is the digest of."""
    return _stage_parts(
        stage.name, stage.version, (module, *stage.modules), params.model_dump_json(), generation()
    )[0]


def stage_key(stage: Stage, module: str, params: Params) -> str:
    """What a stage with its parameters is called in the keys of its blocks."""
    return _stage_parts(
        stage.name, stage.version, (module, *stage.modules), params.model_dump_json(), generation()
    )[1]


@functools.cache
def _stage_parts(
    name: str, version: int, modules: tuple[str, ...], params: str, _generation: int
) -> tuple[Mapping[str, Any], str]:
    """Of many sessions alike: what has to be said of a process anew has another generation."""
    parts = {
        "engine": ENGINE,
        "stage": name,
        "version": version,
        "code": dict(module_code(modules)),
        "parameters": json.loads(params),
        "libraries": dict(module_libraries(modules)),
    }
    return parts, digest_value(parts)


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

    A piece is the digests of its chunks' values, and how they are handed over: name, shape, scale, fill.
    """
    return digest_value({"stage": stage_key, "context": context, "reads": {k: list(v) for k, v in reads.items()}})


def recipe(stage_key: str, contexts: Iterable[str], above: Sequence[str]) -> str:
    """What names a node's result folder: everything that decides it but the pictures."""
    return digest_value({"stage": stage_key, "contexts": sorted(set(contexts)), "above": list(above)})
