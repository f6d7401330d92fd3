"""Melanin and haemoglobin of a session, and the spectra of picked points.

The spectra are medians over a small square around each point, with the fit of the pigments and the standard error;
`average` is the median over the subject.

A spectrum's angle is that to the nearest spectrum which living skin can have by the layered model
(`kernels/appearance/skin_layers.py`), as vectors over the bands, so brightness does not count. Measured skins are
within 7 degrees.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.formats.tables import csv_of_rows
from lightstage.kernels.appearance.absorption import PassBand, pass_bands
from lightstage.kernels.appearance.skin_layers import likeness
from lightstage.products.errors import ProductError
from lightstage.products.tracking import check_frame

Array = NDArray[np.float64]
Image = NDArray[np.float32]
_HALF_PX = 2
"""A point is the median of a square of 2 x 2 + 1 pixels a side."""
PIGMENTS = ("melanin", "haemoglobin", "baseline", "residual")
_SHARES = {"little melanin": ("melanin", 10), "much melanin": ("melanin", 98), "much blood": ("haemoglobin", 98)}
"""What is picked where no point is given: the percentile of a map."""
_SIDES = 40
"""A map is smoothed over this part of its width before a point is picked."""
_DARKEST = 1e-4
"""Reflectance that counts as black."""


class Pigments(Protocol):
    """The fit that made the maps, with its parameters: what `chromophores` computed by."""

    @property
    def model(self) -> str:
        """Its name."""

    @property
    def saturation(self) -> float:
        """Of the blood."""

    @property
    def vessel_radius_um(self) -> float:
        """Of the blood's vessels."""

    @property
    def pass_band(self) -> PassBand:
        """The form of filters without a curve."""

    def fit(self, reflectance: NDArray[Any], standard_error: NDArray[Any], passing: Array) -> Mapping[str, Any]:
        """PIGMENTS (y, x) of reflectance (band, y, x)."""

    def predicted(self, melanin: Array, haemoglobin: Array, baseline: Array, passing: Array) -> Array:
        """Reflectance (point, band) of pigments (point,)."""


@dataclass(frozen=True)
class Skin:
    """One tracking frame. Pictures are (band, y, x) or (y, x), NaN where not known."""

    session: str
    tracking: int
    bands_nm: tuple[float, ...]
    widths_nm: tuple[float | None, ...]
    reflectance: Image
    standard_error: Image
    maps: Mapping[str, Image]
    passing: Array
    model: Pigments
    attrs: Mapping[str, Any]

    @property
    def known(self) -> NDArray[np.bool_]:
        """(y, x): where there is reflectance in every band, and a fit."""
        return np.asarray(np.isfinite(self.reflectance).all(axis=0) & np.isfinite(self.maps["residual"]))


@dataclass(frozen=True)
class Point:
    """A spectrum and what the model says of it; spectra are (band,)."""

    name: str
    at: tuple[int, int] | None
    """(x, y); None for the average."""
    reflectance: Array
    standard_error: Array
    """Of one pixel."""
    fit: Array
    pigments: Mapping[str, float]
    angle_deg: float


def read_skin(
    reflectance: Any,
    pigments: Any,
    bands: Sequence[Mapping[str, Any]],
    model: Pigments,
    *,
    session: str,
    tracking: int | None,
) -> Skin:
    """What is known of a tracking frame.

    Args:
        reflectance, pigments: the results of `reflectance` and `chromophores`, opened.
        bands: entries of the bands item.
        model: that made `pigments`.
        session: its name.
        tracking: the frame; None for the first.

    Raises:
        ProductError: there is no such tracking frame, or nothing is known of it.
    """
    have = [int(frame) for frame in pigments["tracking"].values]
    frame = have[0] if tracking is None and have else tracking
    check_frame(frame, have, "chromophores", session)
    assert frame is not None
    albedo, maps = (part.isel(tracking=have.index(frame)) for part in (reflectance, pigments))
    entries = {entry["centre_nm"]: entry for entry in bands}
    passed = [entries[float(nm)] for nm in albedo["band"].values]
    skin = Skin(
        session,
        frame,
        tuple(float(nm) for nm in albedo["band"].values),
        tuple(entry["width_nm"] for entry in passed),
        np.asarray(albedo["reflectance"].values, np.float32),
        np.asarray(albedo["standard_error"].values, np.float32),
        {name: np.asarray(maps[name].values, np.float32) for name in PIGMENTS},
        pass_bands(passed, model.pass_band),
        model,
        pigments.attrs,
    )
    if not skin.known.any():
        raise ProductError(f"session '{session}' has no point whose reflectance is known in every band")
    return skin


