"""A result's arrays as pictures, for tools that do not read zarr: PNG, EXR or NPY.

Normals are maps; the convention says where green points: OpenGL up, DirectX down. 8 bits are for looking; EXR holds
float channels, with convention, frame and units in its header.
"""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.formats.exr import DATA, write_exr
from lightstage.formats.png import encode_png
from lightstage.products import names
from lightstage.products.choices import CONVENTIONS, FRAME
from lightstage.products.counts import shown_8, shown_16

_INNER = ("xyz", "y", "x")
_FULL_SCALE = 99.9
"""The percentile of an array that is white in the integer formats."""


@dataclass(frozen=True)
class Plane:
    """One picture of a result; its values are read when they are asked for."""

    name: str
    """File name without extension."""
    kind: str
    """normal, mask or scalar."""
    picture: Any
    """The xarray.DataArray."""
    attrs: Mapping[str, Any]
    full_scale: float
    """What white is in the integer formats, the same for all pictures of an array."""

    @property
    def values(self) -> NDArray[Any]:
        """(y, x, xyz) for normals, (y, x) otherwise."""
        if self.kind == "normal":
            return np.asarray(self.picture.transpose("y", "x", "xyz").values.astype(np.float32))
        return np.asarray(self.picture.transpose("y", "x").values)


def plane_names(dataset: Any) -> list[str]:
    """The names of a dataset's pictures, without extension; nothing is read."""
    return [
        names.plane(str(name), labels)
        for name, array in dataset.data_vars.items()
        for _, labels in _places(dataset, array)
    ]


def planes(dataset: Any) -> Iterator[Plane]:
    """Every picture of a dataset."""
    for name, array in dataset.data_vars.items():
        normal = "xyz" in array.dims
        kind = "normal" if normal else "mask" if array.dtype == bool else "scalar"
        scale = _scale(array) if kind == "scalar" else 1.0
        units = {"units": array.attrs.get("units", "")}
        for place, labels in _places(dataset, array):
            yield Plane(names.plane(str(name), labels), kind, array.isel(place), units, scale)


def _places(dataset: Any, array: Any) -> Iterator[tuple[dict[str, int], list[str]]]:
    outer = [dim for dim in array.dims if dim not in _INNER]
    for index in itertools.product(*(range(array.sizes[dim]) for dim in outer)):
        place = dict(zip(outer, index, strict=True))
        yield place, [_label(dataset, dim, i) for dim, i in place.items()]


def _label(dataset: Any, dim: str, index: int) -> str:
    if dim == "frame" and "illumination" in dataset.coords:
        return names.frame(index, dataset.coords["illumination"].values[index])
    if dim in dataset.coords:
        value = dataset.coords[dim].values[index]
        return names.band(value) if dim == "band" else names.tracking(value) if dim == "tracking" else str(value)
    return f"{dim}{index}"


def _scale(array: Any) -> float:
    sample = array.values[..., ::4, ::4].astype(np.float32)
    sample = sample[np.isfinite(sample)]
    top = float(np.percentile(sample, _FULL_SCALE)) if sample.size else 1.0
    return top if top > 0 else 1.0


def suffix(form: str) -> str:
    """Of the files of a format of `choices.PLANE_FORMATS`: png8 and png16 are png."""
    return form.rstrip("0123456789")


def write_plane(folder: Path, plane: Plane, *, form: str, convention: str, attrs: Mapping[str, Any]) -> str:
    """Write a picture; returns the file's name.

    Args:
        folder: is there.
        plane: the picture.
        form: one of `choices.PLANE_FORMATS`.
        convention: where green points, of `choices.CONVENTIONS`.
        attrs: of the result; text and numbers go into the header of an EXR.

    Raises:
        OSError: it cannot be written.
    """
    values = plane.values
    if plane.kind == "normal" and convention == "directx":
        values = values * np.array([1, -1, 1], values.dtype)
    file = folder / f"{plane.name}.{suffix(form)}"
    if form == "npy":
        np.save(file, values)
    elif form == "exr":
        header = {
            **{k: v for k, v in attrs.items() if isinstance(v, str | int | float)},
            **plane.attrs,
            "frame": FRAME,
            "convention": CONVENTIONS[convention] if plane.kind == "normal" else "linear",
        }
        texts = {name: str(value) for name, value in header.items() if value != ""}
        write_exr(file, _channels(plane.kind, values), colour=DATA, **texts)
    else:
        file.write_bytes(encode_png(_counts(plane, values, form)))
    return file.name


def _counts(plane: Plane, values: NDArray[Any], form: str) -> NDArray[Any]:
    """Normals as (n + 1) / 2, scalars from 0 to the array's full scale; black where not valid."""
    if plane.kind == "normal":
        unit = (values + 1) / 2
    elif plane.kind == "mask":
        unit = values.astype(np.float32)
    else:
        unit = values / plane.full_scale
    return shown_16(unit) if form == "png16" else shown_8(unit)


def _channels(kind: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Channels of an EXR: normal.X, normal.Y, normal.Z, or Y; NaN where not valid."""
    if kind == "normal":
        return {f"normal.{axis}": values[..., i] for i, axis in enumerate("XYZ")}
    return {"Y": values}
