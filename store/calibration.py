"""What the file of a calibration item says, kind by kind: read, and checked before anything is kept.

An item is a small YAML file and the pictures it names; `items` keeps it in the store.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from lightstage.store import document
from lightstage.store.capture import Date
from lightstage.store.chunks import Chunks
from lightstage.store.errors import RequestError
from lightstage.store.intake import FileError, read_regular
from lightstage.store.items import Item, StoredPicture, item_digest
from lightstage.store.picture import LARGEST_FILE, PictureError, decode

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
_TINY, _HUGE = 1e-9, 1e9
"""Of what is divided by, or multiplied with itself: neither leaves the range of a number."""
Positive = Annotated[float, Field(ge=_TINY, le=_HUGE)]
_MOST_PX = 65536
_UNIT = 1e-3
"""How far a measured rotation's rows, or a direction's length, may be from 1."""
_SAME_DIRECTION = 1e-4
"""Lights that are this near to each other, as unit vectors, are one light."""
_BRIGHTEST_DARK = 0.9
"""Of the most that its file can hold: what is dark at all is far below."""
NOTES = ("rig", "valid_from", "measured_from", "residuals")
"""Said of an item, but no part of its value."""


class _Item(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    rig: str | None = Field(None, description="the rig that this was measured on")
    valid_from: Date | None = Field(None, description="date from which it holds, ISO 8601")
    measured_from: str | None = Field(None, description="the session it was measured from")
    residuals: Any = Field(None, description="how well it fits")


class Pose(_Item):
    """World to camera: X_camera = R X_world + t."""

    R: Matrix
    t_mm: Vector = Field(description="of the world's origin, the stage's centre, in the camera frame")

    @model_validator(mode="after")
    def _possible(self) -> "Pose":
        import numpy as np

        turn, distance = np.asarray(self.R), self.t_mm[2]
        # lengths first: what is no rotation may be of any size
        if np.abs(turn).max() > 2 or np.abs(turn @ turn.T - np.eye(3)).max() > _UNIT or np.linalg.det(turn) < 0:
            raise ValueError(f"R is no rotation: {_why_no_rotation(turn)}")
        if not 0 < distance <= _HUGE:
            raise ValueError(
                f"t_mm puts the stage's centre at z = {distance:g} mm of the camera frame, whose z points forward; "
                "the subject must lie before the camera, at a z above 0"
            )
        return self


def _why_no_rotation(matrix: "NDArray[np.float64]") -> str:
    import numpy as np

    lengths = np.sqrt((np.clip(matrix, -_HUGE, _HUGE) ** 2).sum(axis=1))
    if np.abs(lengths - 1).max() > _UNIT:
        return f"its rows have the lengths {', '.join(f'{length:.4g}' for length in lengths)}; each must be 1"
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > _UNIT:
        return "its rows do not stand at right angles"
    return "it mirrors (its determinant is -1)"


Size = Annotated[int, Field(ge=1, le=_MOST_PX)]
Distortion = Annotated[float, Field(ge=-1e6, le=1e6)]


class CameraItem(_Item):
    """The reference camera."""

    item: Literal["camera"]
    size_px: tuple[Size, Size] = Field(description="width, height")
    K: Matrix = Field(description="intrinsic matrix, pixels")
    distortion: tuple[Distortion, Distortion, Distortion, Distortion, Distortion] = Field(
        (0.0,) * 5, description="k1 k2 p1 p2 k3"
    )
    world_to_camera: Pose

    @model_validator(mode="after")
    def _intrinsic(self) -> "CameraItem":
        (fx, skew, cx), (below, fy, cy), last = self.K
        if last != (0, 0, 1) or below != 0:
            raise ValueError("K: the form is [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]")
        if not all(1 <= focal <= _HUGE for focal in (fx, fy)):
            raise ValueError(f"K: the focal lengths {fx:g} and {fy:g} must be pixels, 1 or more")
        if max(abs(skew), abs(cx), abs(cy)) > _HUGE:
            raise ValueError(f"K: skew and centre ({skew:g}, {cx:g}, {cy:g}) must be pixels")
        return self


class HomographyItem(_Item):
    """(x, y, 1) in one camera, mount undone, to (x', y', 1) in the other."""

    item: Literal["homography"]
    source: str = Field(alias="from", description="camera")
    to: str = Field(description="camera")
    matrix: Matrix

    @model_validator(mode="after")
    def _invertible(self) -> "HomographyItem":
        import numpy as np

        matrix = np.asarray(self.matrix)
        scale = np.abs(matrix).max()
        if scale == 0 or abs(np.linalg.det(matrix / scale)) < 1e-12:
            raise ValueError("the matrix cannot be inverted")
        return self


class Light(_Item):
    """One LED."""

    id: str
    channel: int | None = None
    position_mm: Vector | None = Field(None, description="where it is, world frame")
    direction: Vector | None = Field(None, description="towards a distant light, world frame")
    drive_position: Vector | None = Field(None, description="unit vector that its weights were made from")
    power: Positive = 1.0
    seen: bool = Field(True, description="false: placed by symmetry")

    @model_validator(mode="after")
    def _one_place(self) -> "Light":
        if (self.position_mm is None) == (self.direction is None):
            raise ValueError(f"light {self.id} needs either position_mm or direction")
        place = self.position_mm or self.direction
        if place is not None and not _TINY <= math.hypot(*place) <= _HUGE:
            where = "is at the origin, so it" if not any(place) else f"at {', '.join(f'{x:g}' for x in place)}"
            raise ValueError(f"light {self.id} {where} has no direction")
        if self.drive_position is not None and abs(math.hypot(*self.drive_position) - 1) > 10 * _UNIT:
            length = math.hypot(*self.drive_position)
            raise ValueError(f"light {self.id}: drive_position is {length:g} long; it must be a unit vector")
        return self

    @property
    def towards(self) -> Vector:
        """The unit vector from the stage's centre."""
        x, y, z = self.position_mm or self.direction or (0.0, 0.0, 0.0)
        length = math.hypot(x, y, z)
        return (x / length, y / length, z / length)


