"""Measuring a calibration item from pictures of a target: import, run, judge, and keep the item in the store."""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.answers import Answer
from lightstage.api.requests import CALIBRATION, Request, make_request
from lightstage.api.sessions import OpenSession
from lightstage.api.stores import Imported, OpenStore
from lightstage.dag.answer import given_items
from lightstage.dag.stage import Finding, Result, evaluate
from lightstage.dag.watcher import Watcher
from lightstage.formats.png import encode_png
from lightstage.formats.whole_file import write_whole
from lightstage.store.errors import LightstageError, WorkError
from lightstage.store.items import Item, all_items
from lightstage.store.root import Store
from lightstage.store.sessions import Session, read_session, remove_session, restore_session

if TYPE_CHECKING:
    from lightstage.dag.stage import Stage
    from lightstage.store.sessions import Progress

_MOVED_PX, _MOVED_MM = 0.1, 10.0
"""What a camera or a light may move between two calibrations before somebody should look: a homography must be good
to a tenth of a pixel, and 10 mm is twice the play of a light in its mount."""


@dataclass(frozen=True)
class Measurement:
    """What was measured from a capture of a target."""

    kind: str
    session: OpenSession
    answer: Answer
    item: str | None
    """The item's name in the store; None where it is a check and no item."""
    verdict: tuple[Finding, ...]
    written: Path | None
    """The item's own file, where one was asked for."""

    def report(self, file: str | Path) -> Path:
        """Write the page: what was detected drawn on the picture, residuals, and the verdict.

        Raises:
            WorkError: it cannot be written.
        """
        from lightstage.api.groups import open_group
        from lightstage.products.calibration_report import Evidence, write_report

        session, store = self.session.read(), self.session.opened
        path = self.answer.nodes[self.kind].path
        assert path is not None

        def picture(frame: int, polarisation: int) -> Any:
            return store.chunks.get(session.images[frame][0][polarisation], dtype="<u2", shape=session.shape)

        evidence = Evidence(
            session=session.name,
            facts=session.facts,
            shape=session.shape,
            recipe=path.name.partition("-")[0],
            result=_opened(path),
            verdict=[(finding.severity, finding.sentence) for finding in self.verdict],
            picture=picture,
            open_node=lambda node: open_group(session, node, store),
        )
        write_report(Path(file), self.kind, evidence)
        return Path(file)


def measure(
    store: OpenStore,
    kind: str,
    folders: Sequence[str | Path],
    *,
    session: str | None = None,
    changes: Mapping[str, Any] | Sequence[str] = (),
    items: Mapping[str, str | Path] | Sequence[str] = (),
    pipeline: str | Path | None = None,
    out: str | Path | None = None,
    imported: Callable[[Imported], object] = lambda done: None,
    importing: "Progress | None" = None,
    progress: Watcher | None = None,
) -> Measurement:
    """Measure an item from capture folders of a target. One that tells nothing leaves nothing behind.

    >>> measure(store, "homography", ["captures/boards"]).item
    'homography-3f2a...'

    Args:
        kind: one of MEASURED.
        session: another name than the one in capture.yaml.
        changes, items, pipeline: as of a request; the pipeline is that of calibration.
        out: write the item here as well: a file or a folder.
        imported: is told what the import came to, before the measuring begins.
        importing, progress: are told how the import and the run go on.

    Raises:
        RequestError: the folders hold no capture of such a target.
        WorkError: it cannot be measured from these pictures.
    """
    from lightstage.store.capture import read_captures

    paths = [Path(folder) for folder in folders]
    name = session or read_captures(paths).description.session
    with _undone_on_failure(store, name):
        done = store.import_capture(paths, name, progress=importing)
        imported(done)
        request = make_request(name, [kind], changes=changes, pipeline=pipeline, items=items, packaged=CALIBRATION)
        answer = store.answer(request, progress=progress)
    return _judged(done.session, request, answer, None if out is None else Path(out))


@contextmanager
def _undone_on_failure(store: OpenStore, name: str) -> Iterator[None]:
    """A session as it was before, should what is done with it fail."""
    before = read_session(name, store.opened) if name in store.sessions else None
    try:
        yield
    except LightstageError:
        if name in store.sessions:
            after = read_session(name, store.opened)
            if before is None:
                remove_session(name, store.opened)
            elif after.digest != before.digest:
                restore_session(before, after, store.opened)
        raise


def _judged(session: OpenSession, request: Request, answer: Answer, out: Path | None) -> Measurement:
    """What a finished run says, and the item that it is, kept in the store."""
    store = session.opened
    stage = _stage(request)
    path = answer.nodes[request.nodes[0]].path
    assert path is not None
    opened = session.read()
    result = _result(path, opened, _bound(opened, request, store))
    verdict = [] if stage.verdict is None else [Finding(*pair) for pair in evaluate(stage.verdict, result)]
    item = written = None
    if stage.item is not None:
        item, folder = _kept(evaluate(stage.item, result), opened, store)
        verdict += changes_since(item, opened.shape, store)
        if out is not None:
            written = _write_out(folder, out)
        shutil.rmtree(folder, ignore_errors=True)
    store.scratch.leave()
    return Measurement(
        kind=request.nodes[0],
        session=session,
        answer=answer,
        item=None if item is None else item.name,
        verdict=tuple(verdict),
        written=written,
    )


