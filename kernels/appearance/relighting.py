"""A found surface under other lights: Lambertian and glossy, with cast shadows and bounced light.

    diffuse  = rho (sum_k E_k v_k max(0, n . l_k) + B)        specular = w sum_k E_k v_k f(l_k)

E_k is the strength of light k where it reaches the point (1: a white surface that faces it shows 1), v_k how much
of it the point sees, f the GGX lobe of `microfacets.py`, B what arrives by way of other points
(`interreflection.py`). The depth map is an estimate, so the place of a shadow's edge is known to some pixels only:
v_k is marched sharply and then averaged over EDGE_PX, which has the smaller squared error where the edge may lie on
either side.

Sources: Lambert (1760); Walter et al. (2007) for the lobe; Debevec (2005), doi:10.1145/1185657.1185688, for the
median cut of an environment.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from lightstage.kernels.appearance.microfacets import at_normal_incidence, shines
from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures.masked_mean import MaskedMean
from lightstage.kernels.surface.interreflection import Tiles
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.visibility import visible

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SLACK_MM = 0.05
"""As little as keeps a surface from shading itself: hollows are found too flat, so shadows are small already."""
EDGE_PX = 1.5
FAR_MM = 1e7
"""Where distant lights are put: over a face their rays are parallel, and as strong, to some hundred thousandths."""
_AT_ONCE = 16


class Lamps(NamedTuple):
    """Lights, near or far."""

    places: Array
    """(light, xyz) world, mm."""
    strength: Array
    """(light, channel): what a white surface shows that faces the light at the distance `reach_mm`."""
    reach_mm: Array
    """(light,)."""

    @classmethod
    def distant(cls, directions: Array, strength: Array) -> "Lamps":
        """Lights without fall-off, from unit vectors (light, xyz) towards them."""
        return cls(FAR_MM * directions, strength, np.full(len(directions), FAR_MM))


class Surface(NamedTuple):
    """What is lit; NaN where there is none."""

    normal: Array
    """(y, x, xyz) unit vectors, world."""
    depth_mm: Array
    """(y, x), camera z."""
    albedo: Array
    """(y, x, channel)."""
    specular: Array | None
    """(y, x): reflectance at normal incidence; None: no gloss."""
    roughness: Array | None
    """(y, x): GGX width."""
    refraction: float
    """Refractive."""


class Relit(NamedTuple):
    """Radiance, (y, x, channel), NaN off the surface."""

    diffuse: Image
    specular: Image


def relight(
    surface: Surface,
    camera: Pinhole,
    lamps: Lamps,
    *,
    bounces: int = 1,
    shadows: bool = True,
    edge_px: float = EDGE_PX,
) -> Relit:
    """The surface under lamps.

    Args:
        surface: see there. A pixel without a specular value has no gloss.
        camera: of the surface's pictures.
        lamps: with as many channels as the albedo.
        bounces: how often light goes on from one point of the surface to another; 0: never.
        shadows: whether the surface casts shadows.
        edge_px: sigma over which shadows are averaged.

    Raises:
        KernelError: there is no surface.
    """
    known = np.isfinite(surface.normal).all(axis=2) & np.isfinite(surface.depth_mm)
    known &= np.isfinite(surface.albedo).all(axis=2)
    if not known.any():
        raise KernelError("no pixel has a normal, a depth and an albedo; there is nothing to relight")
    points = camera.points(surface.depth_mm)[known]
    normal = surface.normal[known]
    view = camera.centre - points
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    channels = surface.albedo.shape[2]
    arrives, shine = np.zeros((2, len(points), channels))
    glossy = surface.specular is not None and surface.roughness is not None
    alpha = np.ones(len(points))
    if surface.roughness is not None:
        alpha = np.nan_to_num(surface.roughness[known], nan=1.0)
    depth = np.where(known, surface.depth_mm, np.nan)
    for first in range(0, len(lamps.places), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        places, reach, strength = lamps.places[part], lamps.reach_mm[part], lamps.strength[part]
        seen = np.ones((len(points), len(places)), np.float32)
        if shadows:
            seen = _softened(visible(points, depth, camera, places, slack_mm=SLACK_MM), known, edge_px)
        if glossy:
            # fall-off without the distance at which each has its strength, which may differ
            f = shines(normal, points, view, alpha, places, 1.0, surface.refraction)
            shine += (seen * f).astype(np.float64) @ (strength * reach[:, None] ** 2)
        for k, place in enumerate(places):
            way = place - points
            distance = np.linalg.norm(way, axis=1)
            lit = (
                seen[:, k]
                * np.maximum(np.einsum("pi,pi->p", normal, way) / distance, 0)
                * (reach[k] / distance) ** 2
            )
            arrives += lit[:, None] * strength[k]
    if glossy:
        shine *= np.nan_to_num(surface.specular[known])[:, None] / at_normal_incidence(surface.refraction)  # type: ignore[index]
    if bounces:
        arrives += _bounced(surface, camera, known, arrives, bounces)
    out = np.full((2, *known.shape, channels), np.nan, np.float32)
    out[0, known], out[1, known] = surface.albedo[known] * arrives, shine
    return Relit(out[0], out[1])


class Fidelity(NamedTuple):
    """How near a relit picture is to a true one."""

    psnr_db: float
    ssim: float


def compare(picture: NDArray[np.floating], truth: NDArray[np.floating], mask: NDArray[np.bool_]) -> Fidelity:
    """PSNR and SSIM inside a mask.

    The peak is the 99.9th percentile of the truth there; no gain is fitted. SSIM (Wang et al. 2004,
    doi:10.1109/TIP.2003.819861) has a Gaussian window of 1.5 px; its mean is over the mask, outside of which
    both pictures are 0.

    Args:
        picture, truth: (y, x) radiance. mask: (y, x), not empty.
    """
    peak = float(np.percentile(truth[mask], 99.9))
    relit, true = (np.where(mask, np.nan_to_num(p), 0.0).astype(np.float64) for p in (picture, truth))
    error = float(((relit - true)[mask] ** 2).mean())
    options = {"data_range": peak, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    _, local = structural_similarity(relit, true, full=True, **options)
    return Fidelity(float(10 * np.log10(peak**2 / max(error, 1e-30))), float(local[mask].mean()))


def _softened(seen: Image, known: NDArray[np.bool_], sigma: float) -> Image:
    if sigma <= 0:
        return seen
    around = MaskedMean(known, sigma, dtype=np.float32)
    out = np.empty_like(seen)
    layer = np.zeros(known.shape, np.float32)
    for k in range(seen.shape[1]):
        layer[known] = seen[:, k]
        out[:, k] = around(layer)[known]
    return out


def _bounced(
    surface: Surface, camera: Pinhole, known: NDArray[np.bool_], arrives: Array, bounces: int
) -> Array:  # (point, channel)
    depth = np.where(known, surface.depth_mm, np.nan)
    tiles = Tiles(camera.points(depth), np.nan_to_num(surface.normal), depth, known, camera)
    light = np.zeros((*known.shape, arrives.shape[1]))
    light[known] = arrives
    return tiles.passed_on(light, np.where(known[..., None], surface.albedo, 0), bounces)[known]


def median_cut(environment: NDArray[np.floating], count: int) -> tuple[Array, Array]:
    """Distant lights for an environment: regions of equal energy, each a light at its centroid.

    Args:
        environment: (y, x, channel) radiance, latitude and longitude as OpenEXR has them: the first row is +y, the
            middle column +z (towards the camera), a quarter from the left +x.
        count: how many lights, at most; regions are halved until there are so many, or one pixel each.

    Returns:
        unit vectors (light, xyz), and strengths (light, channel): radiance times solid angle over pi.

    Raises:
        KernelError: the environment is black, negative or not finite.
    """
    values = np.asarray(environment, np.float64)
    if values.ndim != 3 or not np.isfinite(values).all() or (values < 0).any() or not values.any():
        raise KernelError(
            "an environment needs finite radiance of at least 0 and somewhere above 0, (y, x, channel)"
        )
    height, width = values.shape[:2]
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    longitude = np.pi * (1 - 2 * (np.arange(width) + 0.5) / width)
    edges = np.sin(np.pi * (0.5 - np.arange(height + 1) / height))
    energy = values * ((edges[:-1] - edges[1:]) * 2 * np.pi / width)[:, None, None] / np.pi
    across = np.cos(latitude)[:, None]
    towards = np.stack(
        [
            across * np.sin(longitude),
            np.broadcast_to(np.sin(latitude)[:, None], (height, width)),
            across * np.cos(longitude),
        ],
        axis=-1,
    )
    weight = energy.sum(axis=2)
    regions = [(0, height, 0, width)]
    while len(regions) < count:
        sizes = [weight[a:b, c:d].sum() if (b - a) * (d - c) > 1 else -1.0 for a, b, c, d in regions]
        largest = int(np.argmax(sizes))
        if sizes[largest] <= 0:
            break
        regions[largest : largest + 1] = _halves(weight, latitude, regions[largest])
    directions, strength = [], []
    for a, b, c, d in regions:
        power = weight[a:b, c:d]
        if power.sum() > 0:
            middle = np.einsum("yx,yxi->i", power, towards[a:b, c:d])
            directions.append(middle / max(float(np.linalg.norm(middle)), 1e-12))
            strength.append(energy[a:b, c:d].sum(axis=(0, 1)))
    return np.array(directions), np.array(strength)


Region = tuple[int, int, int, int]


def _halves(weight: Array, latitude: Array, region: Region) -> list[Region]:
    """A region cut across its longer side, where half its energy is on either side."""
    a, b, c, d = region
    tall, wide = b - a, (d - c) * float(np.cos(latitude[a:b]).max())
    cut_rows = d - c == 1 or (b - a > 1 and tall >= wide)
    sums = np.cumsum(weight[a:b, c:d].sum(axis=1 if cut_rows else 0))
    at = 1 + int(np.argmin(np.abs(sums[:-1] - sums[-1] / 2)))
    return [(a, a + at, c, d), (a + at, b, c, d)] if cut_rows else [(a, b, c, c + at), (a, b, c + at, d)]