def spectra(skin: Skin, points: Sequence[tuple[int, int]]) -> list[Point]:
    """The average and each point, or what is picked where none is given.

    Raises:
        ProductError: a point is outside the picture, or nothing is known there.
    """
    height, width = skin.reflectance.shape[1:]
    known = skin.known
    named = {f"point {i + 1}": point for i, point in enumerate(points)} or _picked(skin, known)
    picked = [_spectrum(skin, "average", None, known)]
    for name, (x, y) in named.items():
        if not (0 <= x < width and 0 <= y < height):
            raise ProductError(f"{x},{y} is outside the picture; X is 0 to {width - 1} and Y is 0 to {height - 1}")
        around = np.zeros_like(known)
        around[max(0, y - _HALF_PX) : y + _HALF_PX + 1, max(0, x - _HALF_PX) : x + _HALF_PX + 1] = True
        if not (around & known).any():
            raise ProductError(f"{x},{y}: nothing is known of the reflectance there; choose a point on the subject")
        picked.append(_spectrum(skin, name, (x, y), around & known))
    return picked


def _picked(skin: Skin, known: NDArray[np.bool_]) -> dict[str, tuple[int, int]]:
    """(x, y) where a smoothed map is nearest to a percentile of it, well inside of what is known."""
    side = max(3, skin.reflectance.shape[2] // _SIDES) | 1
    inner = cv2.erode(known.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=0) > 0
    if not inner.any():
        inner = known
    places = {}
    for name, (pigment, percent) in _SHARES.items():
        smooth = cv2.blur(np.where(known, skin.maps[pigment], 0).astype(np.float32), (side, side))
        wanted = np.percentile(smooth[inner], percent)
        y, x = np.unravel_index(int(np.where(inner, np.abs(smooth - wanted), np.inf).argmin()), inner.shape)
        places[name] = (int(x), int(y))
    return places


def _spectrum(skin: Skin, name: str, at: tuple[int, int] | None, where: NDArray[np.bool_]) -> Point:
    rho, error = (
        np.median(picture[:, where], axis=1, keepdims=True)[..., None]
        for picture in (skin.reflectance, skin.standard_error)
    )
    maps = skin.model.fit(rho, error, skin.passing)
    pigments = {pigment: float(maps[pigment][0, 0]) for pigment in PIGMENTS}
    melanin, haemoglobin, baseline = (np.array([pigments[pigment]]) for pigment in PIGMENTS[:3])
    fit = skin.model.predicted(melanin, haemoglobin, baseline, skin.passing)[0]
    spectrum, noise = (values[:, 0, 0].astype(np.float64) for values in (rho, error))
    nearest = likeness(
        np.maximum(spectrum, _DARKEST),
        skin.passing,
        saturation=skin.model.saturation,
        vessel_radius_um=skin.model.vessel_radius_um,
    )
    return Point(name, at, spectrum, noise, fit, pigments, nearest.angle_deg)


def table(skin: Skin, points: Sequence[Point]) -> bytes:
    """CSV: a row a point and band."""
    head = ["point", "x", "y", "band_nm", "reflectance", "standard_error", "fit", *PIGMENTS, "angle_to_skin_deg"]
    return csv_of_rows(
        head,
        (
            [point.name, *(("", "") if point.at is None else point.at), f"{nm:g}"]
            + [f"{v[i]:.5f}" for v in (point.reflectance, point.standard_error, point.fit)]
            + [f"{point.pigments[name]:.5f}" for name in PIGMENTS]
            + [f"{point.angle_deg:.2f}"]
            for point in points
            for i, nm in enumerate(skin.bands_nm)
        ),
    )
