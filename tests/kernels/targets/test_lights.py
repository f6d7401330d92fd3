"""Which highlights count, and where lights are whose directions are known."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.labels import LIGHT_STATUS
from lightstage.kernels.targets.lights import Ball, Spots, item, lights, prepare, renumbered, sightings, verdict
from tests.kernels.targets import mirror_ball
from tests.kernels.targets.spots import circle

CENTRE, RADIUS = np.array([70.0, 60.0]), 45.0
RING = {0: circle(*CENTRE, RADIUS)}
NOTHING = np.array([np.nan, np.nan])


# a textbook's icosahedron, a vertex up: rings of five at heights +-1 / sqrt(5), the lower one turned by 36 degrees;
# numbered from above, each ring from the camera (z) towards x
ICOSAHEDRON = np.array(
    [
        [0, 1, 0],
        [0, 0.4472136, 0.8944272], [0.8506508, 0.4472136, 0.2763932], [0.5257311, 0.4472136, -0.7236068],
        [-0.5257311, 0.4472136, -0.7236068], [-0.8506508, 0.4472136, 0.2763932],
        [0.5257311, -0.4472136, 0.7236068], [0.8506508, -0.4472136, -0.2763932], [0, -0.4472136, -0.8944272],
        [-0.8506508, -0.4472136, -0.2763932], [-0.5257311, -0.4472136, 0.7236068],
        [0, -1, 0],
    ]
)  # fmt: skip


def shown(
    at: tuple[float, float] = (75.0, 60.0), peak: float = 400.0, *, second: float = np.nan, saturated: float = 0.0
) -> Spots:
    """One picture's spots, of 1.2 pixels' width."""
    peaks = np.array([peak, second])
    return Spots(np.array([at, NOTHING]), 10 * peaks, peaks, np.full(2, 1.2), np.array([saturated, 0.0]), 2.0)


def status_of(pictures: dict) -> list[str]:
    return [LIGHT_STATUS[k] for k in sightings(pictures, RING).status[0]]


def test_what_counts_is_told_by_how_bright_all_are() -> None:
    pictures = {
        (0, 0): shown(),
        (0, 1): shown(peak=19.0),  # below a twentieth of the median, 400
        (0, 2): shown(peak=np.nan),
        (0, 3): shown(second=101.0),  # more than a quarter
        (0, 4): shown(second=99.0),
        (0, 5): shown(saturated=60.0),  # a disc 8.7 px across; 0.15 x 45 = 6.75
        (0, 6): shown(at=(70.0 + 43.5, 60.0)),  # 1.5 px from the rim, less than two widths
    }
    assert status_of(pictures) == ["seen", "dark", "dark", "double", "seen", "saturated", "cut"]


def test_a_light_without_a_picture_at_one_place_is_missing_there() -> None:
    pictures = {(0, 0): shown(), (0, 1): shown(), (1, 0): shown(), (1, 1): shown(), (0, 2): shown()}
    seen = sightings(pictures, {0: RING[0], 1: RING[0]})
    assert LIGHT_STATUS[seen.status[1, 2]] == "missing"
    assert np.isnan(seen.highlights.at_px[1, 2]).all()


def test_spreads_are_those_of_centroid_saturation_and_rim() -> None:
    pictures = {(0, n): shown() for n in range(4)}
    pictures[0, 1] = shown(saturated=10.0)
    pictures[0, 2] = shown(at=(70.0 + 43.5, 60.0))
    sigma = sightings(pictures, RING).highlights.sigma_px[0]
    assert sigma[0] == pytest.approx(np.hypot(0.1, 2 / 400))
    assert sigma[1] == pytest.approx(np.hypot(0.1, 0.12))
    assert sigma[2] == pytest.approx(np.hypot(sigma[0], 0.3))


def test_too_few_highlights_are_refused() -> None:
    with pytest.raises(KernelError, match="1 of 3 pictures show a highlight"):
        sightings({(0, 0): shown(), (0, 1): shown(peak=np.nan), (0, 2): shown(peak=np.nan)}, RING)


def test_distant_lights_lie_where_the_bisector_says() -> None:
    """An orthographic camera: the normal at a highlight halves the way from the light to the camera."""
    towards = np.array([[0.3, 0.5, 0.8], [-0.6, 0.1, 0.4], [0.0, -0.7, 0.7], [0.8, 0.0, -0.2], [-0.2, 0.2, 0.9]])
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    normal = towards + np.array([0.0, 0.0, 1.0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    at = CENTRE + RADIUS * normal[:, :2] * [1, -1]
    names = [(0, n) for n in range(len(at))]
    dark = np.zeros((120, 140), np.uint16)  # no outline in it: the one under all lights is kept
    dark.flags.writeable = False
    spots = [shown(tuple(place)) for place in at]
    columns = {
        field: {name: np.asarray(getattr(spot, field)) for name, spot in zip(names, spots, strict=True)}
        for field in Spots._fields
    }
    arrays = lights(dict.fromkeys(names, dark), **columns, ring=RING, ball=Ball(None, None, None), layout=None)
    np.testing.assert_allclose(arrays["direction"], towards, atol=1e-5)  # the outline is fitted anew
    assert np.isnan(arrays["position_mm"]).all()
    labels = {"light": [f"L{n:02d}" for n in range(len(at))]}
    content = item(arrays=arrays, labels=labels, attrs={"parameters": {"driven_from": "ideal"}})
    np.testing.assert_allclose([light["direction"] for light in content["lights"]], towards, atol=1e-5)
    assert verdict(arrays=arrays, labels=labels)[-1] == ("good", "directions of 5 lights, without a layout")


def silhouette(ball_mm: np.ndarray) -> np.ndarray:
    """(point, xy): where rays touch the ball."""
    distance = np.linalg.norm(ball_mm)
    axis = ball_mm / distance
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    nearer = mirror_ball.RADIUS_MM**2 / distance
    radius = mirror_ball.RADIUS_MM * np.sqrt(1 - (mirror_ball.RADIUS_MM / distance) ** 2)
    turns = np.radians(np.arange(0, 360, 0.5))
    points = (distance - nearer) * axis + radius * (
        np.cos(turns)[:, None] * across + np.sin(turns)[:, None] * np.cross(axis, across)
    )
    return np.array([mirror_ball.projected(point) for point in points])


def test_a_stage_built_to_a_textbooks_icosahedron_is_placed_and_numbered() -> None:
    """Shown by the shortest way over the ball (Fermat); one light is behind the ball and left to the layout."""
    ball_mm = np.array([1.0, 3.0, 888.0])
    places = 790.0 * ICOSAHEDRON
    hidden = 8
    visible = [n for n in range(12) if n != hidden]
    at = mirror_ball.shown(places[visible], ball_mm)
    spots = {(0, n): shown(tuple(place), 400.0) for n, place in zip(visible, at, strict=True)}
    spots[0, hidden] = shown(peak=np.nan)
    dark = np.zeros((309, 406), np.uint16)  # no outline in it: the one under all lights is kept
    columns = {field: {k: np.asarray(getattr(s, field)) for k, s in spots.items()} for field in Spots._fields}
    layout = prepare(
        camera=None, ball_radius_mm=None, mask=None, geodesic={"frequency": 1, "whole": True},
        stage_radius_mm=790.0, stage_sigma_mm=3.0, placement_sigma_mm=5.0,
    )["layout"]  # fmt: skip
    ball = Ball(mirror_ball.camera(), mirror_ball.RADIUS_MM, None)
    arrays = lights(dict.fromkeys(spots, dark), **columns, ring={0: silhouette(ball_mm)}, ball=ball, layout=layout)
    away = np.linalg.norm(arrays["position_mm"] - places, axis=1)
    assert away.max() < 4.0  # the stage's radius is believed to 3 mm, its middle to 2
    assert away[visible].mean() < 1.5
    np.testing.assert_array_equal(arrays["layout_place"], np.arange(12))
    np.testing.assert_allclose(arrays["drive_position"], ICOSAHEDRON, atol=1e-6)
    np.testing.assert_allclose(arrays["ball_mm"][0], ball_mm, atol=0.3)
    assert not arrays["off_place"].any()
    assert not arrays["renumbered"]


def test_a_ring_counted_from_another_start_is_a_numbering_and_one_swap_is_not() -> None:
    place = np.arange(12)
    assert renumbered(place, ICOSAHEDRON) is None
    ring = np.arange(1, 6)  # the five at one height
    place[ring] = np.roll(ring, 2)
    order = renumbered(place, ICOSAHEDRON)
    assert order is not None
    np.testing.assert_array_equal(order[ring], [4, 5, 1, 2, 3])
    swapped = np.arange(12)
    swapped[[3, 9]] = 9, 3
    assert renumbered(swapped, ICOSAHEDRON) is None


def test_the_verdict_names_what_is_wired_wrongly_and_what_is_not_seen() -> None:
    status = np.array([[LIGHT_STATUS.index(kind) for kind in ("seen", "seen", "seen", "dark", "cut")]])
    arrays = {
        "status": status,
        "layout_place": np.array([1, 0, 7, 3, 4]),
        "off_place": np.array([False, False, False, False, True]),
        "residual_mm": np.array([1.0, 2.0, 3.0, np.nan, 31.0]),
        "position_mm": np.ones((5, 3)),
        "direction": np.ones((5, 3)),
        "stage_mm": np.array([0.0, 0.0, 0.0, 790.0]),
        "renumbered": np.array(False),
    }
    labels = {"light": [f"L{n:02d}" for n in range(5)]}
    findings = verdict(arrays=arrays, labels=labels)
    assert [severity for severity, _ in findings] == ["bad", "bad", "doubtful", "doubtful", "doubtful", "good"]
    sentences = [sentence for _, sentence in findings]
    assert sentences[0].startswith("L00 and L01 are swapped")
    assert sentences[1].startswith("L02 shows at the place of L07")
    assert sentences[2].startswith("L03 not seen")
    assert sentences[3] == "L04 is 31 mm off its place"
    assert sentences[4].startswith("L04 is cut")
    assert "4 of 5 lights fit the layout to 2.5 mm" in sentences[5]


def test_a_rig_driven_from_measured_positions_has_no_drive_positions() -> None:
    arrays = {
        "position_mm": np.array([[1.0, 2.0, 3.0]]),
        "direction": np.full((1, 3), np.nan),
        "drive_position": np.array([[0.0, 1.0, 0.0]]),
        "status": np.array([[0]]),
    }
    for driven_from, has in (("ideal", True), ("measured", False)):
        content = item(arrays=arrays, labels={"light": ["L00"]}, attrs={"parameters": {"driven_from": driven_from}})
        assert content["drive"] == driven_from
        assert ("drive_position" in content["lights"][0]) == has


def test_a_context_becomes_a_camera_and_a_layout() -> None:
    camera = {
        "size_px": [140, 120],
        "K": [[900, 0, 70], [0, 900, 60], [0, 0, 1]],
        "distortion": [0.0] * 5,
        "world_to_camera": {"R": np.diag([1, -1, -1]).tolist(), "t_mm": [0, 0, 890]},
    }
    radii = {"stage_radius_mm": 790.0, "stage_sigma_mm": 3.0, "placement_sigma_mm": 5.0}
    numbers = prepare(
        camera=camera, ball_radius_mm=38.1, mask=None, geodesic={"frequency": 2, "whole": False}, **radii
    )
    assert numbers["ball"].camera.shape == (120, 140)
    assert numbers["layout"].places.shape == (41, 3)
    assert numbers["layout"].placement_sigma_mm == 5
    whole = prepare(camera=None, ball_radius_mm=None, mask=None, geodesic={"frequency": 2, "whole": True}, **radii)
    assert whole["layout"].places.shape == (42, 3)
    assert whole["ball"].lens.intrinsics is None
