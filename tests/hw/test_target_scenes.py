"""Targets before a sensor: Fermat's principle, Fresnel's equations, and areas counted by hand."""

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given
from hypothesis import strategies as st

from lightstage.hw import target_scenes as scenes

K = np.array([[500.0, 0, 100.0], [0, 480.0, 80.0], [0, 0, 1]])
CAMERA_MM = 890.0
EYE = np.array([0.0, 0.0, CAMERA_MM])
CENTRE = np.array([5.0, -8.0, 12.0])
BALL_MM = 38.1


def lights(seed: int, count: int = 12) -> np.ndarray:
    """Anywhere on the front half of a sphere."""
    points = np.random.default_rng(seed).standard_normal((count, 3))
    points[:, 2] = np.abs(points[:, 2])
    return np.asarray(790 * points / np.linalg.norm(points, axis=1, keepdims=True))


def test_projection_by_hand() -> None:
    # 89 mm right and up at the stage's centre, 890 mm before the camera: a tenth of the focal lengths
    np.testing.assert_allclose(scenes.project(np.array([89.0, 89, 0]), K, CAMERA_MM), [150, 32])
    np.testing.assert_allclose(scenes.project(np.array([89.0, 89, 445]), K, CAMERA_MM), [200, -16])


@pytest.mark.parametrize("seed", range(4))
def test_highlights_are_where_the_way_of_light_is_shortest(seed: int) -> None:
    """Fermat: of all points of the ball, the way from the light to the camera by the highlight is the shortest."""
    hit = scenes.highlights(lights(seed), CENTRE, BALL_MM, K, CAMERA_MM)

    def way(angles: np.ndarray, light: np.ndarray) -> float:
        a, b = angles
        normal = np.array([np.cos(a) * np.sin(b), np.sin(a), np.cos(a) * np.cos(b)])
        point = CENTRE + BALL_MM * normal
        return float(np.linalg.norm(point - EYE) + np.linalg.norm(point - light))

    for light, point, normal, pixel in zip(lights(seed), hit.point_mm, hit.normal, hit.pixel, strict=True):
        toward = light / np.linalg.norm(light) + [0, 0, 1]
        start = [np.arcsin(toward[1] / np.linalg.norm(toward)), np.arctan2(toward[0], toward[2])]
        a, b = scipy.optimize.minimize(
            way, start, (light,), "Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10}
        ).x
        shortest = CENTRE + BALL_MM * np.array([np.cos(a) * np.sin(b), np.sin(a), np.cos(a) * np.cos(b)])
        np.testing.assert_allclose(point, shortest, atol=0.02)  # the way is flat at its least: 1e-10 mm are 0.01 mm
        np.testing.assert_allclose(point, CENTRE + BALL_MM * normal)
        np.testing.assert_allclose(pixel, scenes.project(point, K, CAMERA_MM))


@given(st.integers(0, 2**32 - 1))
def test_incidence_equals_reflection_in_one_plane(seed: int) -> None:
    places = lights(seed, 3)
    hit = scenes.highlights(places, CENTRE, BALL_MM, K, CAMERA_MM)
    into, out = places - hit.point_mm, EYE - hit.point_mm
    into, out = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (into, out))
    cosine = np.sum(into * hit.normal, axis=1)
    np.testing.assert_allclose(cosine, np.sum(out * hit.normal, axis=1), atol=1e-9)
    np.testing.assert_allclose(np.degrees(np.arccos(np.clip(cosine, -1, 1))), hit.incidence_deg, atol=1e-5)
    np.testing.assert_allclose(np.einsum("li,li->l", np.cross(into, out), hit.normal), 0, atol=1e-9)


def test_the_stand_hides_what_is_mirrored_below() -> None:
    """The cup begins 8 mm above the ball's lowest point and is 23 mm wide: a lamp below and behind is mirrored
    there, one below and before the ball past its rim."""
    places = np.array([[0.0, 700, 360], [0.0, -780, 100], [0.0, -700, -300]])
    assert scenes.highlights(places, np.zeros(3), BALL_MM, K, CAMERA_MM).visible.tolist() == [True, True, False]


def test_a_spot_has_its_flux_its_place_and_its_width() -> None:
    picture = scenes.spots((40, 60), np.array([[20.3, 11.8], [45.0, 30.5]]), np.array([1000.0, 0.0]))
    assert picture.sum() == pytest.approx(1000, rel=1e-6)
    y, x = np.mgrid[0:40, 0:60]
    assert (picture * x).sum() / 1000 == pytest.approx(20.3, abs=1e-4)
    assert (picture * y).sum() / 1000 == pytest.approx(11.8, abs=1e-4)
    # a Gaussian's variance, and a pixel's 1/12 of being square
    assert (picture * (x - 20.3) ** 2).sum() / 1000 == pytest.approx(0.8**2 + 1 / 12, abs=1e-3)
    half = scenes.spots((40, 60), np.array([[0.0, 11.0]]), np.array([1000.0]))
    # over the border: half of the light, and that of the half pixel beyond the middle
    assert half.sum() == pytest.approx(1000 * 0.734, abs=1)  # Phi(0.5 / 0.8)


