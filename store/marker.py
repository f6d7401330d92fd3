"""`store.json`: what a folder is, in which format, and which store it is.

    {"seal": "...", "format": "lightstage-store/2", "id": "<32 random digits>"}

The id stays with the store wherever it is moved or mounted: two processes that see the same id see the same store.
While `lightstage upgrade` is at work the format is "upgrading", so that no program takes the store for its own.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from lightstage.store.errors import LightstageError, RequestError, WorkError
from lightstage.store.sealed import intact, seal

FORMAT = 2
"""What this program reads and writes; `store.upgrade` has a step for every one before it."""

NAME = "store.json"
_KIND = "lightstage-store/"
_UPGRADING = f"{_KIND}upgrading"


@dataclass(frozen=True)
class Marker:
    """What `store.json` says."""

    format: int
    """While an upgrade is at work: the one up to which everything has been carried over."""
    id: str
    """Empty in a store of format 1, which had none."""
    upgrading: bool = False

    @classmethod
    def new(cls) -> Self:
        """Of a store that is made now."""
        return cls(FORMAT, os.urandom(16).hex())

    def as_bytes(self) -> bytes:
        """For the file."""
        if self.upgrading:
            return seal({"format": _UPGRADING, "from": self.format, "id": self.id})
        return seal({"format": f"{_KIND}{self.format}", "id": self.id})

    def check(self, root: Path) -> None:
        """See that the store is still there, and still the one that was opened.

        Raises:
            WorkError: it is not.
        """
        try:
            present = read(root)
        except OSError:
            present = None
        if present is None:
            raise gone(root)
        if present != self:
            raise WorkError(f"the store {root} was upgraded or exchanged in the meantime; run again")


def gone(root: Path) -> WorkError:
    """That a store is no longer where it was."""
    return WorkError(
        f"the store {root} is gone (moved or unmounted?); nothing was made in its place; bring it back and run "
        "again"
    )


def read(root: Path) -> Marker | None:
    """What the folder says that it is, or None where it says nothing.

    Raises:
        RequestError: its `store.json` is no such file or damaged.
        OSError: the folder cannot be looked into.
    """
    path = root / NAME
    try:
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    try:
        plain = json.loads(data)
        text = str(plain["format"])
        if text == _UPGRADING:
            marker = Marker(int(plain["from"]), str(plain["id"]), upgrading=True)
        elif text.startswith(_KIND):
            marker = Marker(int(text.removeprefix(_KIND)), str(plain.get("id", "")))
        else:
            raise RequestError(f"{path} says {text[:60]!r}; this program reads {_KIND}{FORMAT}")
        # one of another format may be sealed otherwise
        whole = intact(data) or marker.format != FORMAT or marker.upgrading
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        whole = False
    if not whole:
        raise DamagedMarkerError(
            f"{path} is damaged; `lightstage upgrade` looks through the store and writes it anew"
        )
    return marker


class DamagedMarkerError(RequestError):
    """`store.json` cannot be read; all else in the store may be well."""


def other_format(marker: Marker, root: Path) -> LightstageError | None:
    """Why this program does not use a store of that format, or None where it does."""
    if marker.upgrading:
        return RequestError(
            f"the store {root} is being upgraded, or was until that was stopped; `lightstage upgrade` goes on "
            "from there"
        )
    if marker.format < FORMAT:
        return RequestError(
            f"the store {root} was made by an older lightstage (format {marker.format}; this program reads "
            f"{FORMAT}); run `lightstage upgrade`, which carries it over and loses nothing"
        )
    if marker.format > FORMAT:
        return RequestError(
            f"the store {root} was made by a newer lightstage (format {marker.format}); this program reads {FORMAT}"
        )
    return None
