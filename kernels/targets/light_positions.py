"""Positions of all lights of a stage together, from highlights on a mirror ball and the planned layout.

    q_k' = r Q q_k + c         the layout's place k: turn Q, centre c, radius r
    minimise  sum_k rho(|P_k (q_k' - H_k)|^2 / (tau^2 + sigma_k^2))
              + |c|^2 / sigma_c^2 + (r - r0)^2 / sigma_r^2 + |S_c - S_c0|^2 / sigma_S^2
    p_k = (I / tau^2 + sum P_k / sigma_k^2)^-1 (q_k' / tau^2 + sum P_k H_k / sigma_k^2)

P_k = I - L_k L_k' goes across ray k (`light_rays`), tau is how far a light may be off its place, sigma_k how far
off its ray is at the light (mm). The ray fixes a light across, the layout along: one ball cannot tell how far away
a light is, nor, for practical purposes, how large the stage is; each further place of the ball adds its own P_k.

Sources: Kabsch (1976), doi:10.1107/S0567739476001873 (turn); Fischler, Bolles (1981), doi:10.1145/358669.358692;
Kuhn (1955), doi:10.1002/nav.3800020109 (assignment).
"""

from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, linear_sum_assignment
from scipy.spatial.transform import Rotation

from lightstage.hw.illuminations import light_name
from lightstage.kernels.errors import KernelError
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.targets.light_rays import (
    Floats,
    across_rays,
    angle,
    light_rays,
    on_stage,
    predicted_px,
    ray_sigma,
    to_world,
)


class Highlights(NamedTuple):
    """Where the lights show on each ball; NaN where one is not seen."""

    at_px: Floats
    """(ball, light, xy)."""
    sigma_px: Floats
    """(ball, light)."""


class Balls(NamedTuple):
    """Mirror balls of one size, or one at several places."""

    centre_mm: Floats
    """(ball, xyz), camera frame."""
    radius_mm: float
    sigma_mm: tuple[float, float] = (0.1, 0.5)
    """How well the centres are known, across the line of sight and along it."""


class Layout(NamedTuple):
    """Where the lights were planned, and how well that holds."""

    places: Floats
    """(place, xyz), unit: those of the lights by their numbers, and what there is beyond."""
    radius_mm: float
    radius_sigma_mm: float = 3.0
    """One ball says little about the radius."""
    centre_sigma_mm: float = 2.0
    """How well the layout's centre is known to be the world's origin."""
    placement_sigma_mm: float = 5.0
    """tau."""


class Finding(NamedTuple):
    """Something about the wiring that somebody should look at."""

    kind: Literal["swapped", "elsewhere", "same place", "no place", "off its place", "dead"]
    lights: tuple[int, ...]
    sentence: str


class Refined(NamedTuple):
    """All lights of a stage, world frame."""

    position_mm: Floats
    """(light, xyz); NaN for a light that was not seen and whose place is not known."""
    sigma_mm: Floats
    """(light): how far off, one standard deviation of the worst direction."""
    place: NDArray[np.int64]
    """(light): row of the layout where it is; -1 if at none or unknown."""
    seen: NDArray[np.bool_]
    """(light): False where only the layout says where it is."""
    residual_mm: Floats
    """(light): from its place, across its ray; NaN if not seen."""
    turn: Floats
    """(3, 3): rotation of the layout."""
    centre_mm: Floats
    radius_mm: float
    ball_mm: Floats
    """(ball, xyz), camera frame: where the balls are, if the lights have their say."""
    findings: tuple[Finding, ...]


_SOFT = 2.5
"""Sigmas from which a light pulls less: one that was mounted elsewhere must not turn the stage."""
_FAR = 4.0
"""Sigmas from which a light is off its place."""
_RIM_PX = 3.0
"""The stand hides lights at the edge of what is seen; one farther inside than this is no stand's work."""
_TURN_RAD = 0.003
"""Usual change of the turn, for the solver's scale."""


