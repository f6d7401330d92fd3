"""Which pictures are aligned, from plain data."""

from lightstage.kernels.motion.shots import Shot, Shots

PLAIN = {
    "members": [[3, "X", -0.1], [4, "C", 0.0], None],
    "around": [[9, "C", 0.5]],
    "bands_nm": [576.0],
    "components": ["diffuse"],
    "moving": True,
    "apart": False,
}


def test_places_that_are_not_filled_hold_no_shot() -> None:
    shots = Shots.of(PLAIN)
    assert shots.filled == {0: Shot(3, "X", -0.1), 1: Shot(4, "C", 0.0)}
    assert shots.around == (Shot(9, "C", 0.5),)
    assert shots.tracking == 1


def test_without_constant_light_the_first_picture_stands_for_the_tracking_frame() -> None:
    assert Shots.of({**PLAIN, "members": [[3, "X", 0.0], [5, "Y", 0.1]]}).tracking == 0
    # a tracking frame beside this one is a member, and not the one
    assert Shots.of({**PLAIN, "members": [[1, "C", -0.3], [4, "C", 0.0]]}).tracking == 1