def _stage(request: Request) -> "Stage":
    from lightstage.dag.graph import load_graph
    from lightstage.stages import TABLE

    return load_graph(request.pipeline, TABLE, overrides=request.overrides).nodes[request.nodes[0]].stage


def _bound(session: Session, request: Request, store: Store) -> Mapping[str, Item]:
    from lightstage.dag.plan import bound_items

    return bound_items(session, store, given_items(request, store))


def _opened(path: Path) -> Any:
    """A result of one block, without the dimension `all` that says so."""
    from lightstage.store.grid import open_dataset

    opened = open_dataset(path)
    return opened.isel(all=0) if "all" in opened.dims else opened


def _result(path: Path, session: Session, items: Mapping[str, Item]) -> Result:
    """What a node found, as its `item` and `verdict` read it."""
    opened = _opened(path)
    return Result(
        arrays={str(name): opened[name].values for name in opened.data_vars},
        labels={str(name): opened[name].values.tolist() for name in opened.coords},
        attrs=dict(opened.attrs),
        facts={**session.facts, "shape": list(session.shape)},
        items={kind: item.values for kind, item in items.items()},
    )


def _kept(content: Mapping[str, Any], session: Session, store: Store) -> tuple[Item, Path]:
    """An item and its pictures written into a scratch folder, checked as any other, and kept in the store."""
    from lightstage.store import document
    from lightstage.store.calibration import read_item
    from lightstage.store.items import put_item

    folder = store.scratch.path()
    folder.mkdir(parents=True)
    plain = dict(content)
    images = plain.pop("images", {})
    if images:
        plain["images"] = {camera: f"{plain['item']}_{camera}.png" for camera in images}
        for camera, pixels in images.items():
            path = folder / plain["images"][camera]
            try:
                write_whole(path, encode_png(pixels))
            except OSError:
                raise WorkError(f"{path} cannot be written; is the disk full?") from None
    if session.facts["rig"]:
        plain["rig"] = session.facts["rig"]
    if session.facts["captured"]:
        plain["valid_from"] = session.facts["captured"]
    plain["measured_from"] = session.name
    path = folder / f"{plain['item']}.yaml"
    path.write_text(document.text_of(plain), encoding="utf-8")
    item, original = read_item(path, store.chunks)
    put_item(item, original, store)
    return item, folder


def _write_out(folder: Path, out: Path) -> Path:
    """Copy a new item to where the user wants it, its pictures beside it; each file appears whole."""
    target = out / next(folder.glob("*.yaml")).name if out.is_dir() or not out.suffix else out
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        for source in sorted(folder.iterdir(), key=lambda file: file.suffix == ".yaml"):  # the item last
            place = target if source.suffix == ".yaml" else target.parent / source.name
            write_whole(place, source.read_bytes())
    except OSError as error:
        raise WorkError(f"{target} cannot be written ({error.strerror}); the item is in the store") from None
    return target


def changes_since(item: Item, shape: tuple[int, int], store: Store) -> list[Finding]:
    """What moved since the last item of this kind and rig.

    Args:
        shape: of the pictures: rows, columns.
    """
    others = [
        other
        for other in all_items(store)
        if other.kind == item.kind
        and other.digest != item.digest
        and other.notes.get("rig") == item.notes.get("rig")
        and str(other.notes.get("valid_from") or "") <= str(item.notes.get("valid_from") or "")
    ]
    dated = [other for other in others if other.notes.get("valid_from")]
    if not dated:
        return []
    last = max(dated, key=lambda other: str(other.notes["valid_from"]))
    since = f"since {str(last.notes['valid_from'])[:10]}"
    if item.kind == "homography" and last.values["from"] == item.values["from"]:
        from lightstage.kernels.targets.shift import shift_px

        shift = shift_px(last.values["matrix"], item.values["matrix"], shape)
        return [
            Finding(
                "doubtful" if shift > _MOVED_PX else "good", f"{item.values['from']} moved {shift:.2f} px {since}"
            )
        ]
    if item.kind == "lights":
        return _moved_lights(last.values["lights"], item.values["lights"], since)
    return []


def _moved_lights(before: Sequence[Any], now: Sequence[Any], since: str) -> list[Finding]:
    from math import dist

    places = {light["id"]: light["position_mm"] for light in before}
    moved = []
    for light in now:
        old, new = places.get(light["id"]), light["position_mm"]
        if old and new and dist(old, new) > _MOVED_MM:
            moved.append(Finding("doubtful", f"{light['id']} moved {dist(old, new):.0f} mm {since}"))
    return moved
