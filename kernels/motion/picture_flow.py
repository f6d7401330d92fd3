"""Optical flow between pictures under different light, as others do it: the references for our own alignment.

Joint Photometric Alignment (`alternating`): a gradient r and its complement r' add up to constant light c, once
flows u and v have brought them to it,

    r(x + u(x)) + r'(x + v(x)) = c(x)

so that c - r' looks like r. From v = 0 and in turns,

    u <- flow from c - r'(v) to r,    v <- flow from c - r(u) to r'

each by an ordinary optical flow that assumes equal brightness. The thesis takes Brox et al. (2004); OpenCV's CPU
build has none, so there are TV-L1 (Zach et al. 2007, the same robust norms, no gradient constancy), DIS (Kroeger
et al. 2016, with the variational refinement that is Brox's functional at one scale) and Farneback (2003).

Local normalisation (`direct`): c and r divided by their own local means look alike wherever albedo, not relief,
makes the texture; one flow between them needs no complement.

Limits: `alternating` has nothing that keeps light and motion apart: where r' is misaligned, c - r' is wrong by a
moving pattern, and flows that fit this pattern lower the residual as well as the right ones do. `direct` follows
shading where there is more of it than of texture.

Source: Wilson et al. (2010), Temporal upsampling of performance geometry using photometric alignment; Dutta
(2010), "Registration of Spherical Illumination Images".
"""

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any, Literal, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.pictures.masked_mean import MaskedMean
from lightstage.kernels.pictures.nearest_fill import nearest_fill

Image = NDArray[np.float32]
"""(y, x)."""
Flow = NDArray[np.float32]
"""(xy, y, x), pixels: aligned(x) = picture(x + flow(x))."""
Method = Literal["dis", "tvl1", "farneback"]
Preset = Literal["ultrafast", "fast", "medium"]

# chosen by `python -m benchmarks.alignment --tune`
_TVL1: dict[str, Any] = {
    "Lambda": 0.3,
    "OuterIterations": 1,
    "InnerIterations": 10,
    "ScalesNumber": 4,
    "WarpingsNumber": 2,
    "MedianFiltering": 5,
}
_DIS: dict[str, Any] = {
    "FinestScale": 0,
    "UseMeanNormalization": True,
    "VariationalRefinementIterations": 5,
    "VariationalRefinementAlpha": 20.0,
}
_FARNEBACK: dict[str, Any] = {
    "pyr_scale": 0.5,
    "levels": 4,
    "winsize": 31,
    "iterations": 3,
    "poly_n": 5,
    "poly_sigma": 0.5,
}
_DIRECT: dict[str, Any] = {
    "FinestScale": 0,
    "PatchSize": 12,
    "VariationalRefinementIterations": 10,
    "VariationalRefinementAlpha": 40.0,
}
_FLOOR = 0.02
"""Of the picture's bright level. Darker than this is background: noise, which a division would blow up."""
_SPREAD = 4.0
"""Standard deviations of the normalised texture that the 8 bits hold to either side."""


class Round(NamedTuple):
    """Where `alternating` stands."""

    u: Flow
    v: Flow
    residual: float
    """Mean |c - r(u) - r'(v)| over the pixels that all three pictures know, in the pictures' units."""


class Alternating(NamedTuple):
    """The result of `alternating`."""

    u: Flow
    v: Flow
    residuals: tuple[float, ...]
    """Before the first iteration and after each; see `Round`."""


def alternating(
    constant: Image, gradient: Image, complement: Image, *, flow: Method, iterations: int
) -> Alternating:
    """Joint Photometric Alignment: flows of a gradient and its complement to constant light, in turns.

    Args:
        constant: c, (y, x) radiance, any scale; may hold NaN.
        gradient: r, as c.
        complement: r', as c.
        flow: the optical flow within: `dis`, `tvl1` or `farneback`.
        iterations: each is one flow for u and one for v.

    Returns:
        u and v (xy, y, x) in pixels, finite everywhere, and the residuals (iterations + 1).

    Raises:
        ValueError: pictures of different shapes, one without a single number, or a negative number of iterations.
    """
    if iterations < 0:
        raise ValueError(f"iterations is {iterations}; it must be 0 or more")
    done = list(islice(rounds(constant, gradient, complement, flow=flow), iterations + 1))
    return Alternating(done[-1].u, done[-1].v, tuple(step.residual for step in done))


def rounds(constant: Image, gradient: Image, complement: Image, *, flow: Method) -> Iterator[Round]:
    """The iterations of `alternating` one by one, without an end; first the start, u = v = 0."""
    pictures = {"constant": constant, "gradient": gradient, "complement": complement}
    c, r, rc = (_filled(picture, name) for name, picture in _alike(pictures).items())
    # one scale for all: equal brightness is what the flow assumes, and a scale for each picture would undo it
    bright = _bright(c)
    estimate = _ESTIMATES[flow]
    u = np.zeros((2, *c.shape), np.float32)
    v = np.zeros_like(u)
    while True:
        gap = constant - warped(gradient, u) - warped(complement, v)
        known = np.isfinite(gap)
        yield Round(u, v, float(np.abs(gap[known]).mean(dtype=float)) if known.any() else float("nan"))
        u = estimate((c - _warp(rc, v)) / bright, r / bright)
        v = estimate((c - _warp(r, u)) / bright, rc / bright)


