"""The virtual rig: a head captured into a store with its ground truth beside it, or a calibration target's folder.

A performance with the minimal sequence uses mixed sets: in that order nine pictures reach the base pairs of all
three axes, where pure sets take thirty-six to come round.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.hw.virtual_rig import Shot

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
"""Calibration targets, and the item that each is for."""
BANDS_NM, BROADBAND_NM = (407, 434, 445, 497, 576, 655), (0,)
SIZE = (406, 309)
TRACKING = 3
"""Tracking frames of a performance: with the minimal sequence each axis is the base pair once."""


@dataclass(frozen=True)
class Head:
    """What to capture: a still head, or the performance of a moving one, by the cross camera alone."""

    session: str = "demo"
    size: tuple[int, int] = SIZE
    """Width and height, pixels."""
    bands_nm: tuple[int, ...] | None = None
    """0: unfiltered. None: the thesis' six, or unfiltered for a performance."""
    seed: int = 1
    """Another head, skin, rig and noise; 0: the mean."""
    sequence: Literal["static", "wilson", "minimal"] = "static"
    tracking: int = TRACKING
    """Tracking frames of a performance."""
    motion: Literal["slow", "fast", "still"] = "slow"
    """Of a performance."""


PERFORMANCE = Head(session="demo-minimal", sequence="minimal")


def capture_head(store: Store, head: Head, announce: Callable[[str], object] = lambda text: None) -> Path:
    """Capture a head unless the same capture is there; returns its folder, which is to be imported.

    Args:
        announce: is told what is captured, before that begins.

    Raises:
        RequestError: the virtual rig cannot capture that.
    """
    from lightstage.hw.virtual_rig import capture
    from lightstage.store.digest import SHORT, digest_value

    _check(head)
    root = store.root
    store.scratch.make_folder(root / "captures")
    with _rig_errors():
        shot = _shot(head)
        described = {key: list(v) if isinstance(v, tuple) else v for key, v in shot.described().items()}
        folder = root / "captures" / f"{shot.session}-{digest_value(described)[:SHORT]}"
        if not folder.is_dir():
            what = "illuminations" if shot.motion is None else f"pictures of a head in {shot.motion} motion"
            announce(f"the virtual rig captures {len(shot.sequence)} {what} in {len(shot.bands_nm)} band(s)")
        capture(shot, folder)
    return folder


def keep_truth(store: Store, session: str, folder: Path) -> Path:
    """Lay a capture's ground truth beside the session that it has become; returns where."""
    from lightstage.store.files import link_or_copy

    truth = store.sessions / session / "truth"
    truth.mkdir(exist_ok=True)
    present = {path.name for path in (folder / "truth").iterdir()}
    for stale in [path for path in truth.iterdir() if path.name not in present]:
        stale.unlink()  # of a capture that this session held before
    for path in (folder / "truth").iterdir():
        (truth / path.name).unlink(missing_ok=True)
        link_or_copy(path, truth / path.name)
    return truth


def capture_target(store: Store, target: str, head: Head, announce: Callable[[str], object]) -> Path:
    """Capture a calibration target instead of a head; returns the folder, which is for `calibrate`.

    Raises:
        RequestError: the virtual rig cannot capture that.
    """
    from lightstage.hw import ball_targets, flat_targets
    from lightstage.hw.virtual_rig import Shot

    _check(head)
    width, height = head.size
    folder = store.root / "captures" / f"{head.session}-{width}x{height}-{head.seed}"
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
    with _rig_errors():
        shot = Shot(
            session=head.session,
            width=width,
            height=height,
            seed=head.seed,
            bands_nm=head.bands_nm or BANDS_NM if target == "white" else BROADBAND_NM,
        )
        announce(f"the virtual rig captures: {target}")
        capture[target](shot, folder)
    return folder


def _check(head: Head) -> None:
    from lightstage.store.names import NAME_RULE, SESSION_NAME

    if not SESSION_NAME.fullmatch(head.session):
        raise RequestError(f"--session '{head.session}': a name has {NAME_RULE}")
    bands = head.bands_nm or ()
    if len(set(bands)) < len(bands):
        raise RequestError(f"--bands {','.join(map(str, bands))}: a wavelength stands twice")


def _shot(head: Head) -> "Shot":
    from lightstage.hw.errors import RigError
    from lightstage.hw.sequence import minimal, wilson
    from lightstage.hw.virtual_rig import Shot

    performance = head.sequence != "static"
    bands = head.bands_nm or (BROADBAND_NM if performance else BANDS_NM)
    shot = partial(
        Shot, session=head.session, width=head.size[0], height=head.size[1], bands_nm=bands, seed=head.seed
    )
    if not performance:
        return shot()
    try:
        sequence = wilson(head.tracking) if head.sequence == "wilson" else minimal(head.tracking, sets="mixed")
    except RigError as error:
        raise RequestError(f"--tracking {error}") from None
    return shot(sequence=sequence, motion=head.motion)


@contextmanager
def _rig_errors() -> Iterator[None]:
    from lightstage.hw.errors import RigError

    try:
        yield
    except RigError as error:
        raise RequestError(str(error)) from None
