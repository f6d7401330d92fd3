"""The bands of a multispectral capture, brought to one of them.

Filters are changed between bands, and the subject moves meanwhile. Albedo differs between bands in contrast and in
sign, so their pictures do not match. Three things do:

    specular   I_S, the specular component under constant light: that of the surface and of the lights, the same in
               every band but for their power;
    relief     r_a / (r_a + r_a') of the diffuse component, where the set has a gradient and its complement: albedo
               divides out, what is left is the surface's direction;
    gradient   |grad I_D| / I_D, the strength of edges of the diffuse component: what an albedo edge keeps when it
               changes its sign.

Each gives features: its texture relative to the local mean, at two scales. One flow per band, smooth between the
nodes of a block grid, makes them match those of the reference band (`joint_flow.match`). A feature counts by its
noise, which is measured in the capture. With s^2 the variance of the noise in a feature at a place, e^2 the local
power that the feature has beyond it (beyond 1.5 s^2, which chance may give), and m a misfit that is there without
noise, the weight is

    w^2 = e^2 / ((e^2 + s^2) (s^2 + m^2)) ,

the share of signal in it over the variance of its difference. So where there is little specular light the others
decide.

Limits: highlights stay with the lights while skin turns beneath them, so the specular component follows a shift
better than a turn; relief does better there. Edges of the diffuse component match roughly where bands differ much.
What has no texture at all has its flow extended from around it.

Sources: Dutta (2010), future work, for alignment on the specular component; Wilson et al. (2010), ACM TOG 29(2),
for r_a + r_a' = r_c; Brox et al. (2004), doi:10.1007/978-3-540-24673-2_3, for gradients against change of
brightness; Immerkaer (1996), doi:10.1006/cviu.1996.0060, for noise without complements. Relief and the weights are
ours.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.hw.illuminations import CONSTANT, pairs
from lightstage.kernels.motion.joint_flow import Features, depth_of, fine_texture, halved, match, subject_of
from lightstage.kernels.pictures import blurs
from lightstage.kernels.pictures.masked_mean import MaskedMean
from lightstage.kernels.pictures.noise import finest_detail

Image = NDArray[np.float32]
Kind = Literal["specular", "relief", "gradient"]
KINDS: tuple[Kind, ...] = ("specular", "relief", "gradient")
ALIKE = 0.3
"""Correlation of the features of two bands, once aligned, below which nothing was found."""
_SCALES_PX = (2.0, 5.0)
_PREFILTER_PX = 1.2
"""Noise pulls flows away from whole pixels, because interpolation smoothes it everywhere else."""
_WINDOW_PX = 8.0
"""Of local powers."""
_LEAST_SHARE = 1e-3
"""Of a window that is known: where less is, a mean is over nearly nothing."""
_CHANCE = np.float32(1.5)
"""What power noise alone may have in a window by chance, of its mean: only what is beyond counts as signal."""
_FACTOR: Mapping[Kind, float] = {"specular": 1.0, "relief": 1.0, "gradient": 0.1}
"""k: edges of the diffuse component misfit by a pattern, not by noise, and a pattern does not average out."""
_MISFIT: Mapping[Kind, float] = {"specular": 0.03, "relief": 0.005, "gradient": 0.3}
"""m, in units of the feature."""
_DARK = np.float32(0.02)
"""Of the bright end: the least that anything is divided by."""
_BENDING = 200.0
_BOUNDS = (60.0, 2500.0)
_WARPS = (8, 6, 4)


class Light(NamedTuple):
    """What one band shows of a set, and the variance of its noise, both (y, x); None where a set has no such thing.

    NaN where not valid. Each in a unit of its own.
    """

    diffuse: Image
    diffuse_noise: Image
    specular: Image | None = None
    specular_noise: Image | None = None
    shares: tuple[Image, ...] = ()
    """1 + (r_a - r_a') / (r_a + r_a') of each pair."""
    share_noise: Image | None = None


class BandFlow(NamedTuple):
    """The flow of one band; 0 everywhere when none was found."""

    flow: Image
    """(xy, y, x), pixels on the reference band's grid: aligned(x) = band(x + flow(x))."""
    doubt_px: Image
    """(y, x): predicted error of the flow, pixels."""
    parts: Mapping[Kind, float]
    """What the flow was found from: the share of each kind of feature, 1 in sum; empty when none was found."""
    alike: float
    """Correlation of the features along the flow, weighted as in the solution."""


