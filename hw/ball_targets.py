"""Captures of a ball as the virtual rig sees it: under one light, all, test patterns, and turned polarisers.

What the seed decides: the rig's tolerances and sensors (`Rig.made`), where the ball stands, the power of every
light, and the noise. `truth/truth.yaml` says all of it.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lightstage.hw import target_scenes as scenes
from lightstage.hw.capture_folder import Exposure, written
from lightstage.hw.errors import RigError
from lightstage.hw.gradients import weights
from lightstage.hw.illuminations import light_name
from lightstage.hw.sensor import OFFSET, WHITE
from lightstage.hw.virtual_rig import CAMERA_MM, RADIUS_MM, Rig, Shot

BALL_MM = 38.1
ROOM = 2.0
"""Room light on the background, counts."""
EXTINCTION = 1 / 400
"""What a crossed pair of the rig's sheet polarisers lets through."""
Array = NDArray[np.float64]


def mirror_ball(
    shot: Shot,
    folder: Path,
    *,
    positions: int = 1,
    dead: Sequence[int] = (),
    swapped: tuple[int, int] | None = None,
) -> Path:
    """A chrome ball under each light and under all, at one or more places (frame key `part`).

    Args:
        dead: lights that do not light.
        swapped: two channels that drive one another's light.
    """
    rig, generator = Rig.made(shot), np.random.default_rng([shot.seed, 20])
    power = _power(rig, generator, dead)
    wired = np.arange(len(rig.lights))
    if swapped:
        wired[list(swapped)] = wired[list(swapped)[::-1]]
    places = [_place(generator) for _ in range(positions)]
    balls = [_Ball(shot, rig, place, power) for place in places]

    def frames() -> Iterable[Exposure]:
        names = [light_name(k) for k in range(len(wired))] + ["C", "O"]
        for part, ball in enumerate(balls):
            for name in names:
                yield {"illumination": name, "part": part}, {(0, 1): ball.lit(weights(name, rig.ideal)[wired])}

    truth = {"parts": [ball.truth() for ball in balls], "dead": list(dead), "swapped": list(swapped or ())}
    truth |= {"power": power, "light_mm": rig.lights}
    target = {"kind": "mirror_ball", "radius_mm": BALL_MM}
    options = {"positions": positions, "dead": list(dead), "swapped": list(swapped or ())}
    return written(shot, folder, target, options, frames, truth, cameras=(1,))


def sync(
    shot: Shot,
    folder: Path,
    *,
    cycles: int = 4,
    leak: float = 0.04,
    order: Sequence[int] | None = None,
) -> Path:
    """One light at a time, none, then T0 to T3 again and again on the mirror ball, each picture of these with
    a little of the illuminations before and after.

    Args:
        leak: the most that either neighbour may contribute, of the exposure; the seed draws both.
        order: which step of the sequence each picture really shows; None for 0, 1, 2, ...
    """
    rig, generator = Rig.made(shot), np.random.default_rng([shot.seed, 21])
    power = _power(rig, generator, ())
    ball = _Ball(shot, rig, _place(generator), power)
    names = [f"T{i % 4}" for i in range(4 * cycles)]
    shown = list(range(len(names))) if order is None else list(order)
    drive = np.array([weights(n, rig.ideal) for n in ["O", *names, "O"]])
    before, after = generator.uniform(0, leak, 2)
    parts = np.clip([before, after] + 0.002 * generator.standard_normal((len(shown), 2)), 0, None)

    def frames() -> Iterable[Exposure]:
        for k in range(len(rig.lights)):
            name = light_name(k)
            yield {"illumination": name}, {(0, 1): ball.lit(weights(name, rig.ideal))}
        yield {"illumination": "C"}, {(0, 1): ball.lit(weights("C", rig.ideal))}
        yield {"illumination": "O"}, {(0, 1): ball.lit(0 * power)}
        for i, (step, (early, late)) in enumerate(zip(shown, parts, strict=True)):
            # neighbours are those of the sequence, whatever order the pictures were stored in
            mixed = (1 - early - late) * drive[step + 1] + early * drive[step] + late * drive[step + 2]
            yield {"illumination": names[i % len(names)]}, {(0, 1): ball.lit(mixed)}

    truth = {"shown": shown, "leak_before": parts[:, 0], "leak_after": parts[:, 1], **ball.truth(), "power": power}
    options = {"cycles": cycles, "leak": leak, "order": list(order or ())}
    return written(
        shot, folder, {"kind": "mirror_ball", "radius_mm": BALL_MM}, options, frames, truth, cameras=(1,)
    )


