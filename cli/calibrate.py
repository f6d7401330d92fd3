"""calibrate: measure a calibration item from pictures of a target."""

import argparse
from pathlib import Path
from typing import Any

from lightstage.api.errors import RequestError
from lightstage.api.pipelines import MEASURED
from lightstage.api.stores import open_store
from lightstage.cli.run import plain_nodes, say_nodes
from lightstage.cli.sessions import say_imported
from lightstage.cli.show import RunWatcher, Screen


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
    from lightstage.api.calibration import measure

    changes = list(options.overrides)
    if options.outline:
        changes.append(f"outline.points='{options.outline}'")
    if options.driven_from:
        if options.item != "lights":
            raise RequestError(f"--driven-from is for `calibrate lights`; {options.item} has no weights")
        changes.append(f"lights.driven_from={options.driven_from}")
    with RunWatcher(screen) as watcher:
        measurement = measure(
            open_store(options.store),
            options.item,
            options.folders,
            session=options.session,
            changes=changes,
            items=options.calibration,
            pipeline=options.pipeline,
            out=options.out,
            imported=lambda done: say_imported(done, screen),
            importing=screen.progress,
            progress=watcher,
        )
    say_nodes(measurement.answer, screen)
    if measurement.item is not None:
        screen.say(f"{measurement.item}: `lightstage calibration use {measurement.item} --session S` binds it")
    if measurement.written is not None:
        screen.say(f"item: {measurement.written}")
    if measurement.item is None and options.out is not None:
        screen.warn(f"{options.item} is a check, not an item: nothing to write to {options.out}; try --report")
    for finding in measurement.verdict:
        screen.say(finding.sentence)
    report = None
    if options.report is not None:
        report = measurement.report(
            options.report if options.report.name else f"{measurement.session.name}-{options.item}.html"
        )
        screen.say(f"report: {report}")
    screen.document(
        {
            "session": measurement.session.name,
            "item": measurement.item,
            "nodes": plain_nodes(measurement.answer),
            "verdict": [finding.sentence for finding in measurement.verdict],
            "severities": [finding.severity for finding in measurement.verdict],
            "out": None if measurement.written is None else str(measurement.written),
            "report": None if report is None else str(report),
        }
    )
    return 0
