"""Which tracking frames tell the normals at a picture."""

from lightstage.dag.stage import Grid
from lightstage.stages.upsample import STAGE

ILLUMINATION = ["X", "C", "Y", "Xc", "C", "Z"]
FACTS = {
    "frame_rate_hz": 60.0,
    "illumination": ILLUMINATION,
    "time_s": [float(i) for i in range(6)],
}


def grids(*members: list[int], tracking: list[int]) -> list[Grid]:
    labels = {"tracking": (("tracking",), tracking)}
    sizes = {"tracking": len(tracking), "y": 4, "x": 4}
    rows = (("tracking", "member"), list(members))
    return [Grid(sizes, labels), Grid({**sizes, "member": len(members[0])}, {**labels, "frame": rows})]


def test_a_picture_reads_the_tracking_frames_around_it_by_the_time_to_them() -> None:
    arranged = STAGE.arrange(grids([0, 1, 2, 3, -1], [2, 3, 4, 5, -1], tracking=[1, 4]), FACTS, STAGE.params())
    assert arranged.grid.along("frame") == [0, 1, 2, 3, 4, 5]
    first, own, between = arranged.groups[0], arranged.groups[1], arranged.groups[2]
    assert first.reads["normal"] == {1.0: {"tracking": 0}}
    assert own.reads["flow"] == {0.0: {"tracking": 0, "member": 1}}
    assert between.reads["normal"] == {-1.0: {"tracking": 0}, 2.0: {"tracking": 1}}
    assert between.reads["flow"] == {-1.0: {"tracking": 0, "member": 2}, 2.0: {"tracking": 1, "member": 0}}
    assert between.labels == {"between": 2}


def test_only_the_printed_weights_depend_on_the_sequence() -> None:
    assert STAGE.context is not None
    for weights, told in (("nearness", None), ("printed", 2)):
        assert STAGE.context({"between": 2}, FACTS, {}, STAGE.params(weights=weights)) == {"between": told}


def test_of_a_still_subject_the_tracking_frame_alone_is_a_picture() -> None:
    still = {**FACTS, "frame_rate_hz": None}
    arranged = STAGE.arrange(grids([0, 1, 2], tracking=[1]), still, STAGE.params())
    assert arranged.grid.along("frame") == [1]