def gathered(pictures: Mapping[str, Image], components: Sequence[str], *, still: bool) -> Light:
    """What one band shows of a set.

    Args:
        pictures: (component, y, x) by illumination; NaN where not valid.
        components: what lies along the first axis; the diffuse component, or the total, is first.
        still: whether the subject held still within the set. Then all its pictures count, in sum: every band has
            the same ones. If not, constant light C alone does, and there is no relief.
    """
    if not still and CONSTANT in pictures:
        pictures = {CONSTANT: pictures[CONSTANT]}
    diffuse = {name: picture[0] for name, picture in pictures.items()}
    total, variance = _summed(diffuse)
    light = Light(total, _spread(variance * np.float32(len(pictures))))
    if "specular" in components:
        place = list(components).index("specular")
        total, noise = _summed({name: picture[place] for name, picture in pictures.items()})
        light = light._replace(specular=total, specular_noise=_spread(noise * np.float32(len(pictures))))
    couples = [(diffuse[gradient], diffuse[opposite]) for gradient, opposite in pairs(diffuse)]
    if couples:
        constant = np.asarray(sum(a + b for a, b in couples) / np.float32(len(couples)), np.float32)
        floor = _DARK * np.float32(_bright(constant))
        light = light._replace(
            shares=tuple(1 + (a - b) / np.maximum(a + b, floor) for a, b in couples),
            # of equal noise in both, and as many in the darker half as in the brighter
            share_noise=_spread(2 * variance / np.maximum(constant, floor) ** 2),
        )
    return light


def _summed(pictures: Mapping[str, Image]) -> tuple[Image, Image]:
    """The sum of pictures (y, x), and the square of one picture's noise, pixel by pixel."""
    total = np.asarray(sum(pictures.values()), np.float32)
    if CONSTANT in pictures and pairs(pictures):
        # r_a + r_a' - r_c is the noise of three pictures
        gaps = [pictures[a] + pictures[b] - pictures[CONSTANT] for a, b in pairs(pictures)]
        return total, np.asarray(sum(gap**2 for gap in gaps) / np.float32(3 * len(gaps)), np.float32)
    return total, np.asarray(finest_detail(total) ** 2 / np.float32(len(pictures)), np.float32)


def band_flow(fixed: Light, moving: Light, *, kinds: Sequence[Kind] = KINDS) -> BandFlow:
    """The flow from the reference band to another band.

    Args:
        fixed: the reference band.
        moving: the other band.
        kinds: the features to use; those that either band lacks are left out.

    Returns:
        The flow, its doubt, and what it was found from.
    """
    used = [kind for kind in kinds if _has(fixed, kind) and _has(moving, kind)]
    subject = subject_of(fixed.diffuse)
    if not used or not subject.any() or not subject_of(moving.diffuse).any():
        return _none(subject.shape, 0.0)
    fixed_side, moving_side = _side(fixed, used), _side(moving, used)
    finest, owner = _features(fixed_side, moving_side, 0)
    levels = [finest]
    for level in range(1, depth_of(subject.shape)):
        fixed_side, moving_side = fixed_side.smaller(), moving_side.smaller()
        levels.append(_features(fixed_side, moving_side, level)[0])
    factors = [_FACTOR[kind] for kind in owner]
    flows = match(levels, factors=factors, bending=_BENDING, warps=_WARPS, bounds=_BOUNDS)
    alike = _alike(finest, flows.flow[0])
    if alike < ALIKE:
        return _none(subject.shape, alike)
    return BandFlow(flows.flow[0], flows.doubt_px[0], _parts(finest, owner), alike)


def _none(shape: tuple[int, ...], alike: float) -> BandFlow:
    return BandFlow(np.zeros((2, *shape), np.float32), np.zeros(shape, np.float32), {}, alike)


class _Side(NamedTuple):
    """One level of one band's pyramid."""

    images: tuple[tuple[Kind, Image, Image], ...]
    """Kind, picture without NaN, and the noise of its pixels at full size."""
    known: NDArray[np.bool_]
    subject: NDArray[np.bool_]

    def smaller(self) -> "_Side":
        """The next level."""
        images = tuple((kind, blurs.half_size(image), blurs.half_size(noise)) for kind, image, noise in self.images)
        return _Side(images, halved(self.known), halved(self.subject))


def _has(light: Light, kind: Kind) -> bool:
    if kind == "specular":
        return light.specular is not None and bool(np.isfinite(light.specular).any())
    return kind == "gradient" or bool(light.shares)


def _side(light: Light, kinds: Sequence[Kind]) -> _Side:
    images: list[tuple[Kind, Image, Image]] = []
    for kind in kinds:
        if kind == "relief" and light.share_noise is not None:
            images += [(kind, blurs.filled(share), light.share_noise) for share in light.shares]
            continue
        picture, noise = light.diffuse, light.diffuse_noise
        if kind == "specular" and light.specular is not None and light.specular_noise is not None:
            picture, noise = light.specular, light.specular_noise
        # each band by its own level: lights differ in power from band to band
        level = np.float32(_bright(picture))
        images.append((kind, blurs.filled(picture) / level, noise / level**2))
    known = np.isfinite(light.diffuse)
    if light.specular is not None:
        known &= np.isfinite(light.specular)
    return _Side(tuple(images), known, subject_of(light.diffuse))


