"""How each light's polariser is turned: the kernel of `stages/calibration/polarisers.py`.

Highlights are summed by `photometry.py`, and fitted by `polariser_fit.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.targets.ball_conic import Floats
from lightstage.kernels.targets.item_pictures import counts_of
from lightstage.kernels.targets.outline import ring_radius_px
from lightstage.kernels.targets.photometry import Aperture, highlight_sums, variance
from lightstage.kernels.targets.polariser_fit import GRAZING_DEG, fit_polarisers
from lightstage.kernels.targets.verdicts import Verdict

PictureName = tuple[int, float]
"""A picture of the ball: number of the light, angle of its polariser in degrees."""
_VAGUE_DEG = 0.5
"""An angle that is known less well is told."""


class Sensor(NamedTuple):
    """What a picture's counts are worth."""

    white_level: int
    """The count at which it saturates."""
    dark_picture: NDArray[np.float64] | None
    """(y, x), counts; None: the dark is taken from around each highlight."""


def polarisers(
    raw: Mapping[PictureName, NDArray[np.uint16]],
    at_px: Mapping[PictureName, Floats],
    peak: Mapping[PictureName, Floats],
    ring: Mapping[int, Floats],
    *,
    exposure: Sequence[float],
    material: Literal["metal", "dielectric"],
    sensor: Sensor,
    aperture: Aperture,
) -> Mapping[str, Any]:
    """Fit every light.

    Args:
        raw: (y, x) counts by light and polariser angle.
        at_px, peak: of `highlights`, of the same pictures.
        ring: (point, xy): the ball's outline, one.
        exposure: relative, in the order of the pictures: sums are divided by it.
        material: of the ball.
        sensor: of the camera.
        aperture: around a highlight.

    Returns:
        by light; see the declaration.
    """
    angles = sorted({angle for _, angle in raw})
    positions = _positions(at_px, peak)
    sums, full = _sums(raw, positions, exposure, sensor, aperture)
    (outline,) = ring.values()
    away = np.linalg.norm(positions[:, ::-1] - outline.mean(axis=0), axis=1) / ring_radius_px(outline)
    incidence = np.degrees(np.arcsin(np.clip(away, 0, 1)))
    fit = fit_polarisers(
        sums,
        np.asarray(angles, float),
        saturated=full,
        incidence_deg=incidence,
        ball=material,
        electrons_per_count=aperture.electrons_per_count,
        floor_counts2=float(variance(np.zeros(1), **aperture._asdict())[0]),
    )
    return {
        "theta0_deg": fit.theta0_deg,
        "least_deg": fit.least_deg,
        "residual": fit.residual,
        "theta0_se_deg": fit.theta0_se_deg,
        "residual_se": fit.residual_se,
        "grazing": fit.grazing,
        "intensity": np.where(full, np.nan, sums),
        "incidence_deg": incidence,
    }


def _positions(at_px: Mapping[PictureName, Floats], peak: Mapping[PictureName, Floats]) -> Floats:
    """(light, yx), pixels: where each light shows at its brightest angle, which places it best."""

    def brightness(name: PictureName) -> float:
        first = peak[name][0]
        return -1.0 if np.isnan(first) else float(first)

    numbers = sorted({number for number, _ in at_px})
    best = [max((name for name in at_px if name[0] == number), key=brightness) for number in numbers]
    return np.stack([np.asarray(at_px[name])[0, ::-1] for name in best])


def _sums(
    raw: Mapping[PictureName, NDArray[np.uint16]],
    positions: Floats,
    exposure: Sequence[float],
    sensor: Sensor,
    aperture: Aperture,
) -> tuple[Floats, NDArray[np.bool_]]:
    """(light, angle): sums of the highlights at (light, yx) in counts, and whether a pixel was saturated."""
    numbers, angles = sorted({number for number, _ in raw}), sorted({angle for _, angle in raw})
    # relative to the light's own mean, so that counts stay counts and their noise is known
    times = np.asarray(exposure, float)
    lights = np.array([number for number, _ in raw])
    usual = [times[lights == number].mean() for number in numbers]
    sums = np.full((len(numbers), len(angles)), np.nan)
    full = np.zeros(sums.shape, np.bool_)
    for name, time in zip(raw, times, strict=True):
        k, column = numbers.index(name[0]), angles.index(name[1])
        if np.isnan(positions[k]).any():
            continue
        picture = np.asarray(raw[name])
        value, saturated = highlight_sums(
            picture[None],
            positions[k : k + 1],
            dark=np.zeros(picture.shape) if sensor.dark_picture is None else sensor.dark_picture,
            white=sensor.white_level,
            radius_px=aperture.radius_px,
        )
        sums[k, column] = value[0, 0] * usual[k] / time
        full[k, column] = saturated[0, 0]
    return sums, full


def prepare(
    *,
    exposure: Sequence[float],
    white_level: int,
    material: str,
    dark: Mapping[str, Any] | None,
    aperture_px: float,
    electrons_per_count: float,
    read_noise_counts: float,
) -> Mapping[str, Any]:
    """The context in numbers, and the parameters as one."""
    return {
        "exposure": exposure,
        "material": material,
        "sensor": Sensor(white_level, counts_of(dark)),
        "aperture": Aperture(aperture_px, electrons_per_count, read_noise_counts),
    }


def item(*, arrays: Mapping[str, Any], labels: Mapping[str, Any]) -> Mapping[str, Any]:
    """The polarisers item: lights with a fit."""
    rows = [
        {"id": name, "angle_deg": round(float(least) % 180, 3), "residual": round(max(float(rest), 0.0), 5)}
        for name, least, rest in zip(labels["light"], arrays["least_deg"], arrays["residual"], strict=True)
        if np.isfinite(least)
    ]
    return {"item": "polarisers", "lights": rows}


def verdict(*, arrays: Mapping[str, Any], labels: Mapping[str, Any]) -> Verdict:
    """What cross polarisation leaves of the highlights, and which angles are in doubt."""
    names = list(labels["light"])
    residual, error = arrays["residual"], arrays["theta0_se_deg"]
    seen = np.isfinite(residual)
    worst = int(np.nanargmax(residual))
    sentence = (
        f"{int(seen.sum())} of {len(names)} lights: at the right angle {float(np.nanmedian(residual)):.2%} of the "
        f"highlight remains (median; most at {names[worst]}, {float(residual[worst]):.2%}); angles are known to "
        f"{float(np.nanmedian(error)):.2f} degrees (median)"
    )
    findings: Verdict = [("good", sentence)]
    vague = [name for name, e in zip(names, error, strict=True) if e > _VAGUE_DEG]
    if vague:
        sentence = (
            f"{', '.join(vague)}: too weak to place the polariser within {_VAGUE_DEG:g} degrees; expose longer"
        )
        findings.append(("doubtful", sentence))
    grazing = [name for name, g in zip(names, arrays["grazing"], strict=True) if g]
    if grazing:
        sentence = (
            f"{', '.join(grazing)} strike the metal ball at more than {GRAZING_DEG:g} degrees: their residual is "
            "partly the metal's and their angle not that of skin; use a plastic ball"
        )
        findings.append(("doubtful", sentence))
    return findings