def plain(constant: Image, picture: Image, *, flow: Method) -> Flow:
    """One ordinary flow from constant light to a picture, as if the light were the same.

    Args and Raises as `alternating`. Returns (xy, y, x), pixels.
    """
    c, r = (_filled(p, name) for name, p in _alike({"constant": constant, "picture": picture}).items())
    bright = _bright(c)
    return _ESTIMATES[flow](c / bright, r / bright)


def direct(constant: Image, picture: Image, *, sigma_px: float = 2.0, preset: Preset = "medium") -> Flow:
    """Flow from constant light to a picture under any light, both divided by their local means.

    Args:
        constant: (y, x) radiance, any scale; may hold NaN.
        picture: as `constant`; its scale may be another.
        sigma_px: of the Gaussian that the local mean is taken with.
        preset: of DIS.

    Returns:
        (xy, y, x), pixels, finite everywhere.

    Raises:
        ValueError: pictures of different shapes, one without a single number, or sigma_px not above 0.
    """
    if not sigma_px > 0:
        raise ValueError(f"sigma_px is {sigma_px}; it must be above 0")
    pictures = _alike({"constant": constant, "picture": picture})
    a, b = (_normalised(p, name, sigma_px) for name, p in pictures.items())
    # the relief makes the texture stronger in one picture than in the other; one scale leaves that as it is
    scale = _SPREAD * float(np.sqrt((a.var() + b.var()) / 2))
    if scale == 0:
        return np.zeros((2, *a.shape), np.float32)
    return _dis_of(_DIRECT, preset, (a / scale + 1) / 2, (b / scale + 1) / 2)


def warped(picture: Image, flow: Flow) -> Image:
    """picture(x + flow(x)) by bicubic interpolation; NaN where that takes a NaN or lies outside the picture."""
    x, y = _positions(flow)
    height, width = picture.shape
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    return np.where(inside, _warp(picture, flow), np.float32(np.nan))


def _warp(picture: Image, flow: Flow) -> Image:
    """As `warped`, with the border's pixels continued outwards."""
    x, y = _positions(flow)
    source = np.ascontiguousarray(picture, np.float32)
    return cast(Image, cv2.remap(source, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))


def _positions(flow: Flow) -> tuple[Image, Image]:
    height, width = flow.shape[1:]
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    return flow[0] + x, flow[1] + y


def _tvl1(a: Image, b: Image) -> Flow:
    engine = cv2.optflow.DualTVL1OpticalFlow.create()
    for name, value in _TVL1.items():
        getattr(engine, f"set{name}")(value)
    # OpenCV takes floats of 0 to 1 here and multiplies them by 255
    return _split(engine.calc(a, b, None))


def _farneback(a: Image, b: Image) -> Flow:
    # floats are taken as they are, and a constant within supposes levels of 0 to 255
    a, b = a * np.float32(255), b * np.float32(255)
    return _split(cv2.calcOpticalFlowFarneback(a, b, None, flags=cv2.OPTFLOW_FARNEBACK_GAUSSIAN, **_FARNEBACK))


def _dis(a: Image, b: Image) -> Flow:
    return _dis_of(_DIS, "medium", a, b)


def _dis_of(settings: dict[str, Any], preset: Preset, a: NDArray[Any], b: NDArray[Any]) -> Flow:
    engine = cv2.DISOpticalFlow.create(_PRESETS[preset])
    for name, value in settings.items():
        getattr(engine, f"set{name}")(value)
    return _split(engine.calc(_bytes(a), _bytes(b), None))


_PRESETS: dict[Preset, int] = {
    "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
    "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
    "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
}
_ESTIMATES: dict[Method, Callable[[Image, Image], Flow]] = {"dis": _dis, "tvl1": _tvl1, "farneback": _farneback}


def _bytes(picture: NDArray[Any]) -> NDArray[np.uint8]:
    """0 to 1 as 8 bits, the only pictures that DIS takes."""
    return np.asarray(np.clip(np.rint(picture * 255), 0, 255), np.uint8)


def _split(flow: Any) -> Flow:
    """OpenCV's (y, x, xy) as (xy, y, x)."""
    return np.ascontiguousarray(np.moveaxis(flow, 2, 0), np.float32)


def _alike(pictures: dict[str, Image]) -> dict[str, Image]:
    (first, shape), *others = ((name, np.shape(p)) for name, p in pictures.items())
    for name, other in [(first, shape), *others]:
        if len(other) != 2 or other != shape:
            raise ValueError(f"{name} is {other}, {first} is {shape}; both must be (y, x) and of one size")
    return pictures


def _filled(picture: Image, name: str) -> Image:
    """A copy with every NaN replaced by the nearest number: an edge at a hole would pull the flow."""
    known = np.isfinite(picture)
    if not known.any():
        raise ValueError(f"{name} has no finite pixel; there is nothing to align")
    return np.array(nearest_fill(picture, known), np.float32)


def _bright(picture: Image) -> np.float32:
    """The level that counts as 1: nearly the brightest pixel; 1 for a picture without light."""
    level = np.float32(np.percentile(picture, 99.9))
    return level if level > 0 else np.float32(1)


def _normalised(picture: Image, name: str, sigma: float) -> Image:
    """picture / local mean - 1; 0 on the background and where it is not known.

    The mean is over known pixels that are not background, so that the outline has no seam.
    """
    filled = _filled(picture, name)
    floor = _FLOOR * _bright(filled)
    lit = np.isfinite(picture) & (filled > floor)
    mean = MaskedMean(lit, sigma, dtype=np.float32)(filled)
    return cast(Image, lit.astype(np.float32) * (filled - mean) / (mean + floor))