def _features(fixed: _Side, moving: _Side, level: int) -> tuple[Features, list[Kind]]:
    """The features of one level, and the kind of each."""
    ours, theirs, weights = [], [], []
    owner: list[Kind] = []
    inside = np.maximum(_spread(fixed.subject.astype(np.float32)), np.float32(1e-3))
    for (kind, *fixed_image), (_, *moving_image) in zip(fixed.images, moving.images, strict=True):
        for sigma in _SCALES_PX:
            a, noise_a = _texture(kind, fixed_image[0], fixed_image[1], fixed.subject, sigma, level)
            b, noise_b = _texture(kind, moving_image[0], moving_image[1], moving.subject, sigma, level)
            noise = noise_a + noise_b
            power = _spread(np.where(fixed.subject, a * a + b * b, np.float32(0))) / inside
            signal = np.maximum(power - _CHANCE * noise, 0)
            square = signal / ((power + np.float32(1e-12)) * (noise + _MISFIT[kind] ** 2))
            ours.append(a)
            theirs.append(b)
            weights.append(np.where(fixed.subject, np.sqrt(square), 0).astype(np.float32))
            owner.append(kind)
    return Features(np.stack(ours), np.stack(theirs), np.stack(weights), moving.known, fixed.subject), owner


def _texture(
    kind: Kind, image: Image, noise: Image, subject: NDArray[np.bool_], sigma: float, level: int
) -> tuple[Image, Image]:
    """A feature and the variance of its noise, both (y, x)."""
    image = blurs.gaussian(image, _PREFILTER_PX)
    mean = np.maximum(blurs.gaussian(image, sigma), _DARK)
    if kind != "gradient":
        return fine_texture(image, subject, sigma), _gain(sigma, level) * noise / mean**2
    slopes = (cv2.Sobel(image, cv2.CV_32F, *way, ksize=3, scale=1 / 8) for way in ((1, 0), (0, 1)))
    noise = _gain(0.0, level) * noise / mean**2
    # with the noise's own power in it, noise alone is no edge anywhere
    strength = np.sqrt(sum(slope**2 for slope in slopes) / mean**2 + 2 * noise)
    strength /= np.float32(_bright(np.where(subject, strength, np.float32(np.nan))))
    return fine_texture(strength, subject, sigma), noise / np.maximum(blurs.gaussian(strength, sigma), _DARK) ** 2


@cache
def _gain(sigma: float, level: int) -> np.float32:
    """Variance that a feature (sigma 0: a slope) has of white noise of variance 1 in the full-size picture."""
    image = np.random.default_rng(0).standard_normal((64 * 2**level,) * 2).astype(np.float32)
    for _ in range(level):
        image = blurs.half_size(image)
    image = blurs.gaussian(image, _PREFILTER_PX)
    if sigma == 0:
        return np.float32(cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8).var())
    for _ in range(2):
        image = image - blurs.gaussian(image, sigma)
    return np.float32(image.var())


def _parts(at: Features, owner: Sequence[Kind]) -> dict[Kind, float]:
    """How much of what fixes the flow each kind has: its weighted slopes."""
    sums = dict.fromkeys(owner, 0.0)
    for feature, weight, kind in zip(at.moving, at.weight, owner, strict=True):
        down, across = np.gradient(feature)
        sums[kind] += _FACTOR[kind] * float(np.sum((weight**2 * (down**2 + across**2))[at.subject], dtype=float))
    whole = sum(sums.values())
    return {kind: part / whole if whole else 0.0 for kind, part in sums.items()}


def _alike(at: Features, flow: Image) -> float:
    """Correlation of two bands' features, once the flow has brought them together."""
    y, x = np.indices(flow.shape[1:], np.float32)
    used = at.weight * at.subject
    moved = np.stack([cv2.remap(f, x + flow[0], y + flow[1], cv2.INTER_LINEAR) for f in at.moving])
    size = float(np.sqrt(np.sum((used * at.fixed) ** 2, dtype=float) * np.sum((used * moved) ** 2, dtype=float)))
    return float(np.sum(used**2 * at.fixed * moved, dtype=float)) / size if size > 0 else 0.0


def _bright(picture: Image) -> float:
    lit = picture[np.isfinite(picture)]
    bright = float(np.percentile(lit, 99)) if lit.size else 0.0
    return bright if bright > 0 else 1.0


def _spread(image: Image) -> Image:
    """The mean over a window, of what is known."""
    mean = MaskedMean(np.isfinite(image), _WINDOW_PX, least=_LEAST_SHARE, blur=blurs.gaussian, dtype=np.float32)
    return mean(image)
