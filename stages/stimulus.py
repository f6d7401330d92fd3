"""stimulus: pictures of a face that hold its shape, its texture, or both.

    shape    s = sum_k p_k v_k max(0, n . l_k)
    texture  t = M rho
    both     s t

l_k is a distant light of strength p_k, given by azimuth and elevation; n the normal; v_k its cast shadow (1 without
`cast_shadows`); rho the reflectance in every band, out of which shading has been taken; M makes linear sRGB, or
luminance alone, of the bands (`colour.py`). All is linear light: 1 is a white surface facing a light of strength 1.

The thesis gives s as n . l_1 + n . l_2 with two frontal lights that were chosen by hand, and no numbers; here they
stand 30 degrees to the left and right and 15 up, each of strength 1/2. A light behind the surface counts as none,
where the thesis' sum would count it as negative. `texture: constant` is the thesis' texture, the diffuse picture
under constant light, which keeps ambient occlusion; it is there for comparison.

Must have run before: normals and reflectance. Limits: Lambertian; no light is bounced; shadows are cast by what the
depth map holds (`visibility.py`).

Source: Dutta (2010), section on stimuli for a psychology experiment; Jones et al. (2010).
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import Field, field_validator

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.kernels.appearance.distant_lights import parse_lights
from lightstage.kernels.items import lens_of

KINDS = ("shape", "texture", "both")


class StimulusParams(Params):
    """Parameters of `stimulus`."""

    lights: str = Field(
        "-30,15,0.5 30,15,0.5",
        description="of each light azimuth (degrees, to the right), elevation (degrees, up) and strength",
    )
    cast_shadows: bool = Field(
        False, description="shadows that the depth map casts; attached ones are always there"
    )
    texture: Literal["reflectance", "constant"] = Field(
        "reflectance", description="constant: the diffuse picture under constant light, with its ambient occlusion"
    )
    colour: Literal["colour", "grey"] = Field("colour", description="linear sRGB, or luminance alone")
    illuminant: str = Field("D65", description="CIE illuminant under which the bands are seen as colour")

    @field_validator("lights")
    @classmethod
    def _lights(cls, text: str) -> str:
        parse_lights(text)
        return text


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: StimulusParams) -> Arrangement:
    relief, painted = grids
    if params.cast_shadows and "depth_mm" not in relief.arrays:
        raise StageError(
            "cast_shadows needs depth: normals above with correct: near, near+shadows or full, which need the "
            "lights and camera items; without it only attached shadows are made"
        )
    if relief.sizes["band"] != 1:
        raise StageError("a stimulus needs one shape for all bands: set fuse: bands on the node of normals above")
    where = {frame: k for k, frame in enumerate(relief.along("tracking"))}
    frames = list(painted.along("tracking"))
    height, width = relief.sizes["y"], relief.sizes["x"]
    bands = [float(b) for b in painted.along("band")]
    groups = tuple(
        Group(
            {
                "normal": {frame: {"tracking": where[frame], "band": 0}},
                "depth_mm": {frame: {"tracking": where[frame]}},
                "reflectance": {frame: {"tracking": k}},
                "shading": {frame: {"tracking": k}},
            },
            {"bands_nm": bands, "shape": [height, width]},
        )
        for k, frame in enumerate(frames)
    )
    channels = ["r", "g", "b"] if params.colour == "colour" else ["luminance"]
    sizes = {"tracking": len(frames), "kind": len(KINDS), "rgb": len(channels), "y": height, "x": width}
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "tracking": (("tracking",), frames),
        "kind": (("kind",), list(KINDS)),
        "rgb": (("rgb",), channels),
    }
    if "time_s" in relief.labels:
        labels["time_s"] = relief.labels["time_s"]
    attrs = {
        "lights": params.lights,
        "cast_shadows": int(params.cast_shadows),
        "texture": params.texture,
        "colour": params.colour,
        "illuminant": params.illuminant,
        "encoding": "linear",
        **{f"reflectance_{k}": painted.attrs[k] for k in ("scale", "shading") if k in painted.attrs},
    }
    return Arrangement(Grid(sizes, labels, attrs), groups)


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: StimulusParams
) -> Mapping[str, Any]:
    camera = None
    if params.cast_shadows:
        if "camera" not in items:
            raise StageError("cast_shadows needs the camera item: bind one with `lightstage calibration use FILE`")
        camera = lens_of(items["camera"])
    known = items["bands"]["bands"] if "bands" in items else []
    width = {float(band["centre_nm"]): band.get("width_nm") for band in known}
    return {
        "bands_nm": labels["bands_nm"],
        "widths_nm": [width.get(nm) for nm in labels["bands_nm"]],
        "illuminant": params.illuminant,
        "colour": params.colour,
        "shape": labels["shape"],
        "camera": camera,
    }


STAGE = Stage(
    name="stimulus",
    version=1,
    summary="pictures of shape, texture and both",
    params=StimulusParams,
    inputs={
        "normal": Input("normal", ("tracking", "band", "xyz", "y", "x"), "group"),
        "depth_mm": Input("depth_mm", ("tracking", "y", "x"), "group", optional=True),
        "reflectance": Input("reflectance", ("tracking", "band", "y", "x"), "group", source=1),
        "shading": Input("shading", ("tracking", "y", "x"), "group", source=1),
    },
    calibration={
        "camera": Needs(why="shadows cannot be cast"),
        "bands": Needs(why="bands are taken as narrow in the colours"),
    },
    outputs={
        "image": Output(
            ("tracking", "kind", "rgb", "y", "x"),
            "float32",
            attrs={
                "units": "1",
                "long_name": "linear light; 1 is a white surface that faces a light of strength 1",
            },
        )
    },
    blocks=("tracking",),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.appearance.stimulus:prepare",
    prepared=("matrix", "camera"),
    kernel="lightstage.kernels.appearance.stimulus:stimulus",
)
