"""The store: one folder that holds everything, and the object that the rest of the program asks for it."""

import os
from pathlib import Path

from lightstage.store import marker
from lightstage.store.chunks import Chunks
from lightstage.store.errors import RequestError
from lightstage.store.files import Scratch, disk_fault, put_if_absent
from lightstage.store.marker import Marker
from lightstage.store.records import Records


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
            RequestError: `root` is a file, an address, somebody else's folder, or of another format.
        """
        self.root = store_folder(root)
        self._lay_out(_opened(self.root, create=create))

    @classmethod
    def of_any_format(cls, root: str | Path) -> "Store":
        """A store that this program does not read yet: for `lightstage upgrade` alone."""
        store = cls.__new__(cls)
        store.root = store_folder(root)
        store._lay_out(None)
        return store

    def _lay_out(self, identity: Marker | None) -> None:
        self.id = "" if identity is None else identity.id
        """Of this store, wherever it is mounted; empty where there is none yet."""
        self.scratch = Scratch(self.root / "tmp", identity)
        self.chunks = Chunks(self.root / "cache" / "blobs", self.scratch)
        self.records = Records(self.root / "cache", self.scratch)
        self.sessions = self.root / "sessions"
        self.results = self.root / "results"
        self.calibration = self.root / "calibration"
        self.quarantine = self.root / "quarantine"


def store_folder(name: str | Path) -> Path:
    """The folder that --store names.

    Raises:
        RequestError: the name cannot be one of a folder.
    """
    text = os.fspath(name)
    if not text:
        raise RequestError("--store (or LIGHTSTAGE_STORE) is empty; name a folder")
    if "://" in text:
        raise RequestError(f"--store {text}: only a local folder can be a store so far")
    if "\0" in text:
        raise RequestError(f"--store {text!r}: a name of a folder holds no NUL")
    try:
        return Path(os.path.abspath(text))
    except FileNotFoundError:
        raise RequestError(
            f"--store {text}: the working folder has been removed; change to another, or name the store from / on"
        ) from None


def _opened(root: Path, *, create: bool) -> Marker | None:
    try:
        present = marker.read(root)
        if present is None:
            if root.exists() and not root.is_dir():
                raise RequestError(f"--store {root} is a file; a folder is needed")
            if root.is_dir() and any(entry.name != "tmp" for entry in root.iterdir()):
                raise RequestError(f"--store {root} holds other files and no store; name an empty or a new folder")
            return _create(root) if create else None
    except OSError as error:
        why = disk_fault(error, root) or error.strerror or str(error)
        raise RequestError(f"--store {str(root)[:200]} cannot be opened: {why}") from None
    refusal = marker.other_format(present, root)
    if refusal is not None:
        raise refusal
    return present


def _create(root: Path) -> Marker:
    """Make a store. Of two that do so at once, both get the one that was first."""
    try:
        (root / "tmp").mkdir(parents=True, exist_ok=True)
        scratch = Scratch(root / "tmp")
        put_if_absent(scratch, root / marker.NAME, Marker.new().as_bytes())
        scratch.leave()
    except OSError as error:
        raise RequestError(f"--store {root}: no folder can be made there ({error.strerror})") from None
    present = marker.read(root)
    if present is None:
        raise marker.gone(root)
    return present
