"""Normals of one tracking frame by any method; the methods themselves lie beside this file.

Sources: Ma et al. (2007), Wilson et al. (2010), Dutta (2010) chapter 4, Woodham (1980).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.normals import one_light, quantised, rig_normals, spherical_gradients
from lightstage.kernels.normals.gradient_methods import table
from lightstage.kernels.normals.normal_filter import non_local_means
from lightstage.kernels.pictures.band_fusion import fuse as fuse_bands
from lightstage.kernels.pictures.picture_sets import Choice

Image = NDArray[np.float32]


def normals(
    radiance: Mapping[tuple[float, str], Image],
    constant: Mapping[float, Image],
    *,
    choice: Choice,
    lights: NDArray[np.float64] | None,
    view: Image | None,
    rig: rig_normals.Scene | None = None,
    correct: str = "none",
    fuse: str = "none",
    filter: str = "none",
    openness: str = "measured",
) -> Mapping[str, Any]:
    """Normals of one tracking frame.

    Args:
        radiance: pictures (y, x) by band (nm) and illumination, those of `choice`; NaN where not valid.
        constant: by band, the diffuse component's picture under constant light, where the albedo is read from it
            instead of being the method's own r_c; else empty.
        choice: the method.
        lights: (light, xyz) in the order of the choice's pictures, for least_squares.
        view: (xyz, y, x) unit vectors to the camera, for specular pictures.
        rig: what the corrections that model the rig's lights need; None for the others.
        correct: none, qp, or such a model.
        fuse: with a model, whether all bands give one map (bands) or one each (none).
        filter: none, nlm or surface.
        openness: with a model, measured or modelled.

    Returns:
        `normal` (xyz, y, x) int16 in steps of 1 / NORMAL_STEPS; `albedo` and `norm` (y, x) float32, NaN where not
        valid; `valid` (y, x). With a model all have a leading band, and `depth_mm`, `irradiance` (y, x) and
        `visibility` (light, y, x) come with them as far as the model has them.
    """
    names = choice.pictures
    bands = list(dict.fromkeys(band for band, _ in radiance))
    if rig is not None:
        by_band = [{name: radiance[band, name] for name in names} for band in bands]
        return rig_normals.solve(
            by_band, rig, model=correct, as_one=fuse == "bands", filtered=filter, openness=openness
        )
    pictures: Sequence[Image] = _Ordered(radiance, [(bands[0], name) for name in names])
    if len(bands) > 1:
        pictures = fuse_bands([[radiance[band, name] for name in names] for band in bands], names)
    if choice.method == "least_squares":
        assert lights is not None
        result = one_light.solve(pictures, lights)
    else:
        method = table(choice.method, choice.base, names, qp=correct == "qp")
        result = spherical_gradients.solve(
            [pictures[names.index(name)] for name in method.pictures], method, view=view
        )
    albedo = result.constant
    if constant:
        lit = list(constant.values())
        albedo = fuse_bands([[picture] for picture in lit], ["C"])[0] if len(bands) > 1 else lit[0]
        albedo = np.where(result.valid, albedo, np.float32(np.nan))
    normal = result.normal
    if filter == "nlm":
        unit = quantised.decode(normal).transpose(1, 2, 0)
        smooth = non_local_means(unit, 1 / np.sqrt(np.maximum(albedo, 1e-12)), result.valid)
        normal = quantised.encode(smooth.transpose(2, 0, 1))
    return {"normal": normal, "albedo": albedo, "norm": result.norm, "valid": result.valid}


class _Ordered(Sequence[Image]):
    """Pictures in an order, still read one at a time."""

    def __init__(self, pictures: Mapping[tuple[float, str], Image], names: Sequence[tuple[float, str]]) -> None:
        self._pictures, self._names = pictures, names

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, index: Any) -> Any:
        return self._pictures[self._names[index]]


def prepare(
    *,
    choice: Sequence[Any],
    specular: bool,
    shape: Sequence[int],
    camera: Mapping[str, Any] | None,
    lights: Mapping[str, Any] | None,
    rig: Mapping[str, Any] | None,
    correct: str,
) -> Mapping[str, Any]:
    view = known = None
    if rig is not None:
        known = rig_normals.prepared(rig, (int(shape[0]), int(shape[1])))
    if specular:
        size = (int(shape[0]), int(shape[1]))
        view = np.zeros((3, *size), np.float32)
        view[2] = 1
        if camera is not None:
            view = view_vectors(camera, size)
    return {
        "choice": Choice(choice[0], choice[1], tuple(choice[2])),
        "lights": None if lights is None else light_directions(lights, choice[2]),
        "view": view,
        "rig": known,
        "correct": correct,
    }


def view_vectors(camera: Mapping[str, Any], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Unit vectors from the seen points to the camera, world frame, (xyz, y, x).

    A point's distance does not matter: every point of a pixel's ray sees the camera in the same direction.

    Raises:
        KernelError: the camera item is of another picture size.
    """
    width, height = camera["size_px"]
    if (height, width) != tuple(shape):
        raise KernelError(f"the camera item is for {width} x {height}; the pictures are {shape[1]} x {shape[0]}")
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    matrix, distortion = np.asarray(camera["K"], float), np.asarray(camera["distortion"], float)
    points = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(points, matrix, distortion).reshape(height, width, 2)
    rays = np.concatenate([rays, np.ones((height, width, 1))], axis=2)
    rotation = np.asarray(camera["world_to_camera"]["R"], float)
    world = -rays @ rotation  # R^T applied to each ray, turned round
    world /= np.linalg.norm(world, axis=2, keepdims=True)
    return np.ascontiguousarray(np.moveaxis(world, 2, 0), dtype=np.float32)


def light_directions(item: Mapping[str, Any], names: Sequence[str]) -> NDArray[np.float64]:
    """Directions times strength at the stage's centre, (light, xyz), for illuminations L00, L01, ...

    A light with a position falls off with its squared distance, relative to the mean of all.

    Raises:
        KernelError: a light is not in the item, or all lie in one plane with the centre.
    """
    by_number = {_number(light["id"]): light for light in item["lights"]}
    missing = [name for name in names if _number(name) not in by_number]
    if missing:
        raise KernelError(f"the lights item has no {', '.join(missing)} (it has {len(by_number)} lights)")
    distances = [np.linalg.norm(x["position_mm"]) for x in item["lights"] if x["position_mm"] is not None]
    usual = float(np.mean(distances)) if distances else 1.0
    rows = []
    for name in names:
        light = by_number[_number(name)]
        place = np.asarray(light["position_mm"] if light["position_mm"] is not None else light["direction"], float)
        length = float(np.linalg.norm(place))
        fall_off = (usual / length) ** 2 if light["position_mm"] is not None else 1.0
        rows.append(place / length * light["power"] * fall_off)
    lights = np.stack(rows)
    if np.linalg.matrix_rank(lights, tol=1e-3) < 3:
        raise KernelError("the lights lie in one plane; least_squares needs three that do not")
    return lights


def _number(name: str) -> int | str:
    digits = name.removeprefix("L")
    return int(digits) if digits.isdigit() else name
