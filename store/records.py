"""What was computed from what.

    blocks/<key>   one block: the chunks that it wrote, and what they were made from
    nodes/<key>    one node of one session: the records of all its blocks, so that a fully cached node costs
                   one read
    runs/<key>     one request: the result folder of every node, so that a fully cached run needs neither
                   the graph nor the stages

A block record is the truth; the other two are shortcuts that can be deleted at any time. A record is written
after its chunks, in one step, and is trusted only while its chunks are there.
"""

import json
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from store.chunks import ChunkRef
from store.errors import WorkError
from store.files import Scratch, put_if_absent, replace


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

    def _read(self, kind: str, key: str) -> Any:
        try:
            with open(self._path(kind, key), "rb") as file:
                return json.loads(file.read())
        except FileNotFoundError:
            return None
        except OSError:
            return None
        except ValueError:
            # only a fault of the disk can do this (records appear whole): forget it and compute again
            self._path(kind, key).unlink(missing_ok=True)
            return None

    def block(self, key: str) -> BlockRecord | None:
        """The record of a block, if it was ever computed."""
        plain = self._read("blocks", key)
        try:
            return None if plain is None else BlockRecord.from_plain(plain)
        except (KeyError, TypeError, AttributeError, IndexError):
            return None

    def put_block(self, record: BlockRecord) -> tuple[BlockRecord, bool]:
        """Commit a block. Returns the record that now stands, and whether it agrees with the one given.

        When two runs compute the same block, the first one stays; a disagreement means that the kernel is
        not deterministic.
        """
        path = self._path("blocks", record.key)
        data = json.dumps(record.as_plain(), separators=(",", ":")).encode()
        if put_if_absent(self._scratch, path, data):
            return record, True
        standing = self.block(record.key)
        if standing is None or standing.key != record.key:
            raise WorkError(f"the record {path} changed while it was read; run again")
        same = {n: [r.value for r in refs] for n, refs in standing.outputs.items()} == {
            n: [r.value for r in refs] for n, refs in record.outputs.items()
        }
        return standing, same

    def renew_block(self, record: BlockRecord) -> None:
        """Replace a record whose chunks were lost."""
        data = json.dumps(record.as_plain(), separators=(",", ":")).encode()
        replace(self._scratch, self._path("blocks", record.key), data)

    def node(self, key: str) -> list[BlockRecord] | None:
        """The records of all blocks of a node, in the node's block order."""
        plain = self._read("nodes", key)
        try:
            return None if plain is None else [BlockRecord.from_plain(block) for block in plain]
        except (KeyError, TypeError, AttributeError, IndexError):
            return None

    def put_node(self, key: str, blocks: list[BlockRecord]) -> None:
        """Remember a complete node."""
        slim = [{**block.as_plain(), "trace": {}} for block in blocks]
        replace(self._scratch, self._path("nodes", key), json.dumps(slim, separators=(",", ":")).encode())

    def run(self, key: str) -> dict[str, Any] | None:
        """What a fully cached request may answer with."""
        plain = self._read("runs", key)
        return plain if isinstance(plain, dict) else None

    def put_run(self, key: str, plain: Mapping[str, Any]) -> None:
        """Remember a finished request."""
        replace(self._scratch, self._path("runs", key), json.dumps(plain, separators=(",", ":")).encode())

    def files(self, kind: str) -> Iterator[Path]:
        """All record files of a kind: blocks, nodes or runs."""
        folder = self.folder / kind
        if folder.is_dir():
            for entry in sorted(os.scandir(folder), key=lambda item: item.name):
                yield from sorted(Path(entry.path).glob("*.json"))


def blobs_named(record: Path) -> set[str]:
    """Everything in a record that may be the name of a chunk."""
    return set(re.findall(r"[0-9a-f]{32}", record.read_text()))
