"""calibrate: measure a calibration item from pictures of a target."""

import argparse
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lightstage.cli.run import pipeline_path, versions
from lightstage.cli.show import RunWatcher, Screen
from lightstage.formats.whole_file import write_whole
from lightstage.stages.calibration import MEASURED
from lightstage.store.errors import LightstageError, RequestError, WorkError
from lightstage.store.files import human_size
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.dag.plan import Plan
    from lightstage.dag.stage import Finding, Result
    from lightstage.store.calibration import Item
    from lightstage.store.sessions import Session

_MOVED_PX, _MOVED_MM = 0.1, 10.0
"""What a camera or a light may move between two calibrations before somebody should look: a homography must be good
to a tenth of a pixel, and 10 mm is twice the play of a light in its mount."""


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    measure = commands.add_parser("calibrate", help="measure a calibration item from pictures of a target")
    measure.add_argument("item", choices=MEASURED, metavar="ITEM", help=", ".join(MEASURED))
    measure.add_argument(
        "--from", nargs="+", type=Path, required=True, metavar="FOLDER", dest="folders", help="capture folders"
    )
    measure.add_argument("--out", type=Path, metavar="FILE", help="write the item here as well")
    measure.add_argument(
        "--report", nargs="?", type=Path, const=Path(), metavar="FILE", help="write a page with pictures"
    )
    measure.add_argument("--session", metavar="NAME", help="another name than the one in capture.yaml")
    measure.add_argument("--outline", metavar="'X,Y ...'", help="points on the ball's outline, picked by hand")
    measure.add_argument(
        "--driven-from",
        choices=("ideal", "measured"),
        help="lights: whether the rig's weights were made from the layout (default) or from measured positions",
    )
    measure.add_argument("--set", action="append", default=[], metavar="NODE.PARAM=VALUE", dest="overrides")
    measure.add_argument(
        "--calibration", action="append", default=[], metavar="KIND=FILE", help="use this item for this run"
    )
    measure.add_argument(
        "--pipeline", type=Path, metavar="FILE", help="default: ./calibration.yaml, or the packaged"
    )
    measure.set_defaults(handler=handle_calibrate, computes=True)


