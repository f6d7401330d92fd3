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

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.kernels.appearance.colour import linear_srgb_matrix, xyz_matrix
from lightstage.kernels.appearance.shading import cast_shadows as shadows_of
from lightstage.kernels.appearance.shading import parse_lights, shade
from lightstage.kernels.surface.pinhole import Pinhole

Image = NDArray[np.float32]
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


def stimulus(
    normal: Sequence[Image],
    depth_mm: Sequence[Image],
    reflectance: Sequence[Image],
    shading: Sequence[Image],
    *,
    matrix: Sequence[Sequence[float]],
    camera: Pinhole | None,
    lights: str,
    cast_shadows: bool,
    texture: str,
) -> Mapping[str, Any]:
    """The three pictures of one tracking frame.

    Args:
        normal: one (xyz, y, x), unit vectors in the world frame, NaN where not valid.
        depth_mm: none, or one (y, x), camera z; only cast shadows read it.
        reflectance: one (band, y, x), 0 to 1.
        shading: one (y, x): what was divided out of the reflectance.
        matrix: (rgb, band), to linear sRGB, or (1, band), to luminance.
        camera: of the depth; None without cast shadows.
        lights, cast_shadows, texture: see StimulusParams.

    Returns:
        `image` (kind, rgb, y, x) float32, linear light, in the order of KINDS; NaN where normal or reflectance is
        not valid. `stats`: the part of shape that is in shadow.
    """
    places = parse_lights(lights)
    seen = None
    if cast_shadows:
        assert camera is not None
        seen = shadows_of(depth_mm[0], camera, places)
    shape = shade(normal[0], places, seen)
    skin = reflectance[0] * shading[0] if texture == "constant" else reflectance[0]
    painted = np.einsum("cb,byx->cyx", np.asarray(matrix, np.float32), skin)
    valid = np.isfinite(shape) & np.isfinite(painted).all(axis=0)
    image = np.stack([np.broadcast_to(shape, painted.shape), painted, shape * painted])
    image = np.where(valid, image, np.float32(np.nan)).astype(np.float32)
    dark = float(np.mean(shape[valid] <= 0)) if valid.any() else 1.0
    return {"image": image, "stats": {"shape_in_shadow": dark}}


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
                "normal": [{"tracking": where[frame], "band": 0}],
                "depth_mm": [{"tracking": where[frame]}],
                "reflectance": [{"tracking": k}],
                "shading": [{"tracking": k}],
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
        camera = {name: items["camera"][name] for name in ("size_px", "K", "distortion", "world_to_camera")}
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


def _prepare(
    *,
    bands_nm: Sequence[float],
    widths_nm: Sequence[float | None],
    illuminant: str,
    colour: str,
    shape: Sequence[int],
    camera: Mapping[str, Any] | None,
) -> Mapping[str, Any]:
    if colour == "colour":
        matrix = linear_srgb_matrix(bands_nm, widths_nm, illuminant=illuminant)
    else:
        matrix = xyz_matrix(bands_nm, widths_nm, illuminant=illuminant)[1:2]
    lens = None if camera is None else Pinhole.of(camera, (int(shape[0]), int(shape[1])))
    return {"matrix": matrix.tolist(), "camera": lens}


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
    prepare=_prepare,
    prepared=("matrix", "camera"),
    kernel=stimulus,
)
