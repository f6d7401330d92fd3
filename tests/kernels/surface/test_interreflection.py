"""Bounced light: the line over the bands, and form factors."""

import numpy as np
import pytest

from lightstage.kernels.surface.interreflection import Tiles, without_bounces
from lightstage.kernels.surface.pinhole import Pinhole


def test_the_spectral_line_ends_at_direct_light() -> None:
    """q = (P + a P1) / (S + a S1) over six albedos: at zero it is P / S but for the second order in a."""
    generator = np.random.default_rng(5)
    shape = (40, 40)
    direct = np.stack([np.full(shape, v) for v in (0.3, -0.2, 0.6)], axis=-1)
    bounced = np.array([0.02, 0.05, -0.03])
    albedo = np.linspace(0.2, 0.8, 6)[:, None, None] * np.ones(shape)
    ratio = (direct + albedo[..., None] * bounced) / (1 + 0.1 * albedo)[..., None]
    ratio += generator.normal(0, 1e-3, ratio.shape)
    constant = albedo * (1 + 0.1 * albedo)
    mask = np.ones(shape, bool)
    slope, around = without_bounces(ratio, np.ones((6, *shape)), constant, np.ones(shape), mask)
    free = (ratio - around[..., None] * slope).mean(axis=0)
    before = np.abs(ratio.mean(axis=0) - direct).max(axis=(0, 1))
    after = np.abs(free.mean(axis=(0, 1)) - direct[0, 0])
    assert (after < 0.3 * before).all()


def test_form_factors_of_two_facing_squares() -> None:
    """Two walls of a right angle, each as wide as the edge they share: F = 0.2 (Howell's C-14), 20 x 20 tiles.

    The centres of tiles at the edge are close for their size, which costs a tenth.
    """
    size = 64
    camera = {
        "size_px": [size, size],
        "K": [[size * 10.0, 0, 31.5], [0, size * 10.0, 31.5], [0, 0, 1]],
        "distortion": [0, 0, 0, 0, 0],
        "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 2000.0]},
    }
    pinhole = Pinhole.of(camera, (size, size))
    # a valley along y: both walls at 45 degrees, deepest in the middle
    x = np.arange(size) - 31.5
    mm = 2000.0 / (size * 10.0)
    depth = np.broadcast_to(2000.0 - np.abs(x) * mm, (size, size)).copy()
    normal = np.zeros((size, size, 3))
    normal[:, :32] = np.array([1, 0, 1]) / np.sqrt(2)
    normal[:, 32:] = np.array([-1, 0, 1]) / np.sqrt(2)
    tiles = Tiles(pinhole.points(depth), normal, depth, np.ones((size, size), bool), pinhole)
    left = tiles.mean(np.broadcast_to(x < 0, (size, size)).astype(float)) > 0.5
    factors = tiles._factors[np.ix_(left, ~left)].sum(axis=1).mean()
    # walls of width w = 32 sqrt(2) and length 64 of the same unit: h/l = w/l = 0.707 gives 0.2338
    assert factors == pytest.approx(0.2338, rel=0.1)