def handle_calibrate(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage calibrate."""
    from lightstage.cli.calibration_report import write_report
    from lightstage.cli.run import override_items
    from lightstage.cli.sessions import import_folder
    from lightstage.dag.stage import Finding, evaluate
    from lightstage.store.capture import read_captures
    from lightstage.store.sessions import read_session, remove_session, restore_session, session_names

    capture = read_captures(options.folders)  # a typo in it must not even make a store
    name = options.session or capture.description.session
    store = Store(options.store)
    store.scratch.sweep()
    before = read_session(name, store) if name in session_names(store) else None
    session = import_folder(options.folders, store, screen, name).session
    try:
        plan = _plan(options, session, override_items(options.calibration, store), store)
        nodes, path = _run(plan, store, screen)
    except LightstageError:
        # a capture that tells nothing leaves nothing behind
        if before is not None:
            restore_session(before, session, store)
        else:
            remove_session(name, store)
        raise
    result = read_result(plan, path)
    stage = plan.nodes[options.item].node.stage
    verdict = [] if stage.verdict is None else [Finding(*pair) for pair in evaluate(stage.verdict, result)]
    item, written = None, None
    if stage.item is not None:
        item, folder = keep_item(evaluate(stage.item, result), session, store)
        verdict += changes_since(item, session.shape, store)
        screen.say(f"{item.name}: `lightstage calibration use {item.name} --session S` binds it")
        if options.out is not None:
            written = _write_out(folder, options.out)
            screen.say(f"item: {written}")
        shutil.rmtree(folder, ignore_errors=True)
    elif options.out is not None:
        screen.warn(f"{options.item} is a check, not an item: nothing to write to {options.out}; try --report")
    for finding in verdict:
        screen.say(finding.sentence)
    report = None
    if options.report is not None:
        report = options.report if options.report.name else Path(f"{session.name}-{options.item}.html")
        write_report(report, options.item, plan, result, verdict, store)
        screen.say(f"report: {report}")
    store.scratch.leave()
    screen.document(
        {
            "session": session.name,
            "item": None if item is None else item.name,
            "nodes": nodes,
            "verdict": [finding.sentence for finding in verdict],
            "severities": [finding.severity for finding in verdict],
            "out": None if written is None else str(written),
            "report": None if report is None else str(report),
        }
    )
    return 0


def _plan(options: argparse.Namespace, session: "Session", given: "Mapping[str, Item]", store: Store) -> "Plan":
    from lightstage.dag.graph import load_graph
    from lightstage.dag.plan import bound_items, make_plan
    from lightstage.stages import TABLE

    overrides = list(options.overrides)
    if options.outline:
        overrides.append(f"outline.points='{options.outline}'")
    if options.driven_from:
        if options.item != "lights":
            raise RequestError(f"--driven-from is for `calibrate lights`; {options.item} has no weights")
        overrides.append(f"lights.driven_from={options.driven_from}")
    graph = load_graph(pipeline_path(options.pipeline, "calibration.yaml"), TABLE, overrides=overrides)
    if options.item not in graph.nodes:
        raise RequestError(f"{graph.source} has no node '{options.item}'")
    return make_plan(graph, session, store, bound_items(session, store, given), [options.item])


def _run(plan: "Plan", store: Store, screen: Screen) -> tuple[dict[str, Any], Path]:
    from lightstage.dag.places import Where
    from lightstage.dag.run import run

    with RunWatcher(screen) as watcher:
        _, results = run(plan, store, watcher, where=Where(), versions=versions())
    nodes, rows = {}, []
    for name, done in results.items():
        nodes[name] = {
            "computed": done.computed,
            "reused": done.reused,
            "seconds": round(done.seconds, 3),
            "bytes": done.size,
            "path": str(done.path),
        }
        rows.append((name, done.computed, done.reused, f"{done.seconds:.2f}", human_size(done.size)))
    screen.table(("node", "computed", "reused", "seconds", "size"), rows, right=(1, 2, 3, 4))
    path = results[plan.targets[0]].path
    assert path is not None
    return nodes, path


def read_result(plan: "Plan", path: Path) -> "Result":
    """What a target node found, as its `item` and `verdict` read it."""
    from lightstage.dag.stage import Result
    from lightstage.store.grid import open_dataset

    opened = open_dataset(path)
    arrays = {
        str(name): opened[name].isel(all=0).values if "all" in opened[name].dims else opened[name].values
        for name in opened.data_vars
    }
    labels = {str(name): opened[name].values.tolist() for name in opened.coords}
    items = {kind: item.values for kind, item in plan.items.items()}
    facts = {**plan.session.facts, "shape": list(plan.session.shape)}
    return Result(arrays, labels, dict(opened.attrs), facts, items)


def keep_item(content: Mapping[str, Any], session: "Session", store: Store) -> "tuple[Item, Path]":
    """Write an item and its pictures into a scratch folder, check it as any other, and keep it in the store."""
    import cv2

    from lightstage.store import document
    from lightstage.store.calibration import put_item, read_item

    folder = store.scratch.path()
    folder.mkdir(parents=True)
    plain = dict(content)
    images = plain.pop("images", {})
    if images:
        plain["images"] = {camera: f"{plain['item']}_{camera}.png" for camera in images}
        for camera, pixels in images.items():
            if not cv2.imwrite(str(folder / plain["images"][camera]), pixels):
                raise WorkError(f"{folder / plain['images'][camera]} cannot be written; is the disk full?")
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


def changes_since(item: "Item", shape: tuple[int, int], store: Store) -> "list[Finding]":
    """What has moved since the last item of this kind and rig; `shape` is that of the pictures (rows, columns)."""
    from lightstage.dag.stage import Finding
    from lightstage.store.calibration import all_items

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
        shift = shift_px(last.values["matrix"], item.values["matrix"], shape)
        severity: Literal["good", "doubtful"] = "doubtful" if shift > _MOVED_PX else "good"
        return [Finding(severity, f"{item.values['from']} moved {shift:.2f} px {since}")]
    if item.kind == "lights":
        before = {light["id"]: light for light in last.values["lights"]}
        moved = []
        for light in item.values["lights"]:
            old = before.get(light["id"])
            if old and old["position_mm"] and light["position_mm"]:
                way = (
                    sum((a - b) ** 2 for a, b in zip(old["position_mm"], light["position_mm"], strict=True)) ** 0.5
                )
                if way > _MOVED_MM:
                    moved.append(Finding("doubtful", f"{light['id']} moved {way:.0f} mm {since}"))
        return moved
    return []


def shift_px(before: Sequence[Sequence[float]], now: Sequence[Sequence[float]], shape: tuple[int, int]) -> float:
    """Mean distance between two homographies' images of a picture of `shape` (rows, columns), px."""
    import numpy as np

    a, b = np.asarray(before), np.asarray(now)
    x, y = np.meshgrid(np.linspace(0, shape[1] - 1, 9), np.linspace(0, shape[0] - 1, 7))
    points = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    p, q = a @ points, b @ points
    return float(np.linalg.norm(p[:2] / p[2] - q[:2] / q[2], axis=0).mean())
