"""The parts of items that kernels read, out of items written by hand."""

import pytest

from lightstage.kernels.items import lens_of, lights_of, lights_placed

CAMERA = {
    "item": "camera", "rig": "york", "valid_from": "2010-01-01", "residuals": {"rms_px": 0.2},
    "size_px": [406, 309], "K": [[1020, 0, 203], [0, 1020, 153], [0, 0, 1]], "distortion": [0, 0, 0, 0, 0],
    "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 890]},
}  # fmt: skip


def light(name: str, **more: object) -> dict[str, object]:
    return {
        "id": name, "channel": 3, "position_mm": [0, 0, 790], "direction": None, "drive_position": [0, 0, 1],
        "power": 1.0, "seen": True, **more,
    }  # fmt: skip


def test_a_lens_is_size_matrix_distortion_and_pose() -> None:
    lens = lens_of(CAMERA)
    assert lens == {name: CAMERA[name] for name in ("size_px", "K", "distortion", "world_to_camera")}
    # what is only noted of the item enters no key
    assert lens == lens_of({**CAMERA, "rig": "other", "residuals": None})


def test_lights_are_places_powers_and_where_their_weights_are_from() -> None:
    ideal = lights_of({"drive": "ideal", "lights": [light("L00")]})
    assert ideal == {
        "lights": [
            {"id": "L00", "position_mm": [0, 0, 790], "direction": None, "power": 1.0, "drive_position": [0, 0, 1]}
        ]
    }
    # channel and `seen` enter no key
    assert ideal == lights_of({"drive": "ideal", "lights": [light("L00", channel=9, seen=False)]})


def test_a_rig_driven_from_measured_positions_has_its_weights_from_where_lights_are() -> None:
    measured = lights_of({"drive": "measured", "lights": [light("L00", drive_position=[0, 1, 0])]})
    assert measured["lights"][0]["drive_position"] is None
    assert measured == lights_of({"drive": "measured", "lights": [light("L00")]})


@pytest.mark.parametrize(("positions", "placed"), [([[0, 0, 1], [1, 0, 0]], True), ([[0, 0, 1], None], False)])
def test_one_direction_alone_is_a_rig_not_placed(positions: list[list[float] | None], placed: bool) -> None:
    lights = [light(f"L{i:02d}", position_mm=position) for i, position in enumerate(positions)]
    assert lights_placed({"lights": lights}) is placed
