"""The store: one folder that holds everything, and the object that the rest of the program asks for it."""

import json
import os
from pathlib import Path

from store.chunks import Chunks
from store.errors import RequestError
from store.files import Scratch, replace
from store.records import Records

FORMAT = "lightstage-store/1"


class Store:
    """An opened store.

    <root>/store.json            what this folder is
    <root>/sessions/<session>/   imported captures
    <root>/results/<session>/    result groups
    <root>/calibration/          items, by content
    <root>/cache/                chunks and records
    <root>/quarantine/           damaged chunks that `verify` has taken out
    <root>/tmp/                  what is being written
    """

    def __init__(self, root: str | Path, *, create: bool = True) -> None:
        """Open the store at `root`, and make it when it is not there.

        Raises:
            RequestError: `root` is a file, an address, somebody else's folder, or of a newer format.
        """
        if "://" in str(root):
            raise RequestError(f"--store {root}: only a local folder can be a store so far")
        self.root = Path(os.path.abspath(root))
        self.scratch = Scratch(self.root / "tmp")
        self.chunks = Chunks(self.root / "cache" / "blobs", self.scratch)
        self.records = Records(self.root / "cache", self.scratch)
        self.sessions = self.root / "sessions"
        self.results = self.root / "results"
        self.calibration = self.root / "calibration"
        self.quarantine = self.root / "quarantine"
        self._open(create)

    def _open(self, create: bool) -> None:
        marker = self.root / "store.json"
        try:
            found = json.loads(marker.read_bytes()).get("format")
        except (FileNotFoundError, NotADirectoryError):
            if self.root.exists() and not self.root.is_dir():
                raise RequestError(f"--store {self.root} is a file; a folder is needed") from None
            if self.root.is_dir() and any(entry.name != "tmp" for entry in self.root.iterdir()):
                raise RequestError(
                    f"--store {self.root} holds other files and no store; name an empty or a new folder"
                ) from None
            if create:
                self._make(marker)
            return
        except (ValueError, AttributeError):
            found = None
        if found != FORMAT:
            raise RequestError(f"{marker} says {found!r}; this program reads {FORMAT}")

    def _make(self, marker: Path) -> None:
        try:
            replace(self.scratch, marker, json.dumps({"format": FORMAT}).encode())
        except OSError as error:
            raise RequestError(f"--store {self.root}: no folder can be made there ({error.strerror})") from None