class LightsItem(_Item):
    """Where the lights are."""

    item: Literal["lights"]
    drive: Literal["ideal", "measured"] = Field("ideal", description="where the weights came from")
    lights: tuple[Light, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _each_once(self) -> "LightsItem":
        names = Counter(light.id for light in self.lights)
        twice = sorted(name for name, count in names.items() if count > 1)
        if twice:
            raise ValueError(f"light {twice[0]} stands twice")
        first = self.lights[0].towards
        if len(names) > 1 and all(math.dist(light.towards, first) < _SAME_DIRECTION for light in self.lights):
            raise ValueError(
                f"all {len(names)} lights lie in one direction from the stage's centre, and differ in nothing that "
                "a picture could show"
            )
        return self


class DarkItem(_Item):
    """What each camera records without light, sensor orientation."""

    item: Literal["dark"]
    images: dict[str, str] = Field(min_length=1, description="camera: picture")
    exposure_s: Positive | None = Field(None, description="that it was taken with")
    hot_px: dict[str, tuple[tuple[int, int], ...]] | None = Field(None, description="camera: x, y of hot pixels")
    scale: Positive = Field(1.0, description="stored value = counts x scale")


class FlatItem(_Item):
    """What each camera records of one uniform target, sensor orientation."""

    item: Literal["flat"]
    images: dict[str, str] = Field(min_length=1, description="camera: picture")
    scale: Positive = Field(1.0, description="stored value = counts x scale")
    dark_included: bool = Field(False, description="true if the dark is still in it")
    dead_px: dict[str, tuple[tuple[int, int], ...]] | None = Field(None, description="camera: x, y, filled in here")


class Band(_Item):
    """One filter: counts = exposure x transmission x source x radiance."""

    centre_nm: float = Field(ge=0, le=1e5, description="0 for unfiltered light")
    width_nm: float | None = Field(None, gt=0, le=1e5, description="null: broadband")
    exposure: Positive
    transmission: Positive = 1.0
    source: Positive = 1.0
    curve: tuple[tuple[float, float], ...] | None = Field(None, description="nm, transmission")

    @model_validator(mode="after")
    def _passes_light(self) -> "Band":
        if self.curve is not None:
            wrong = [(nm, value) for nm, value in self.curve if not (0 <= nm <= 1e5 and 0 <= value <= _HUGE)]
            if wrong:
                raise ValueError(f"curve: {wrong[0][0]:g} nm passes {wrong[0][1]:g}; neither can be negative")
            if not any(value > 0 for _, value in self.curve):
                raise ValueError("curve: no wavelength passes, so this band sees nothing")
        return self


class BandsItem(_Item):
    """The filter wheel."""

    item: Literal["bands"]
    bands: tuple[Band, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _each_once(self) -> "BandsItem":
        counts = Counter(band.centre_nm for band in self.bands)
        twice = sorted(centre for centre, count in counts.items() if count > 1)
        if twice:
            raise ValueError(f"the band {twice[0]:g} nm stands twice")
        return self


class LightPolariser(_Item):
    """One light's polariser."""

    id: str
    angle_deg: float = Field(ge=0, lt=180, description="setting for the least cross-polarised highlight")
    residual: float = Field(ge=0, le=_HUGE, description="what then remains, of the most that any setting gives")


class PolarisersItem(_Item):
    """How the lights' polarisers are turned."""

    item: Literal["polarisers"]
    lights: tuple[LightPolariser, ...] = Field(min_length=1)


KINDS: Mapping[str, type[_Item]] = {
    "camera": CameraItem,
    "homography": HomographyItem,
    "lights": LightsItem,
    "dark": DarkItem,
    "flat": FlatItem,
    "bands": BandsItem,
    "polarisers": PolarisersItem,
}


def read_item(path: Path, chunks: Chunks, *, kind: str | None = None) -> tuple[Item, bytes]:
    """Read and check an item file; its pictures go into the store as chunks. Returns it with the file's bytes.

    Raises:
        RequestError: the file or a picture is missing or wrong, or the item is of another kind than asked for.
    """
    source = document.load(path, what=f"a calibration item ({kind or ', '.join(KINDS)})")
    stated = source.value.get("item") if isinstance(source.value, dict) else None
    if stated is None:
        raise RequestError(
            f"{source.at(())}: 'item' is missing; an item file begins with one of {', '.join(KINDS)}"
        )
    if not isinstance(stated, str) or stated not in KINDS:
        hint = document.nearest(str(stated), KINDS)
        raise RequestError(f"{source.at(('item',))}: the item '{stated}' is not known{hint}")
    if kind is not None and stated != kind:
        raise RequestError(f"{source.at(('item',))}: this is a {stated} item, where {kind} was asked for")
    model = document.check(source, KINDS[stated])
    values = model.model_dump(mode="json", by_alias=True)
    notes = {name: values.pop(name) for name in NOTES if values.get(name) is not None}
    values = _without_notes(values)
    pictures: dict[str, StoredPicture] = {}
    problems = [f"{source.at(where)}: {text}" for where, text in _strangers(model)]
    for camera, name in dict(values.pop("images", {})).items():
        file = path.parent / name
        try:
            pixels = decode(read_regular(file, LARGEST_FILE))
            if pixels.ndim != 2:
                raise PictureError(f"has {pixels.shape[2]} channels; one is expected")
        except FileError as error:
            problems.append(f"{source.at(('images', camera))}: {file} {error}")
            continue
        problems += [f"{source.at(where)}: {text}" for where, text in _implausible(model, camera, pixels)]
        pictures[camera] = StoredPicture(chunks.put(pixels), pixels.dtype.str, pixels.shape)
    if problems:
        raise RequestError("\n".join(problems))
    item = Item(stated, item_digest(values, pictures), values, notes, pictures)
    return item, source.text.encode()


def _implausible(model: _Item, camera: str, pixels: "NDArray[Any]") -> Iterator[tuple[document.Where, str]]:
    """What one of an item's pictures cannot be, and where the file says it."""
    import numpy as np

    height, width = pixels.shape
    for key in ("hot_px", "dead_px"):
        for i, (x, y) in enumerate((getattr(model, key, None) or {}).get(camera, ())):
            if not (0 <= x < width and 0 <= y < height):
                yield (key, camera, i), f"{key}: ({x}, {y}) is outside the picture of {width} x {height}"
    most = np.iinfo(pixels.dtype).max
    if isinstance(model, DarkItem) and np.median(pixels) >= _BRIGHTEST_DARK * most:
        yield (
            ("images", camera),
            f"{model.images[camera]} is bright ({np.median(pixels):g} of {most}), which no dark is",
        )


def _strangers(model: _Item) -> Iterator[tuple[document.Where, str]]:
    """Pixels of cameras that an item has no picture of."""
    for key in ("hot_px", "dead_px"):
        for camera in getattr(model, key, None) or {}:
            if camera not in getattr(model, "images", {}):
                known = document.nearest(camera, getattr(model, "images", {}))
                yield (key, camera), f"{key}: there is no picture of {camera}{known}"


def _without_notes(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_notes(v) for k, v in value.items() if not (k in NOTES and v is None)}
    if isinstance(value, list | tuple):
        return [_without_notes(v) for v in value]
    return value


def items_in(folder: Path, chunks: Chunks) -> tuple[dict[str, tuple[Item, bytes]], list[str]]:
    """The items of a capture's calibration folder by kind, and what was passed over.

    Raises:
        RequestError: an item is wrong, or two are of one kind; every problem is listed.
    """
    if not folder.is_dir():
        raise RequestError(f"{folder} is missing: capture.yaml names it as the folder of calibration items")
    items: dict[str, tuple[Item, bytes]] = {}
    warnings: list[str] = []
    problems: list[str] = []
    for path in sorted([*folder.glob("*.yaml"), *folder.glob("*.yml")]):
        try:
            kind = document.load(path, what="a calibration item").value
            kind = kind.get("item") if isinstance(kind, dict) else None
            if (
                isinstance(kind, str)
                and kind not in KINDS
                and not document.nearest(kind, KINDS).startswith("; did")
            ):
                warnings.append(f"{path}: no stage reads a '{kind}' item; passed over")
                continue
            item, original = read_item(path, chunks)
        except RequestError as error:
            problems.append(str(error))
            continue
        if item.kind in items:
            problems.append(f"{path} is a second {item.kind} item in this folder; keep one")
        items[item.kind] = (item, original)
    if problems:
        raise RequestError("\n".join(problems))
    return items, warnings
