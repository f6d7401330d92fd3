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


class Camera(NamedTuple):
    """A camera item: X_camera = R X_world + t, mm; distortion k1 k2 p1 p2 k3 or None."""

    K: Floats
    R: Floats
    t_mm: Floats
    distortion: Floats | None = None


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


def refine(
    at_px: Floats, sigma_px: Floats, ball_mm: Floats, ball_radius_mm: float, camera: Camera, layout: Floats,
    radius_mm: float, *, radius_sigma_mm: float = 3.0, centre_sigma_mm: float = 2.0,
    placement_sigma_mm: float = 5.0, ball_sigma_mm: tuple[float, float] = (0.1, 0.5),
) -> Refined:  # fmt: skip
    """Place all lights together with the layout they were built to, and find what is wired wrongly.

    The ball's centre gets a correction too: a tenth of a millimetre turns all directions by up to 0.3 degrees, and
    a faint outline leaves about that; the mean over all lights knows better.

    Args:
        at_px, sigma_px: (ball, light, xy) and (ball, light), highlights; NaN where not seen.
        ball_mm: (ball, xyz) centres, camera frame.
        layout: (light, xyz), unit, the place of each light as it was planned.
        radius_mm, radius_sigma_mm: of the stage, and how well it is known; one ball says little about it.
        centre_sigma_mm: how well the layout's centre is known to be the world's origin.
        placement_sigma_mm: tau.
        ball_sigma_mm: how well the balls' centres are known, across the line of sight and along it.

    Raises:
        KernelError: fewer than four lights seen, or the directions do not fit the layout.
    """
    balls, lights = at_px.shape[:2]
    every = np.arange(lights)

    def rays(centres: Floats) -> tuple[Floats, Floats]:
        points, directions = np.empty((balls, lights, 3)), np.empty((balls, lights, 3))
        for m in range(balls):
            ray = light_rays(at_px[m], centres[m], ball_radius_mm, camera.K, distortion=camera.distortion)
            points[m], directions[m] = to_world(*ray, camera.R, camera.t_mm)
        return points, directions

    points, directions = rays(ball_mm)
    shown = np.isfinite(directions[..., 0])
    seen: NDArray[np.bool_] = np.any(shown, axis=0)
    if seen.sum() < 4:
        raise KernelError(f"{seen.sum()} lights were seen on the ball; the layout needs four or more")
    first = shown.argmax(0)
    start = on_stage(points[first, every], directions[first, every], radius_mm)
    unit = start / np.linalg.norm(start, axis=1, keepdims=True)
    gate = 0.5 * float(np.arccos(_spacing(layout)))
    turn = _kabsch_robust(unit[seen], layout[seen], gate)
    sigma_rad = np.stack([
        ray_sigma(at_px[m], sigma_px[m], ball_mm[m], ball_radius_mm, camera.K, distortion=camera.distortion)
        for m in range(balls)
    ])  # fmt: skip
    place, findings = _wiring(unit, layout @ turn.T, sigma_rad[first, every], seen, gate)
    used = np.flatnonzero(seen & (place >= 0))
    if used.size < max(4, seen.sum() / 2):
        raise KernelError("the directions do not fit the layout; check the camera's pose and the layout's order")
    sigma_ray = sigma_rad * np.linalg.norm(start - points, axis=2)
    across = np.hypot(placement_sigma_mm, sigma_ray)

    def places(x: Floats) -> Floats:
        return np.asarray((radius_mm + x[6]) * layout @ (Rotation.from_rotvec(x[:3]).as_matrix() @ turn).T + x[3:6])

    def gaps(x: Floats) -> Floats:
        points, directions = rays(ball_mm + x[7:].reshape(balls, 3))
        gap = places(x)[place[used]] - points[:, used]
        return np.asarray(gap - (gap * directions[:, used]).sum(-1, keepdims=True) * directions[:, used])

    side, depth = ball_sigma_mm
    prior = np.array([np.inf] * 3 + [centre_sigma_mm] * 3 + [radius_sigma_mm] + [side, side, depth] * balls)

    def cost(x: Floats) -> Floats:
        flat = (gaps(x) / across[:, used, None])[shown[:, used]]
        # soft from 2.5 sigma on: a light that was mounted elsewhere must not turn the stage
        size = np.linalg.norm(flat, axis=1)
        soft = np.where(size > 2.5, np.sqrt(2 * 2.5 * np.maximum(size, 2.5) - 2.5**2) / np.maximum(size, 1e-9), 1.0)
        return np.concatenate([(flat * soft[:, None]).ravel(), x / prior])

    x = least_squares(cost, np.zeros(7 + 3 * balls), x_scale=np.where(np.isfinite(prior), prior, 0.003)).x
    ideal, residual = places(x), np.full(lights, np.nan)
    off = np.where(shown[:, used], np.linalg.norm(gaps(x), axis=2), 0)
    residual[used] = off.max(0)
    points, directions = rays(ball_mm + x[7:].reshape(balls, 3))
    position, sigma = np.full((lights, 3), np.nan), np.full(lights, np.nan)
    for k in every:
        if not seen[k] and place[k] >= 0:
            position[k], sigma[k] = ideal[place[k]], placement_sigma_mm
        elif seen[k]:
            tau, ray = placement_sigma_mm, shown[:, k]
            middle = ideal[place[k]] if place[k] >= 0 else start[k]
            if place[k] < 0:
                tau = radius_sigma_mm
            elif residual[k] > 4 * float(across[ray, k].max()):
                off_by = f"{residual[k]:.0f} mm off its place, more than four times what is allowed for"
                findings.append(Finding("off its place", (int(k),), f"{light_name(int(k))} is {off_by}"))
                # then the place says little about it
                tau = float(residual[k])
            matrix, vector = across_rays(points[ray, k], directions[ray, k], sigma_ray[ray, k])
            matrix, vector = matrix + np.eye(3) / tau**2, vector + middle / tau**2
            position[k], sigma[k] = np.linalg.solve(matrix, vector), 1 / np.sqrt(np.linalg.eigvalsh(matrix)[0])
    whole = Rotation.from_rotvec(x[:3]).as_matrix() @ turn
    ball = ball_mm + x[7:].reshape(balls, 3)
    shows = predicted_px(position @ camera.R.T + camera.t_mm, ball[0], ball_radius_mm, camera.K)
    hull = cv2.convexHull(at_px[0][shown[0]].astype(np.float32)[:, None]) if shown[0].sum() > 2 else None
    for k in np.flatnonzero(~seen & (place >= 0)):
        # the stand hides lights at the edge of what is seen; one in the midst of it is no stand's work
        if hull is not None and cv2.pointPolygonTest(hull, (float(shows[k, 0]), float(shows[k, 1])), True) > 3:
            lacks = "has no highlight of its own, though the lights around it have: dead, or not connected"
            findings.append(Finding("dead", (int(k),), f"{light_name(int(k))} {lacks}"))
    return Refined(position, sigma, place, seen, residual, whole, x[3:6], radius_mm + x[6], ball, tuple(findings))


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
    told = {finding.lights[0] for finding in findings}
    for k in lights.tolist():
        j = int(place[k])
        if j >= 0 and j < len(seen) and place[j] == k and k < j:
            what = f"{light_name(k)} and {light_name(j)} are swapped: each shows at the other's place"
            findings.append(Finding("swapped", (k, j), what))
        elif j >= 0 and j != k and not (j < len(seen) and place[j] == k) and k not in told:
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


def _kabsch_robust(unit: Floats, layout: Floats, gate: float) -> Floats:
    """Rotation with unit = Q layout for most of them."""
    random = np.random.default_rng(0)
    best, most = np.eye(3), -1.0
    for _ in range(200):
        some = random.choice(len(unit), min(3, len(unit)), replace=False)
        turn = _kabsch(unit[some], layout[some])
        fit = float(np.clip(1 - angle(unit, layout @ turn.T) / gate, 0, None).sum())
        if fit > most:
            best, most = turn, fit
    near = angle(unit, layout @ best.T) < 0.5 * gate
    return _kabsch(unit[near], layout[near]) if near.sum() >= 3 else best


def _kabsch(unit: Floats, layout: Floats) -> Floats:
    u, _, v = np.linalg.svd(unit.T @ layout)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v)


def _spacing(layout: Floats) -> float:
    """Cosine between the nearest two places."""
    return float((layout @ layout.T - 3 * np.eye(len(layout))).max())
