"""Calibration items in the store: one measured fact of the rig each, addressed by its own content.

    calibration/<kind>-<digest>/item.json     its numbers, the chunks of its pictures, and the file as it came
    calibration/<kind>-<digest>/item.yaml     the file as it came, for people

The digest is of the numbers alone: other formatting, another comment, another rig name give the same item.
item.json is sealed, and what it holds must have its digest. What each kind's file says is in `calibration`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.store import document
from lightstage.store.chunks import ChunkRef
from lightstage.store.digest import SHORT, digest_value
from lightstage.store.errors import DamagedFileError, RequestError
from lightstage.store.files import renewed, replace
from lightstage.store.root import Store
from lightstage.store.sealed import seal, unseal

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class StoredPicture:
    """A calibration picture: a chunk and what it decodes to."""

    chunk: ChunkRef
    dtype: str
    shape: tuple[int, ...]

    def as_plain(self) -> dict[str, Any]:
        """For JSON."""
        return {"chunk": self.chunk.as_plain(), "dtype": self.dtype, "shape": list(self.shape)}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> "StoredPicture":
        """From JSON."""
        return cls(ChunkRef.from_plain(plain["chunk"]), plain["dtype"], tuple(plain["shape"]))

    def load(self, store: Store) -> "NDArray[Any]":
        """The pixels, (y, x)."""
        return store.chunks.get(self.chunk, dtype=self.dtype, shape=self.shape)


@dataclass(frozen=True)
class Item:
    """One calibration item in the store."""

    kind: str
    digest: str
    values: Mapping[str, Any]
    """Its numbers, without the notes and the pictures' file names."""
    notes: Mapping[str, Any]
    pictures: Mapping[str, StoredPicture]
    """By camera; dark and flat have them."""

    @property
    def name(self) -> str:
        """The short name: kind and the first digits."""
        return f"{self.kind}-{self.digest[:SHORT]}"


def item_digest(values: Mapping[str, Any], pictures: Mapping[str, StoredPicture]) -> str:
    """What names an item: the digest of its numbers and of its pictures' values."""
    return digest_value(
        {"values": dict(values), "pictures": {camera: p.chunk.value for camera, p in pictures.items()}}
    )


def put_item(item: Item, original: bytes, store: Store) -> None:
    """Keep an item in the store; the notes of the newest file with these numbers win."""
    folder = store.calibration / item.name
    data = seal({**_as_plain(item), "original": original.decode()}, indent=1)
    # item.json is the truth; after a kill between the two, item.yaml shows the notes of the file before
    for path, content in ((folder / "item.json", data), (folder / "item.yaml", original)):
        if _bytes(path) != content or not renewed(path):
            replace(store.scratch, path, content)


def _bytes(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _as_plain(item: Item) -> dict[str, Any]:
    return {
        "kind": item.kind,
        "digest": item.digest,
        "values": dict(item.values),
        "notes": dict(item.notes),
        "pictures": {camera: picture.as_plain() for camera, picture in item.pictures.items()},
    }


def get_item(kind: str, digest: str, store: Store) -> Item:
    """An item by its digest, or the first digits of it.

    Raises:
        RequestError: it is not in the store.
        DamagedFileError: it is not as it was put there.
    """
    return _stored(kind, digest, store)[0]


def original_of(item: Item, store: Store) -> bytes:
    """The file that an item came from, as it was.

    Raises:
        RequestError, DamagedFileError: as `get_item`.
    """
    return _stored(item.kind, item.digest, store)[1]


def _stored(kind: str, digest: str, store: Store) -> tuple[Item, bytes]:
    path = store.calibration / f"{kind}-{digest[:SHORT]}" / "item.json"
    remedy = "import the capture that it came with again, or `lightstage calibration use` its file"
    try:
        data = path.read_bytes()
    except OSError:
        raise RequestError(
            f"the {kind} item {digest[:SHORT]} is not in the store; import the capture that it came with again"
        ) from None
    plain = unseal(data, path, remedy)
    try:
        pictures = {camera: StoredPicture.from_plain(picture) for camera, picture in plain["pictures"].items()}
        item = Item(plain["kind"], plain["digest"], plain["values"], plain["notes"], pictures)
        right = item.kind == kind and item.digest.startswith(digest)
        if not (right and item_digest(item.values, pictures) == item.digest):
            raise DamagedFileError(path, remedy)
        return item, plain["original"].encode()
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        raise DamagedFileError(path, remedy) from None


def all_items(store: Store) -> list[Item]:
    """Every item in the store, by name."""
    return [get_item(kind, digest, store) for kind, digest in item_names(store)]


def item_names(store: Store) -> list[tuple[str, str]]:
    """Kind and first digits of every item in the store, in order."""
    names = sorted(path.parent.name.rpartition("-") for path in store.calibration.glob("*/item.json"))
    return [(kind, digits) for kind, _, digits in names]


def find_item(name: str, store: Store) -> Item:
    """An item by its name or the beginning of it (`homography-3f`).

    Raises:
        RequestError: none or several begin like that.
    """
    items = all_items(store)
    hits = [item for item in items if item.name.startswith(name)]
    if len(hits) == 1:
        return hits[0]
    if hits:
        raise RequestError(f"'{name}' may be {' or '.join(item.name for item in hits)}; give more digits")
    hint = document.nearest(name, [item.name for item in items])
    raise RequestError(f"no calibration item '{name}' in {store.root}{hint}")


def not_valid_for(item: Item, *, rig: str | None, captured: str | None) -> str | None:
    """Why an item does not hold for a capture (another rig, measured later than it), or None."""
    item_rig = item.notes.get("rig")
    if item_rig and rig and item_rig != rig:
        return f"it was measured on the rig '{item_rig}', the session is of '{rig}'"
    valid_from = item.notes.get("valid_from")
    if valid_from and captured and str(captured)[:10] < str(valid_from)[:10]:
        return f"it is valid from {valid_from}, the session was captured on {captured}"
    return None
