"""An opened store: its sessions, its calibration items, and the answers to requests."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.answers import Answer as Answer
from lightstage.api.answers import Outlook, Why, answer, outlook, status, why
from lightstage.api.sessions import OpenSession as OpenSession
from lightstage.dag.request import Request
from lightstage.dag.watcher import Watcher
from lightstage.store.marker import FORMAT as FORMAT
from lightstage.store.root import Store

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lightstage.api.items import StoredItem
    from lightstage.dag.explain import NodeStatus
    from lightstage.store.gc import Freed
    from lightstage.store.sessions import Progress
    from lightstage.store.upgrade import Upgraded
    from lightstage.store.verify import Verified


def open_store(folder: str | Path = "data") -> "OpenStore":
    """Open the store in a folder; where there is none yet, the first import makes it.

    >>> store = lightstage.open_store("data")
    >>> store.sessions
    ['subject-a']

    Raises:
        RequestError: the folder cannot hold a store, or holds one of another format.
    """
    return OpenStore(folder)


def upgrade(folder: str | Path, *, progress: "Progress | None" = None) -> "Upgraded":
    """Carry a store of an older lightstage over to this one.

    Raises:
        RequestError: the folder holds no store.
    """
    from lightstage.store.upgrade import upgrade

    return upgrade(folder, progress=progress)


@dataclass(frozen=True)
class Imported:
    """What an import came to."""

    session: OpenSession
    new: bool
    changes: tuple[str, ...]
    """What is different from before, a sentence each; empty: nothing."""
    warnings: tuple[str, ...]


class OpenStore:
    """A store; made by `lightstage.open_store`."""

    def __init__(self, folder: str | Path) -> None:
        self.opened = Store(folder, create=False)
        """The folder below (`store.root`); not for users."""

    def __repr__(self) -> str:
        names = self.sessions
        shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        return f"<OpenStore {self.root}: {len(names)} session(s){': ' + shown if names else ''}>"

    @property
    def exists(self) -> bool:
        """Whether there is a store in the folder yet."""
        return bool(self.opened.id)

    @property
    def root(self) -> Path:
        """Its folder."""
        return self.opened.root

    @property
    def sessions(self) -> list[str]:
        """The names of its sessions."""
        from lightstage.store.sessions import session_names

        return session_names(self.opened)

    def session(self, name: str) -> OpenSession:
        """A session by name.

        >>> session = store.session("subject-a")

        Raises:
            RequestError: there is none of that name.
        """
        if not os.path.isfile(self.opened.sessions / name / "session.json"):
            from lightstage.store.sessions import read_session

            read_session(name, self.opened)  # says what there is
        return OpenSession(self.opened, name)

    def import_capture(
        self,
        folder: str | Path | Sequence[str | Path],
        session: str | None = None,
        *,
        progress: "Progress | None" = None,
    ) -> Imported:
        """Bring a capture folder, or the parts of one capture, into the store.

        >>> session = store.import_capture("captures/subject-a").session

        Args:
            session: another name than the one in capture.yaml.
            progress: passes items on and shows how far it is: called with items, their number, and what they are.

        Raises:
            RequestError: the folder holds no capture, or not the one that its capture.yaml describes.
        """
        from lightstage.store.capture import read_captures
        from lightstage.store.importer import import_capture

        folders = [Path(part) for part in ([folder] if isinstance(folder, str | Path) else folder)]
        read_captures(folders)  # a typo in it must not even make a store
        store = self.create()
        store.scratch.sweep()
        done = import_capture(folders if len(folders) > 1 else folders[0], store, name=session, progress=progress)
        store.scratch.leave()
        return Imported(OpenSession(store, done.session.name), done.new, tuple(done.changes), tuple(done.warnings))

    def items(self, session: str | None = None) -> "list[StoredItem]":
        """All calibration items, or those that a session uses."""
        from lightstage.api.items import items_of

        return items_of(self.opened, session)

    def remove(self, session: str) -> int:
        """Take a session and its results away; `gc` frees what nothing else uses. Returns the bytes of links."""
        from lightstage.store.sessions import remove_session

        return remove_session(session, self.opened)

    def demo(self, session: str = "demo", **options: Any) -> OpenSession:
        """Capture a head with the virtual rig, unless the same capture is there, and import it with its truth.

        >>> session = store.demo(size=(96, 73), bands_nm=(576,))

        Args:
            session: its name.
            options: of `api.virtual_rig.Head`: size, bands_nm, seed, sequence, tracking, motion.

        Raises:
            RequestError: the virtual rig cannot capture that.
        """
        from lightstage.api.virtual_rig import Head, capture_head, keep_truth

        folder = capture_head(self.create(), Head(session, **options))
        imported = self.import_capture(folder).session
        keep_truth(self.opened, imported.name, folder)
        return imported

    def verify(self, *, progress: "Progress | None" = None) -> "Verified":
        """Read every stored byte, and quarantine what is damaged."""
        from lightstage.store.verify import verify

        return verify(self.opened, progress=progress)

    def gc(self, *, grace_s: float = 7 * 86400, dry_run: bool = False) -> "Freed":
        """Free what no session and no result in use refers to.

        Args:
            grace_s: keep what is younger, in seconds.
            dry_run: only say what would be freed.
        """
        from lightstage.store.gc import gc

        return gc(self.opened, grace_s=grace_s, dry_run=dry_run)

    def create(self) -> Store:
        """What lies under it, made where there is none yet."""
        if not self.opened.id:
            self.opened = Store(self.root)
        return self.opened

    def answer(
        self,
        request: Request,
        *,
        workers: int | None = None,
        scheduler: str | None = None,
        progress: Watcher | None = None,
    ) -> Answer:
        """Compute what a request asks for, or remember it; see `OpenSession.run`."""
        return answer(request, self.opened, workers=workers, scheduler=scheduler, progress=progress)

    def outlook(self, request: Request) -> "Mapping[str, Outlook]":
        """What a run would do, node by node; nothing is computed."""
        return outlook(request, self.opened)

    def status(self, request: Request) -> "Mapping[str, NodeStatus]":
        """How the nodes of a request stand; where it names none, also those that were asked for once."""
        return status(request, self.opened)

    def why(self, request: Request) -> Why:
        """Why the node that a request names would be computed again, or why it last was."""
        return why(request, self.opened)
