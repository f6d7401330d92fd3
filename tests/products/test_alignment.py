"""A set and its alignment, made by hand: what is read, left, and marked."""

from typing import Any

import numpy as np
import pytest
import xarray

from lightstage.products.alignment import AlignedSet, chosen_points, least_confidence, read_set, residual_of
from lightstage.products.errors import ProductError

LIGHTS = ("X", "C", "Xc")
SHAPE = (40, 60)


def scene() -> np.ndarray:
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    spots = [np.exp(-((x - column) ** 2 + (y - row) ** 2) / 8) for row, column in ((12, 14), (26, 44))]
    return (0.5 + 0.5 * sum(spots)).astype(np.float32)


def results(shift: int = 2) -> tuple[xarray.Dataset, xarray.Dataset]:
    """Of three pictures, X and Xc moved to the right by `shift`, and put back."""
    share = np.array([0.75, 1, 0.25], np.float32)[:, None, None]
    still = share * scene()
    captured = np.stack([np.roll(still[0], shift, 1), still[1], np.roll(still[2], shift, 1)])
    flow = np.zeros((1, 4, 2, *SHAPE), np.float32)
    flow[0, [0, 2], 0] = shift
    confidence = np.ones((1, 4, *SHAPE), np.float32)
    confidence[0, 3] = np.nan
    labels: dict[str, Any] = {"band": [0.0], "component": ["diffuse"]}
    stack = xarray.Dataset(
        {"radiance": (("frame", "band", "component", "y", "x"), captured[:, None, None])},
        {
            "frame": [0, 1, 2],
            "illumination": ("frame", list(LIGHTS)),
            "time_s": ("frame", [0, 0.01, np.nan]),
            **labels,
        },
    )
    aligned = xarray.Dataset(
        {
            "flow": (("tracking", "member", "xy", "y", "x"), flow),
            "aligned": (
                ("tracking", "member", "band", "component", "y", "x"),
                np.concatenate([still, still[:1]])[None, :, None, None],
            ),
            "confidence": (("tracking", "member", "y", "x"), confidence),
        },
        {"tracking": [1], "frame": (("tracking", "member"), [[0, 1, 2, -1]]), **labels},
        {"engine": "motion"},
    )
    return aligned, stack


def read(**more: Any) -> AlignedSet:
    return read_set("a", *results(**more), None)


def test_the_set_is_in_time_order_with_the_tracking_frame() -> None:
    made = read()
    assert (made.tracking, made.engine, made.middle.illumination) == (1, "motion", "C")
    assert [column.caption for column in made.columns] == [
        "frame 0  X  0.0 ms",
        "frame 1  C  10.0 ms",
        "frame 2  Xc",
    ]
    assert not any(column.left_out for column in made.columns)
    with pytest.raises(ProductError, match="'align' of session 'a' has no tracking frame 2; it has 1"):
        read_set("a", *results(), 2)
    aligned, stack = results()
    with pytest.raises(ProductError, match="was made of another stack than the one in use"):
        read_set("a", aligned, stack.isel(frame=[0, 1]), None)


def test_the_residual_is_that_of_the_pair() -> None:
    made = read()
    residual = residual_of(made)
    assert residual is not None
    moved = np.abs(np.roll(scene(), 2, 1) - scene()).sum() / scene().sum()
    assert residual.mean_before == pytest.approx(moved, rel=1e-5)
    assert residual.mean_after == pytest.approx(0, abs=1e-6)
    alone = AlignedSet("a", 1, "motion", made.columns[:2])
    assert residual_of(alone) is None
    other = AlignedSet("a", 0, "motion", made.columns)  # not under constant light
    assert residual_of(other) is None


def test_points_lie_on_texture_that_moves_where_the_flow_is_sure() -> None:
    made = read()
    points = chosen_points(made, 3)
    assert points
    for x, y in points:
        assert min(np.hypot(x - 14, y - 12), np.hypot(x - 44, y - 26)) < 8
    made.columns[0].confidence[:, :30] = 0.2
    assert all(x >= 30 for x, _ in chosen_points(made, 3))
    assert least_confidence(made.columns)[0, 0] == np.float32(0.2)
