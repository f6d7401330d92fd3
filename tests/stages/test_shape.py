"""What a height map is made of."""

from lightstage.dag.stage import Grid
from lightstage.stages.shape import STAGE


def relief(*arrays: str) -> Grid:
    sizes = {"tracking": 1, "band": 2, "y": 4, "x": 6}
    labels = {"tracking": (("tracking",), [5]), "band": (("band",), [434.0, 576.0])}
    return Grid(sizes, labels, arrays=frozenset(arrays))


def test_depth_that_was_found_is_taken_and_the_mask_is_not_read() -> None:
    arranged = STAGE.arrange([relief("normal", "albedo", "depth_mm")], {}, STAGE.params())
    assert arranged.grid.attrs["from"] == "depth found with the normals"
    (group,) = arranged.groups
    assert group.reads["depth_mm"] == {5: {"tracking": 0}}
    assert group.reads["normal"] == {434.0: {"tracking": 0, "band": 0}, 576.0: {"tracking": 0, "band": 1}}
    assert STAGE.context is not None
    camera = {"size_px": [6, 4], "K": [], "distortion": [], "world_to_camera": {}, "rms_px": 0.2}
    context = STAGE.context(group.labels, {"mask": "a mask"}, {"camera": camera}, STAGE.params())
    assert context["mask"] is None
    assert "rms_px" not in context["camera"]


def test_without_depth_normals_are_integrated_within_the_mask() -> None:
    arranged = STAGE.arrange([relief("normal", "albedo")], {}, STAGE.params())
    assert arranged.grid.attrs["from"].startswith("integrated normals")
    assert arranged.groups[0].labels == {"shape": [4, 6], "integrated": True}