def refine(highlights: Highlights, balls: Balls, camera: Pinhole, layout: Layout) -> Refined:
    """Place all lights together with the layout they were built to, and find what is wired wrongly.

    The ball's centre gets a correction too: a tenth of a millimetre turns all directions by up to 0.3 degrees, and
    a faint outline leaves about that; the mean over all lights knows better.

    Raises:
        KernelError: fewer than four lights seen, or the directions do not fit the layout.
    """
    start = _start(highlights, balls, camera, layout)
    stage = _Stage(highlights, balls, camera, layout, start)
    x = stage.solution()
    position, sigma, residual, findings = _positions(stage, x)
    ball_mm = stage.ball_mm(x)
    dead = _dead(position, highlights.at_px[0], start, ball_mm[0], balls.radius_mm, camera)
    return Refined(
        position_mm=position,
        sigma_mm=sigma,
        place=start.place,
        seen=start.seen,
        residual_mm=residual,
        turn=stage.turn(x),
        centre_mm=x[3:6],
        radius_mm=layout.radius_mm + x[6],
        ball_mm=ball_mm,
        findings=(*start.findings, *findings, *dead),
    )


def _rays(highlights: Highlights, centres: Floats, radius_mm: float, camera: Pinhole) -> tuple[Floats, Floats]:
    """Points on the balls and directions to the lights, (ball, light, xyz), world."""
    points, directions = np.empty((2, *highlights.at_px.shape[:2], 3))
    for m, centre in enumerate(centres):
        ray = light_rays(highlights.at_px[m], centre, radius_mm, camera.matrix, distortion=camera.lens)
        points[m], directions[m] = to_world(*ray, camera.rotation, camera.translation)
    return points, directions


class _Start(NamedTuple):
    """What the rays tell by themselves."""

    shown: NDArray[np.bool_]
    """(ball, light)."""
    seen: NDArray[np.bool_]
    """(light): on any ball."""
    position_mm: Floats
    """(light, xyz): on the stage's sphere, by the first ball that shows it."""
    sigma_mm: Floats
    """(ball, light): error of the ray at the light."""
    turn: Floats
    """(3, 3): of the layout."""
    place: NDArray[np.int64]
    """(light)."""
    used: NDArray[np.int64]
    """Numbers of the lights that are seen and have a place."""
    findings: tuple[Finding, ...]


def _start(highlights: Highlights, balls: Balls, camera: Pinhole, layout: Layout) -> _Start:
    points, directions = _rays(highlights, balls.centre_mm, balls.radius_mm, camera)
    shown = np.isfinite(directions[..., 0])
    seen: NDArray[np.bool_] = np.any(shown, axis=0)
    if seen.sum() < 4:
        raise KernelError(f"{seen.sum()} lights were seen on the ball; the layout needs four or more")
    first, every = shown.argmax(0), np.arange(shown.shape[1])
    position = on_stage(points[first, every], directions[first, every], layout.radius_mm)
    unit = position / np.linalg.norm(position, axis=1, keepdims=True)
    gate = 0.5 * float(np.arccos(_spacing(layout.places)))
    turn = _turn_of_most(unit[seen], layout.places[seen], gate)
    sigma_rad = np.stack([
        ray_sigma(at, sigma, centre, balls.radius_mm, camera.matrix, distortion=camera.lens)
        for at, sigma, centre in zip(*highlights, balls.centre_mm, strict=True)
    ])  # fmt: skip
    place, findings = _wiring(unit, layout.places @ turn.T, sigma_rad[first, every], seen, gate)
    used = np.flatnonzero(seen & (place >= 0))
    if used.size < max(4, seen.sum() / 2):
        raise KernelError("the directions do not fit the layout; check the camera's pose and the layout's order")
    sigma_mm = sigma_rad * np.linalg.norm(position - points, axis=2)
    return _Start(shown, seen, position, sigma_mm, turn, place, used, tuple(findings))


