"""The calibration items of a store, and which session uses which."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightstage.dag.request import Request
from lightstage.store.calibration import read_item
from lightstage.store.errors import RequestError
from lightstage.store.items import Item, all_items, find_item, original_of, put_item
from lightstage.store.root import Store
from lightstage.store.sessions import Session, bind_item, read_session, session_names


@dataclass(frozen=True)
class StoredItem:
    """A calibration item."""

    name: str
    kind: str
    digest: str
    values: Mapping[str, Any]
    notes: Mapping[str, Any]
    """Rig, dates, residuals: what changes no number."""
    pictures: Mapping[str, str]
    """Per camera, size and kind of its picture."""
    sessions: tuple[str, ...]
    """That use it."""
    path: Path
    """Its YAML file in the store."""


@dataclass(frozen=True)
class Bound:
    """What a session uses from now on."""

    item: str
    kind: str
    before: str | None
    """Digest of the item that it used before."""
    changed: bool


def items_of(store: Store, session: str | None = None) -> list[StoredItem]:
    """All items, or those that a session uses."""
    names = [session] if session else session_names(store)
    users: dict[str, list[str]] = {}
    for name in names:
        for kind, digest in read_session(name, store).items.items():
            users.setdefault(f"{kind}-{digest[:12]}", []).append(name)
    items = [item for item in all_items(store) if not session or item.name in users]
    return [_stored(item, store, users.get(item.name, ())) for item in items]


def item_text(store: Store, name: str) -> tuple[StoredItem, str]:
    """An item by its name or the beginning of it, and its file's text."""
    item = find_item(name, store)
    return _stored(item, store, ()), original_of(item, store).decode()


def bind(session: Session, item: str | Path, store: Store) -> Bound:
    """Let a session use an item: a file, or one of the store by its name.

    Raises:
        RequestError: there is no such item.
    """
    path = Path(os.path.expanduser(item))
    if path.is_file():
        new, original = read_item(path, store.chunks)
        put_item(new, original, store)
    elif path.suffix in (".yaml", ".yml"):
        raise RequestError(f"{path} is missing: expected a calibration item")
    else:
        new = find_item(str(item), store)
    before = bind_item(session.name, new, store)
    return Bound(new.name, new.kind, before, before != new.digest)


def item_values(request: Request, store: Store) -> dict[str, Mapping[str, Any]]:
    """The values of the items that a request is answered with, by kind."""
    from lightstage.dag.answer import given_items
    from lightstage.dag.plan import bound_items

    items = bound_items(read_session(request.session, store), store, given_items(request, store))
    return {kind: item.values for kind, item in items.items()}


def _stored(item: Item, store: Store, sessions: "list[str] | tuple[str, ...]") -> StoredItem:
    return StoredItem(
        name=item.name,
        kind=item.kind,
        digest=item.digest,
        values=item.values,
        notes=dict(item.notes),
        pictures={camera: f"{p.shape[1]} x {p.shape[0]}, {p.dtype}" for camera, p in item.pictures.items()},
        sessions=tuple(sessions),
        path=store.calibration / item.name / "item.yaml",
    )
