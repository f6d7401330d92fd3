"""demo: the virtual rig as a capture, imported with its ground truth beside it; or a calibration target.

A performance with the minimal sequence uses mixed sets: in that order nine pictures reach the base pairs of all
three axes, where pure sets take thirty-six to come round.
"""

import argparse
import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from lightstage.cli.show import Screen
from lightstage.cli.values import whole
from lightstage.store.errors import RequestError
from lightstage.store.files import link_or_copy
from lightstage.store.root import Store

TARGETS = {
    "ball": "lights",
    "boards": "homography",
    "dark": "dark",
    "flat": "flat",
    "exposures": "flat",
    "white": "bands",
    "sync": "synchronisation",
    "polarisers": "polarisers",
}
"""Calibration targets of the virtual rig, and the item that each is for."""
BANDS, BROADBAND = "407,434,445,497,576,655", "0"
TRACKING = 3
"""Tracking frames of a performance: with the minimal sequence each axis is the base pair once."""


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    demo = commands.add_parser("demo", help="capture a head with the virtual rig, and import it")
    demo.add_argument("--session", default="demo", metavar="NAME")
    demo.add_argument("--size", default="406x309", metavar="WxH", help="pixels (default: 406x309)")
    demo.add_argument(
        "--bands",
        metavar="NM,...",
        help=f"wavelengths; 0 for unfiltered light (default: {BANDS}; {BROADBAND} for a performance)",
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
        help="of a performance: about 1, or 3 to 5 pixels a picture at 406x309 (default: slow)",
    )
    demo.set_defaults(handler=handle_demo)


def handle_demo(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage demo."""
    store = Store(options.store)
    size = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", options.size)
    if not size:
        raise RequestError(f"--size {options.size}: expected WIDTHxHEIGHT, such as 406x309")
    performance = options.sequence != "static"
    wavelengths = options.bands or (BROADBAND if performance else BANDS)
    if not re.fullmatch(r"[0-9]{1,5}(,[0-9]{1,5})*", wavelengths):
        raise RequestError(f"--bands {wavelengths}: expected wavelengths in nm, such as 434,576")
    bands = tuple(int(band) for band in wavelengths.split(","))
    if performance and options.target:
        raise RequestError(f"--sequence {options.sequence}: a calibration target does not perform; leave one out")
    for option, value in (("--tracking", options.tracking), ("--motion", options.motion)):
        if value is not None and not performance:
            raise RequestError(f"{option} {value}: only a performance has it; add --sequence wilson or minimal")
    from lightstage.store.capture import NAME_RULE, SESSION_NAME

    if not SESSION_NAME.fullmatch(options.session):
        raise RequestError(f"--session '{options.session}': a name has {NAME_RULE}")
    if len(set(bands)) < len(bands):
        raise RequestError(f"--bands {wavelengths}: a wavelength stands twice")
    if options.target:
        return _target(options, store, screen, int(size[1]), int(size[2]), bands)
    name = options.session
    if performance and name == "demo":
        name = f"demo-{options.sequence}"
    name = demo_session(
        store,
        screen,
        name=name,
        width=int(size[1]),
        height=int(size[2]),
        bands_nm=bands,
        seed=options.seed,
        **(_performance(options) if performance else {}),
    )
    folder = store.sessions / name
    screen.document({"session": name, "raw": str(folder / "raw.zarr"), "truth": str(folder / "truth")})
    return 0


def _performance(options: argparse.Namespace) -> dict[str, Any]:
    from lightstage.hw.errors import RigError
    from lightstage.hw.sequence import minimal, wilson

    tracking = TRACKING if options.tracking is None else options.tracking
    try:
        sequence = wilson(tracking) if options.sequence == "wilson" else minimal(tracking, sets="mixed")
    except RigError as error:
        raise RequestError(f"--tracking {error}") from None
    return {"sequence": sequence, "motion": options.motion or "slow"}


def _target(
    options: argparse.Namespace, store: Store, screen: Screen, width: int, height: int, bands: tuple[int, ...]
) -> int:
    from lightstage.hw import ball_targets, flat_targets
    from lightstage.hw.errors import RigError
    from lightstage.hw.virtual_rig import Shot

    name = options.session if options.session != "demo" else f"demo-{options.target}"
    folder = store.root / "captures" / f"{name}-{width}x{height}-{options.seed}"
    try:
        shot = Shot(
            session=name,
            width=width,
            height=height,
            seed=options.seed,
            bands_nm=bands if options.target == "white" else (0,),
        )
        screen.say(f"the virtual rig captures: {options.target}")
        capture: Mapping[str, Callable[..., Any]] = {
            "ball": ball_targets.mirror_ball,
            "boards": flat_targets.checkerboard,
            "dark": flat_targets.uniform,
            "flat": partial(flat_targets.uniform, kind="flat"),
            "exposures": flat_targets.exposures,
            "white": flat_targets.bands,
            "sync": ball_targets.sync,
            "polarisers": ball_targets.polarisers,
        }
        capture[options.target](shot, folder)
    except RigError as error:
        raise RequestError(str(error)) from None
    item = TARGETS[options.target]
    screen.say(f"capture: {folder}")
    screen.say(f"`lightstage calibrate {item} --from {folder} --report` measures it")
    screen.document({"capture": str(folder), "item": item, "truth": str(folder / "truth" / "truth.yaml")})
    return 0


def demo_session(store: Store, screen: Screen, *, name: str = "demo", **shot: Any) -> str:
    """Capture with the virtual rig unless the same capture is there, import it, and return the session's name."""
    from lightstage.cli.sessions import import_folder
    from lightstage.hw.errors import RigError
    from lightstage.hw.virtual_rig import Shot, capture
    from lightstage.store.digest import SHORT, digest_value

    store.scratch.make_folder(store.root / "captures")
    try:
        wanted = Shot(session=name, **shot)
        folder = store.root / "captures" / f"{name}-{digest_value(_options(wanted))[:SHORT]}"
        if not folder.is_dir():
            what = "illuminations" if wanted.motion is None else f"pictures of a head in {wanted.motion} motion"
            screen.say(f"the virtual rig captures {len(wanted.sequence)} {what} in {len(wanted.bands_nm)} band(s)")
        capture(wanted, folder)
    except RigError as error:
        raise RequestError(str(error)) from None
    import_folder(folder, store, screen)
    truth = store.sessions / name / "truth"
    truth.mkdir(exist_ok=True)
    made = {path.name for path in (folder / "truth").iterdir()}
    for stale in [path for path in truth.iterdir() if path.name not in made]:
        stale.unlink()  # of a capture that this session held before
    for path in (folder / "truth").iterdir():
        (truth / path.name).unlink(missing_ok=True)
        link_or_copy(path, truth / path.name)
    return name


def moving_session(store: Store, screen: Screen) -> str:
    """The performance that `demo --sequence minimal` captures; returns the session's name."""
    from lightstage.hw.sequence import minimal

    return demo_session(
        store,
        screen,
        name="demo-minimal",
        bands_nm=(int(BROADBAND),),
        sequence=minimal(TRACKING, sets="mixed"),
        motion="slow",
    )


def _options(shot: Any) -> dict[str, Any]:
    return {key: list(value) if isinstance(value, tuple) else value for key, value in shot.described().items()}