class _Stage:
    """The unknowns x and their cost: rotation vector (3), centre (3), change of the radius, moves of the balls."""

    def __init__(
        self, highlights: Highlights, balls: Balls, camera: Pinhole, layout: Layout, start: _Start
    ) -> None:
        self._highlights, self._balls, self._camera = highlights, balls, camera
        self.layout, self.start = layout, start
        self.across_mm = np.hypot(layout.placement_sigma_mm, start.sigma_mm)
        """(ball, light): how far from its ray a light's place may be."""
        side, depth = balls.sigma_mm
        self._prior = np.array(
            [np.inf] * 3
            + [layout.centre_sigma_mm] * 3
            + [layout.radius_sigma_mm]
            + [side, side, depth] * len(balls.centre_mm)
        )

    def turn(self, x: Floats) -> Floats:
        """(3, 3) of the layout."""
        return np.asarray(Rotation.from_rotvec(x[:3]).as_matrix() @ self.start.turn)

    def ball_mm(self, x: Floats) -> Floats:
        """(ball, xyz), camera frame."""
        return np.asarray(self._balls.centre_mm + x[7:].reshape(-1, 3))

    def rays(self, x: Floats) -> tuple[Floats, Floats]:
        """As `_rays`."""
        return _rays(self._highlights, self.ball_mm(x), self._balls.radius_mm, self._camera)

    def places(self, x: Floats) -> Floats:
        """(place, xyz), world, mm."""
        return np.asarray((self.layout.radius_mm + x[6]) * self.layout.places @ self.turn(x).T + x[3:6])

    def gaps(self, x: Floats) -> Floats:
        """(ball, used light, xyz): from rays to places, across the rays, mm."""
        used = self.start.used
        points, directions = self.rays(x)
        gap = self.places(x)[self.start.place[used]] - points[:, used]
        return np.asarray(gap - (gap * directions[:, used]).sum(-1, keepdims=True) * directions[:, used])

    def _cost(self, x: Floats) -> Floats:
        used = self.start.used
        flat = (self.gaps(x) / self.across_mm[:, used, None])[self.start.shown[:, used]]
        size = np.linalg.norm(flat, axis=1)
        less = np.sqrt(2 * _SOFT * np.maximum(size, _SOFT) - _SOFT**2) / np.maximum(size, 1e-9)
        soft = np.where(size > _SOFT, less, 1.0)
        return np.concatenate([(flat * soft[:, None]).ravel(), x / self._prior])

    def solution(self) -> Floats:
        """The x of least cost."""
        scale = np.where(np.isfinite(self._prior), self._prior, _TURN_RAD)
        return np.asarray(least_squares(self._cost, np.zeros(self._prior.size), x_scale=scale).x)


def _positions(stage: _Stage, x: Floats) -> tuple[Floats, Floats, Floats, list[Finding]]:
    """Every light where its rays and its place have it: position (light, xyz), sigma and residual (light)."""
    start, layout = stage.start, stage.layout
    lights = len(start.seen)
    ideal, residual = stage.places(x), np.full(lights, np.nan)
    residual[start.used] = np.where(start.shown[:, start.used], np.linalg.norm(stage.gaps(x), axis=2), 0).max(0)
    points, directions = stage.rays(x)
    position, sigma = np.full((lights, 3), np.nan), np.full(lights, np.nan)
    findings = []
    for k in range(lights):
        place = start.place[k]
        if not start.seen[k]:
            if place >= 0:
                position[k], sigma[k] = ideal[place], layout.placement_sigma_mm
            continue
        ray = start.shown[:, k]
        tau = layout.placement_sigma_mm if place >= 0 else layout.radius_sigma_mm
        middle = ideal[place] if place >= 0 else start.position_mm[k]
        if place >= 0 and residual[k] > _FAR * float(stage.across_mm[ray, k].max()):
            off_by = f"{residual[k]:.0f} mm off its place, more than four times what is allowed for"
            findings.append(Finding("off its place", (k,), f"{light_name(k)} is {off_by}"))
            tau = float(residual[k])  # then the place says little about it
        matrix, vector = across_rays(points[ray, k], directions[ray, k], start.sigma_mm[ray, k])
        matrix, vector = matrix + np.eye(3) / tau**2, vector + middle / tau**2
        position[k], sigma[k] = np.linalg.solve(matrix, vector), 1 / np.sqrt(np.linalg.eigvalsh(matrix)[0])
    return position, sigma, residual, findings


