"""demo: the virtual rig as a capture, imported with its ground truth beside it; or a calibration target."""

import argparse
import re
from typing import Any

from lightstage.api.errors import RequestError
from lightstage.api.stores import OpenSession, OpenStore, open_store
from lightstage.api.virtual_rig import (
    BANDS_NM,
    BROADBAND_NM,
    SIZE,
    TARGETS,
    TRACKING,
    Head,
    capture_head,
    capture_target,
    keep_truth,
)
from lightstage.cli.show import Screen
from lightstage.cli.values import whole

_SIZE = "x".join(map(str, SIZE))
_BANDS, _BROADBAND = (",".join(map(str, bands)) for bands in (BANDS_NM, BROADBAND_NM))


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    demo = commands.add_parser("demo", help="capture a head with the virtual rig, and import it")
    demo.add_argument("--session", default="demo", metavar="NAME")
    demo.add_argument("--size", default=_SIZE, metavar="WxH", help=f"pixels (default: {_SIZE})")
    demo.add_argument(
        "--bands",
        metavar="NM,...",
        help=f"wavelengths; 0 for unfiltered light (default: {_BANDS}; {_BROADBAND} for a performance)",
    )
    demo.add_argument(
        "--seed", type=whole, default=1, metavar="N", help="another head, skin, rig and noise; 0: the mean"
    )
    demo.add_argument(
        "--target", choices=TARGETS, help="capture a calibration target instead: a folder for `calibrate`"
    )
    demo.add_argument(
        "--sequence",
        choices=("static", "wilson", "minimal"),
        default="static",
        help="a still head, or a performance of a moving one at 60 pictures a second, cross camera only",
    )
    demo.add_argument(
        "--tracking", type=whole, metavar="N", help=f"tracking frames of a performance (default: {TRACKING})"
    )
    demo.add_argument(
        "--motion",
        choices=("slow", "fast", "still"),
        help=f"of a performance: about 1, or 3 to 5 pixels a picture at {_SIZE} (default: slow)",
    )
    demo.set_defaults(handler=handle_demo)


def handle_demo(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage demo."""
    head = _head(options)
    store = open_store(options.store)
    if options.target:
        return _target(options.target, head, store, screen)
    folder = head_session(store, screen, head).folder
    screen.document({"session": head.session, "raw": str(folder / "raw.zarr"), "truth": str(folder / "truth")})
    return 0


def _head(options: argparse.Namespace) -> Head:
    size = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", options.size)
    if not size:
        raise RequestError(f"--size {options.size}: expected WIDTHxHEIGHT, such as 406x309")
    if options.bands and not re.fullmatch(r"[0-9]{1,5}(,[0-9]{1,5})*", options.bands):
        raise RequestError(f"--bands {options.bands}: expected wavelengths in nm, such as 434,576")
    performance = options.sequence != "static"
    if performance and options.target:
        raise RequestError(f"--sequence {options.sequence}: a calibration target does not perform; leave one out")
    for option, value in (("--tracking", options.tracking), ("--motion", options.motion)):
        if value is not None and not performance:
            raise RequestError(f"{option} {value}: only a performance has it; add --sequence wilson or minimal")
    name = options.session
    if name == "demo" and (options.target or performance):
        name = f"demo-{options.target or options.sequence}"
    return Head(
        session=name,
        size=(int(size[1]), int(size[2])),
        bands_nm=tuple(map(int, options.bands.split(","))) if options.bands else None,
        seed=options.seed,
        sequence=options.sequence,
        tracking=TRACKING if options.tracking is None else options.tracking,
        motion=options.motion or "slow",
    )


def _target(target: str, head: Head, store: OpenStore, screen: Screen) -> int:
    folder = capture_target(store.create(), target, head, screen.say)
    item = TARGETS[target]
    screen.say(f"capture: {folder}")
    screen.say(f"`lightstage calibrate {item} --from {folder} --report` measures it")
    screen.document({"capture": str(folder), "item": item, "truth": str(folder / "truth" / "truth.yaml")})
    return 0


def head_session(store: OpenStore, screen: Screen, head: Head) -> OpenSession:
    """The session of a head that the virtual rig captures, unless the same capture is there."""
    from lightstage.cli.sessions import import_folder

    folder = capture_head(store.create(), head, screen.say)
    session = import_folder(folder, store, screen).session
    keep_truth(store.opened, session.name, folder)
    return session