def test_a_ball_covers_the_pixels_whose_rays_meet_it() -> None:
    shape, centre = (160, 200), np.array([3.0, 6.0, 10.0])
    picture = scenes.ball_and_stand(shape, centre, BALL_MM, K, CAMERA_MM, 10.0)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    rays = np.stack([(x - 100) / 500, -(y - 80) / 480, -np.ones(shape)], axis=-1)
    apart = np.linalg.norm(np.cross(rays, centre - EYE), axis=-1) / np.linalg.norm(rays, axis=-1)
    above = y < scenes.project(centre, K, CAMERA_MM)[1] - 3  # the stand is below
    np.testing.assert_allclose(picture[above & (apart > BALL_MM + 8)], 10, atol=1e-3)  # 4 px: the blur ends
    assert picture[above & (apart < BALL_MM - 8)].min() > 12
    # at its top the ball mirrors what is level with it, 2.2 times the background: half way is 16
    column = round(scenes.project(centre, K, CAMERA_MM)[0])
    top = np.interp(16, picture[50:62, column], np.arange(50, 62))
    assert top == pytest.approx(
        np.interp(-BALL_MM, -apart[50:62, column], np.arange(50, 62)), abs=0.5
    )  # the lens' blur


def test_a_plane_shows_its_texture_where_the_homography_puts_it() -> None:
    turn = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    t = np.array([10.0, -5.0, 20.0])
    to_image = scenes.plane_to_image(turn, t, K, CAMERA_MM)
    for u, v in ((0, 0), (30, -20), (-15, 25)):
        seen = to_image @ [u, v, 1]
        expected = scenes.project(turn[:, 0] * u + turn[:, 1] * v + t, K, CAMERA_MM)
        np.testing.assert_allclose(seen[:2] / seen[2], expected)

    def half(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.where(u < 0, 1.0, 0.0)

    picture = scenes.plane(lambda x, y: np.stack([x, y], axis=-1), (60, 200), to_image, half)
    assert picture[:, :60].min() == pytest.approx(1)
    assert picture[:, 150:].max() == pytest.approx(0)
    edge = to_image @ [0, 0, 1]
    # the sum of a row is the length of its bright part; pixel 0 begins at -0.5
    assert picture[30].sum() - 0.5 == pytest.approx(edge[0] / edge[2], abs=0.2)  # 5 samples a pixel


def test_fresnel_by_hand() -> None:
    straight = np.array([0.0])
    # Born and Wolf: ((n - 1) / (n + 1))^2 of glass; of chromium ((2.1^2 + 3.3^2) / (4.1^2 + 3.3^2)) = 0.552
    for index, share in ((scenes.PLASTIC, (0.52 / 2.52) ** 2), (scenes.CHROMIUM, 15.3 / 27.7)):
        for amplitude in scenes.fresnel(index, straight):
            assert abs(amplitude[0]) ** 2 == pytest.approx(share)
    # Brewster: at arctan n nothing of p comes back
    r_s, r_p = scenes.fresnel(scenes.PLASTIC, np.arctan([1.52]))
    assert abs(r_p[0]) < 1e-12
    assert abs(r_s[0]) == pytest.approx((1.52**2 - 1) / (1.52**2 + 1))
    for amplitude in scenes.fresnel(scenes.CHROMIUM, np.array([np.pi / 2])):
        assert abs(amplitude[0]) == pytest.approx(1)  # grazing


def test_a_lamp_beside_the_camera_is_seen_through_crossed_polarisers_as_they_leak() -> None:
    """Straight reflection keeps polarisation: brightest with the light's polariser along the analyser, world x."""
    place = np.array([[1.0, 20.0, 2000.0]])
    for index, share in ((scenes.PLASTIC, (0.52 / 2.52) ** 2), (scenes.CHROMIUM, 15.3 / 27.7)):
        hit = scenes.highlights(place, np.zeros(3), BALL_MM, K, CAMERA_MM)
        ((a, b, theta0),) = scenes.polarised(hit, place, CAMERA_MM, index, 1 / 400)
        assert np.mod(np.degrees(theta0), 180) == pytest.approx(90, abs=0.1)  # its incidence is 0.1 degrees
        assert a == pytest.approx(share / 400, rel=1e-3)
        assert a + b == pytest.approx(share, rel=1e-3)


@given(st.integers(0, 2**32 - 1))
def test_a_dielectric_leaks_only_what_the_sheets_leak_and_a_metal_more(seed: int) -> None:
    places = lights(seed, 4)
    hit = scenes.highlights(places, CENTRE, BALL_MM, K, CAMERA_MM)
    for index, more in ((scenes.PLASTIC, False), (scenes.CHROMIUM, True)):
        a, b, _ = scenes.polarised(hit, places, CAMERA_MM, index, 1 / 400).T
        assert (b >= 0).all()
        least = a / (a + b)
        if more:
            assert (least >= 1 / 400 - 1e-9).all()
        else:
            np.testing.assert_allclose(least, 1 / 400, rtol=1e-4)