def _dead(
    position: Floats, at_px: Floats, start: _Start, ball_mm: Floats, radius_mm: float, camera: Pinhole
) -> list[Finding]:
    """Lights without a highlight, `at_px` (light, xy) of the first ball, in the midst of those that have one."""
    if start.shown[0].sum() <= 2:
        return []
    expected = predicted_px(camera.to_camera(position), ball_mm, radius_mm, camera.matrix)
    hull = cv2.convexHull(at_px[start.shown[0]].astype(np.float32)[:, None])
    lacks = "has no highlight of its own, though the lights around it have: dead, or not connected"
    return [
        Finding("dead", (k,), f"{light_name(k)} {lacks}")
        for k in np.flatnonzero(~start.seen & (start.place >= 0)).tolist()
        if cv2.pointPolygonTest(hull, (float(expected[k, 0]), float(expected[k, 1])), True) > _RIM_PX
    ]


def _wiring(
    unit: Floats, placed: Floats, sigma_rad: Floats, seen: NDArray[np.bool_], gate: float
) -> tuple[NDArray[np.int64], list[Finding]]:
    """The place of every light, and what is wired wrongly."""
    lights = np.flatnonzero(seen)
    apart = np.arccos(np.clip(unit[lights] @ placed.T, -1, 1))
    # a light at the rim may be degrees off: what its own error allows speaks against no place
    apart = np.maximum(apart - 3 * sigma_rad[lights, None], 0)
    # beyond the gate all places are equally wrong; a light keeps its own place where two would do
    cost = np.minimum(apart, gate)
    cost[np.arange(len(lights)), lights] -= 1e-3 * gate
    row, column = linear_sum_assignment(cost)
    place = np.full(len(seen), -1)
    findings: list[Finding] = []
    for i, j in zip(row, column, strict=True):
        k, nearest = int(lights[i]), int(apart[i].argmin())
        if apart[i, j] < gate:
            place[k] = j
        elif apart[i, nearest] < gate:
            place[k] = nearest
            other = [int(m) for m in lights if m != k and np.arccos(np.clip(unit[m] @ unit[k], -1, 1)) < gate]
            what = f"{light_name(k)} shows the same place as {', '.join(map(light_name, other))}: place {nearest}"
            findings.append(Finding("same place", (k, *other), what))
        else:
            away = f"{np.degrees(apart[i, nearest]):.1f} degrees from the nearest place of the layout"
            findings.append(Finding("no place", (k,), f"{light_name(k)} is {away}"))
    reported = {finding.lights[0] for finding in findings}
    for k in lights.tolist():
        j = int(place[k])
        if j >= 0 and j < len(seen) and place[j] == k and k < j:
            what = f"{light_name(k)} and {light_name(j)} are swapped: each shows at the other's place"
            findings.append(Finding("swapped", (k, j), what))
        elif j >= 0 and j != k and not (j < len(seen) and place[j] == k) and k not in reported:
            what = f"{light_name(k)} shows at the place of {light_name(j)}"
            findings.append(Finding("elsewhere", (k, j), what))
    free = [j for j in range(len(placed)) if j not in set(place.tolist())]
    for k in np.flatnonzero(~seen).tolist():
        if k in free:
            place[k] = k
    unknown = [k for k in np.flatnonzero(~seen) if place[k] < 0]
    left = [j for j in free if j not in set(place.tolist())]
    if len(unknown) == 1 and len(left) == 1:
        place[unknown[0]] = left[0]
    return place.astype(np.int64), findings


def _turn_of_most(unit: Floats, layout: Floats, gate: float) -> Floats:
    """Rotation with unit = Q layout for most of them."""
    random = np.random.default_rng(0)
    best, most = np.eye(3), -1.0
    for _ in range(200):
        some = random.choice(len(unit), min(3, len(unit)), replace=False)
        turn = _turn(unit[some], layout[some])
        fit = float(np.clip(1 - angle(unit, layout @ turn.T) / gate, 0, None).sum())
        if fit > most:
            best, most = turn, fit
    near = angle(unit, layout @ best.T) < 0.5 * gate
    return _turn(unit[near], layout[near]) if near.sum() >= 3 else best


def _turn(unit: Floats, layout: Floats) -> Floats:
    return np.asarray(Rotation.align_vectors(unit, layout)[0].as_matrix())


def _spacing(layout: Floats) -> float:
    """Cosine between the nearest two places."""
    return float((layout @ layout.T - 3 * np.eye(len(layout))).max())
