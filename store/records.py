"""What was computed from what.

    blocks/<key>   one block: the chunks that it wrote, and what they were made from
    nodes/<key>    one node of one session: the records of all its blocks, so that a fully cached node costs
                   one read
    runs/<key>     one request: the result folder of every node, so that a fully cached run needs neither
                   the graph nor the stages

A block record is the truth; the other two are shortcuts that can be deleted at any time. A record is written
after its chunks, in one step, and is trusted only while its chunks are there. It is sealed and says its own key;
one that is damaged is forgotten, and what it knew is computed again. So a block's record is
flushed to the disk beside the work, and nobody waits: a loss of power costs at most its computation.
"""

import contextlib
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lightstage.store.chunks import ChunkRef
from lightstage.store.errors import DamagedFileError, WorkError
from lightstage.store.files import Scratch, put_if_absent, replace
from lightstage.store.sealed import seal, unseal

KINDS = ("blocks", "nodes", "runs")


@dataclass(frozen=True)
class BlockRecord:
    """How one block came to be. `outputs` has the chunks of each array in C order of the chunk grid."""

    key: str
    outputs: Mapping[str, tuple[ChunkRef, ...]]
    stats: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    """What whoever runs it should read, a sentence each."""
    trace: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    reused: bool = field(default=True, compare=False)
    """Whether it was there; this and what follows is of one run, and not stored."""
    contradicted: bool = field(default=False, compare=False)
    """Whether it was computed again by this run, with other values."""

    def chunks(self) -> Iterator[ChunkRef]:
        """Every chunk of every array."""
        for refs in self.outputs.values():
            yield from refs

    @property
    def size(self) -> int:
        """Stored bytes."""
        return sum(ref.size for ref in self.chunks())

    def as_plain(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "key": self.key,
            "outputs": {name: [ref.as_plain() for ref in refs] for name, refs in self.outputs.items()},
            "stats": dict(self.stats),
            "warnings": list(self.warnings),
            "trace": dict(self.trace),
            "seconds": self.seconds,
        }

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> "BlockRecord":
        """From JSON."""
        return cls(
            key=plain["key"],
            outputs={
                name: tuple(ChunkRef.from_plain(ref) for ref in refs) for name, refs in plain["outputs"].items()
            },
            stats=plain["stats"],
            warnings=tuple(plain.get("warnings", ())),
            trace=plain["trace"],
            seconds=plain["seconds"],
        )


class Records:
    """The three folders of records."""

    def __init__(self, folder: Path, scratch: Scratch) -> None:
        self.folder = folder
        self._scratch = scratch

    def _path(self, kind: str, key: str) -> Path:
        return self.folder / kind / key[:2] / f"{key}.json"

    def _read(self, kind: str, key: str) -> dict[str, Any] | None:
        path = self._path(kind, key)
        try:
            with open(path, "rb") as file:
                return _unsealed(file.read(), path)
        except OSError:
            return None
        except DamagedFileError:
            # only a fault of the disk can do this (records appear whole): forget it and compute again
            with contextlib.suppress(OSError):  # of a store that is only read
                path.unlink(missing_ok=True)
            return None

    def block(self, key: str) -> BlockRecord | None:
        """The record of a block, if it was ever computed."""
        plain = self._read("blocks", key)
        return None if plain is None else BlockRecord.from_plain(plain)

    def put_block(self, record: BlockRecord) -> tuple[BlockRecord, bool]:
        """Commit a block. Returns the record that now stands, and whether it agrees with the one given.

        When two runs compute the same block, the first one stays; a disagreement means that the kernel is
        not deterministic.
        """
        path = self._path("blocks", record.key)
        standing = None
        for _ in range(3):  # a damaged record is forgotten on reading, and does not stand in the way again
            if put_if_absent(self._scratch, path, seal(record.as_plain()), durable=False):
                return record, True
            standing = self.block(record.key)
            if standing is not None:
                break
        if standing is None:
            raise WorkError(f"the record {path} changed while it was read; run again")
        same = {n: [r.value for r in refs] for n, refs in standing.outputs.items()} == {
            n: [r.value for r in refs] for n, refs in record.outputs.items()
        }
        return standing, same

    def renew_block(self, record: BlockRecord) -> None:
        """Replace a record whose chunks were lost."""
        replace(self._scratch, self._path("blocks", record.key), seal(record.as_plain()))

    def node(self, key: str) -> list[BlockRecord] | None:
        """The records of all blocks of a node, in the node's block order."""
        plain = self._read("nodes", key)
        return None if plain is None else [BlockRecord.from_plain(block) for block in plain["blocks"]]

    def put_node(self, key: str, blocks: list[BlockRecord]) -> None:
        """Remember a complete node."""
        slim = [{**block.as_plain(), "trace": {}} for block in blocks]
        replace(self._scratch, self._path("nodes", key), seal({"key": key, "blocks": slim}))

    def run(self, key: str) -> dict[str, Any] | None:
        """What a fully cached request may answer with."""
        plain = self._read("runs", key)
        return None if plain is None else dict(plain["answer"])

    def put_run(self, key: str, plain: Mapping[str, Any]) -> None:
        """Remember a finished request."""
        replace(self._scratch, self._path("runs", key), seal({"key": key, "answer": dict(plain)}))

    def files(self, kind: str) -> Iterator[Path]:
        """All record files of a kind."""
        folder = self.folder / kind
        if folder.is_dir():
            for entry in sorted(os.scandir(folder), key=lambda item: item.name):
                yield from sorted(Path(entry.path).glob("*.json"))


def intact_record(path: Path) -> bool:
    """Whether a record is as it was written, under its own key.

    Raises:
        FileNotFoundError: it is gone.
    """
    try:
        _unsealed(path.read_bytes(), path)
    except DamagedFileError:
        return False
    return True


def _unsealed(data: bytes, path: Path) -> dict[str, Any]:
    remedy = "what it knew is computed again"
    plain = unseal(data, path, remedy)
    if plain.get("key") != path.stem:
        raise DamagedFileError(path, remedy)
    return plain


def blobs_named(record: Path) -> set[str]:
    """Everything in a record that may be the name of a chunk."""
    return {name.decode() for name in re.findall(rb"[0-9a-f]{32}", record.read_bytes())}