def polarisers(
    shot: Shot,
    folder: Path,
    *,
    ball: Literal["plastic", "chrome"] = "plastic",
    angles_deg: Sequence[float] = tuple(range(0, 180, 15)),
) -> Path:
    """A ball under each light at several settings of that light's polariser (frame key `polariser_deg`), behind the
    cross camera's analyser, in a dark room. Each light has an exposure of its own (frame key `exposure_s`)."""
    rig, generator = Rig.made(shot), np.random.default_rng([shot.seed, 22])
    power = _power(rig, generator, ())
    scene = _Ball(shot, rig, _place(generator), power, room=0.0)
    index = scenes.PLASTIC if ball == "plastic" else scenes.CHROMIUM
    law = scenes.polarised(scene.hit, rig.lights, CAMERA_MM, index, EXTINCTION)
    mounted = np.radians(generator.uniform(0, 180, len(power)))
    theta0 = np.mod(law[:, 2] - mounted, np.pi)
    top = law[:, 0] + law[:, 1]
    # one second brings a perfect mirror's highlight to where `lit` has it; no light is exposed longer than a minute
    exposure = np.round(np.minimum(1 / np.maximum(top, 1e-9), 60), 4)

    def frames() -> Iterable[Exposure]:
        for k in range(len(power)):
            for angle in angles_deg:
                passed = law[k, 0] + law[k, 1] * np.cos(np.radians(angle) - theta0[k]) ** 2
                drive = np.where(np.arange(len(power)) == k, passed * exposure[k], 0)
                keys = {"illumination": light_name(k), "polariser_deg": angle, "exposure_s": float(exposure[k])}
                yield keys, {(0, 1): scene.lit(drive)}
        # under all lights, turned open, the outline shows
        yield {"illumination": "C"}, {(0, 1): scene.lit(weights("C", rig.ideal))}

    truth = {
        **scene.truth(),
        "a": law[:, 0],
        "b": law[:, 1],
        "theta0_deg": np.degrees(theta0),
        "mount_deg": np.degrees(mounted),
    }
    material = "metal" if ball == "chrome" else "dielectric"
    target = {"kind": "mirror_ball", "radius_mm": BALL_MM, "material": material}
    return written(
        shot, folder, target, {"ball": ball, "angles_deg": list(angles_deg)}, frames, truth, cameras=(1,)
    )


class _Ball:
    """A ball somewhere, and what it looks like under any drive of the lights."""

    def __init__(self, shot: Shot, rig: Rig, centre: Array, power: Array, room: float = ROOM) -> None:
        self.shape = (shot.height, shot.width)
        self.centre = centre
        self.hit = scenes.highlights(rig.lights, centre, BALL_MM, rig.K, CAMERA_MM)
        # a small ball scatters a distant light evenly in all directions (radius^2 / 4), so distance alone counts
        distance = np.linalg.norm(rig.lights - self.hit.point_mm, axis=1)
        peak = 0.75 * (WHITE - OFFSET) * 2 * np.pi * scenes.PSF_PX**2
        self.flux = peak / 1.25 * power * (RADIUS_MM / distance) ** 2 * self.hit.visible
        self.dim = room
        self.room = scenes.ball_and_stand(self.shape, centre, BALL_MM, rig.K, CAMERA_MM, 1.0)
        self.share = power / power.size

    def lit(self, drive: Array) -> Array:
        """(y, x) under `drive` (light,)."""
        around = (self.dim + 12 * float(drive @ self.share)) * self.room
        return around + scenes.spots(self.shape, self.hit.pixel, self.flux * drive)

    def truth(self) -> dict[str, Any]:
        return {
            "centre_mm": self.centre,
            "highlight_px": self.hit.pixel,
            "visible": self.hit.visible,
            "incidence_deg": self.hit.incidence_deg,
            "flux_counts": self.flux,
        }


def _power(rig: Rig, generator: np.random.Generator, dead: Sequence[int]) -> Array:
    if any(not 0 <= k < len(rig.lights) for k in dead):
        raise RigError(f"lights {list(dead)} cannot be dead: this rig has L00 to {light_name(len(rig.lights) - 1)}")
    power = generator.uniform(0.85, 1.1, len(rig.lights))
    power[list(dead)] = 0
    return power


def _place(generator: np.random.Generator) -> Array:
    return generator.uniform([-22, -14, -15], [22, 18, 15])
