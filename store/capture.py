"""The capture folder, as it comes off a rig: `capture.yaml` beside pictures.

`read_capture` checks the whole description at once; `PictureFile` says for every picture that the
description promises which file holds it and what it must look like.
"""

import io
import math
import os
import re
import string
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from lightstage.hw import illuminations
from lightstage.hw.cameras import reference_camera
from lightstage.store import document
from lightstage.store.errors import RequestError, raise_all
from lightstage.store.names import NAME_RULE, SESSION_NAME
from lightstage.store.picture import EXTENSIONS, PictureError, declared, decode, linear_from_srgb

if TYPE_CHECKING:
    from lightstage.store.picture import Picture

Polarisation = Literal["parallel", "cross", "unpolarised"]
POLARISATIONS: tuple[Polarisation, ...] = ("parallel", "cross", "unpolarised")


def _iso_date(text: str) -> str:
    try:
        datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"'{text}' is no date; expected ISO 8601, such as 2010-03-12T14:05:00") from None
    return text


Date = Annotated[str, AfterValidator(_iso_date)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, defer_build=True)


class Mount(_Part):
    """How a camera is mounted; undone by rotating clockwise, then mirroring left to right."""

    rotate: Literal[0, 90, 180, 270] = Field(0, description="degrees clockwise")
    mirror: bool = Field(False, description="left to right, after the rotation")


class Frame(_Part):
    """One exposure: every camera and band under one illumination."""

    illumination: str = Field(description="C, X, Y, Z, Xc, Yc, Zc, L and a light number, T0 to T3, or O")
    time_s: float | None = Field(None, description="seconds since the capture began")
    file: str | None = Field(None, description="the picture, when the template does not name it")
    exposure_s: float | None = Field(None, gt=0, description="seconds; for linearity, darks and bands")
    polariser_deg: float | None = Field(None, description="angle of the light's polariser, degrees")
    part: int = Field(0, ge=0, description="place of the target, when it was moved between exposures")

    @model_validator(mode="after")
    def _known(self) -> "Frame":
        if not illuminations.is_known(self.illumination):
            raise ValueError(
                f"the illumination '{self.illumination}' is not known; expected C, X, Y, Z, Xc, Yc, Zc, "
                "L with a light number, T0 to T3, or O"
            )
        return self


class MirrorBall(_Part):
    """A chrome ball."""

    kind: Literal["mirror_ball"]
    radius_mm: float | None = Field(None, gt=0)
    material: Literal["metal", "dielectric"] | None = Field(None, description="a polariser ball is dielectric")


class Checkerboard(_Part):
    """A board of squares."""

    kind: Literal["checkerboard"]
    inner_corners: tuple[int, int] = Field(description="columns, rows")
    square_mm: float = Field(gt=0)


class Plain(_Part):
    """Nothing, or something uniform."""

    kind: Literal["dark", "flat", "white"]
    reflectance: float | tuple[float, ...] | None = Field(None, description="of a white or grey target, or by band")


Target = Annotated[MirrorBall | Checkerboard | Plain, Field(discriminator="kind")]


class CaptureFile(_Part):
    """`capture.yaml`."""

    format: Literal["lightstage-capture/1"] = Field(description="lightstage-capture/1")
    session: str = Field(description="the session's name")
    rig: str | None = Field(None, description="which rig")
    captured: Date | None = Field(None, description="date and time, ISO 8601")
    bits: int = Field(ge=1, le=16, description="significant bits in the integer pictures")
    frame_rate_hz: float | None = Field(None, gt=0, description="null for a static capture")
    cameras: dict[Polarisation, str] = Field(description="polarisation: camera")
    mount: dict[str, Mount] = Field(default_factory=dict, description="camera: rotate, mirror")
    bands_nm: tuple[float, ...] = Field(min_length=1, description="band centres; [0] for unfiltered light")
    files: str | None = Field(None, description="template of the pictures' names")
    frames: tuple[Frame, ...] = Field(min_length=1, description="the exposures in capture order")
    calibration: str | None = Field(None, description="folder of the items that came with the capture")
    mask: str | None = Field(None, description="picture that is non-zero where the subject is")
    target: Target | None = Field(None, description="the calibration target in the picture")
    encoding: Literal["linear", "srgb"] = "linear"
    colour: Literal["mono", "rgb"] = "mono"
    intensities: dict[str, float | tuple[float, ...]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _fits_together(self) -> "CaptureFile":
        problems = list(_conflicts(self))
        if problems:
            raise ValueError("\n".join(problems))
        return self

    @property
    def bits_per_file(self) -> int:
        """8 or 16: what the files must have."""
        return 8 if self.bits <= 8 else 16


def _conflicts(capture: CaptureFile) -> Iterator[str]:
    if not SESSION_NAME.fullmatch(capture.session):
        yield f"session: '{document.short(capture.session)}' is no name for a session: {NAME_RULE}"
    if not capture.cameras:
        yield "cameras: name at least one of parallel, cross or unpolarised"
    if "unpolarised" in capture.cameras and len(capture.cameras) > 1:
        yield "cameras: an unpolarised camera stands alone; a second camera is either parallel or cross"
    if len(set(capture.cameras.values())) < len(capture.cameras):
        yield "cameras: one camera cannot have two polarisations"
    if any(band < 0 for band in capture.bands_nm):
        yield "bands_nm: a wavelength is positive, and 0 stands for unfiltered light"
    if len(set(capture.bands_nm)) < len(capture.bands_nm):
        yield "bands_nm: a band stands twice"
    if capture.colour == "rgb" and len(capture.bands_nm) != 3:
        yield f"colour: rgb needs three bands_nm, in R, G, B order; there are {len(capture.bands_nm)}"
    if capture.colour == "rgb" and capture.files and "{band" in capture.files:
        yield "files: with colour: rgb a file holds all bands, so the template has no {band}"
    if capture.encoding == "srgb" and capture.bits not in (8, 16):
        yield f"encoding: srgb is defined for 8 and 16 bits, not {capture.bits}"
    unnamed = [i for i, frame in enumerate(capture.frames) if frame.file is None]
    if capture.files is None and unnamed:
        yield f"files: the template is missing, and frame {unnamed[0]} does not name its own picture"
    for template in {capture.files, *(frame.file for frame in capture.frames)} - {None}:
        yield from _template_problems(str(template))
    for key, place in (("calibration", capture.calibration), ("mask", capture.mask)):
        # a link in the folder may lead out of it, because whoever made it could read what is there; a text may not
        if place is not None and (Path(place).is_absolute() or ".." in Path(place).parts):
            yield f"{key}: '{document.short(place)}' leaves the capture folder"
    present = {frame.illumination for frame in capture.frames}
    for name, value in capture.intensities.items():
        if name not in present:
            yield f"intensities: {name} is no illumination of this capture" + document.nearest(name, present)
        values = value if isinstance(value, tuple) else (value,)
        if isinstance(value, tuple) and len(value) != len(capture.bands_nm):
            yield f"intensities: {name} has {len(value)} numbers for {len(capture.bands_nm)} bands"
        if not all(math.isfinite(v) and v > 0 for v in values):
            yield f"intensities: {name} must be positive"


_PART = re.compile(
    r"\{\{|\}\}|[^{}]+|\{(?P<name>\w*)(?P<rest>[^{}]*)\}|(?P<stray>[{}])",
)
_NUMBER = {"frame": r"0?[0-9]{0,2}d?", "band": r"0?[0-9]{0,2}(d?|(\.[0-9])?[fg])"}
"""What may stand behind the colon: a width of up to two digits, and how a number is written."""
_PARTS = ("frame", "illumination", "band", "camera")


def _template_problems(template: str) -> Iterator[str]:
    """What is wrong with a template. It may hold its four parts and widths, and nothing that asks for more."""
    known = f"known parts are {', '.join(_PARTS)}"
    for part in _PART.finditer(template):
        name, rest = part["name"], part["rest"]
        if part["stray"]:
            yield f"files: '{template}' is not a template (a single '{part['stray']}'); {known}"
        elif name == "" and not rest:
            yield f"files: '{template}' has an empty {{}}; {known}"
        elif name is not None and name not in _PARTS:
            yield f"files: '{template}' has the unknown part {{{name or rest}}}{document.nearest(name, _PARTS)}"
        elif rest and not re.fullmatch(":" + _NUMBER.get(name or "", ""), rest):
            width = f"a width of up to two digits may stand there, as in {{{name}:04d}}"
            allowed = width if name in _NUMBER else f"{{{name}}} stands alone"
            yield f"files: '{template}' has {{{name}{rest}}}; {allowed}"
    if Path(template).is_absolute() or ".." in Path(template).parts:
        yield f"files: '{template}' leaves the capture folder"


LONGEST_NAME = 255
"""Bytes of a file's or a folder's name, on every file system in use."""


def _name_problems(name: str) -> Iterator[str]:
    """What is wrong with a picture's name, its parts filled in."""
    path = Path(name)
    longest = max((len(os.fsencode(part)) for part in path.parts), default=0)
    if longest > LONGEST_NAME:
        shown = f"{name[:40]}...{name[-20:]}"
        yield f"files: '{shown}' has {longest} bytes; a file's name has at most {LONGEST_NAME}"
    elif path.is_absolute() or ".." in path.parts:
        yield f"files: '{name}' leaves the capture folder"


def _band_label(band: float) -> float | int:
    return int(band) if float(band).is_integer() else band


@dataclass(frozen=True)
class PictureFile:
    """One file of a capture: where it is and which planes of `raw` it holds."""

    path: Path
    frame: int
    polarisation: Polarisation
    bands: tuple[int, ...]
    """Indices of the bands that the file holds: one, or all three of a colour file."""


@dataclass(frozen=True)
class Capture:
    """A checked description and the folder it describes."""

    folder: Path
    description: CaptureFile

    @property
    def polarisations(self) -> tuple[Polarisation, ...]:
        """The polarisations present, in the order of the axis in `raw`."""
        return tuple(p for p in POLARISATIONS if p in self.description.cameras)

    @property
    def reference_camera(self) -> str:
        """The camera whose grid everything is brought to: the cross camera, or the only one."""
        return reference_camera({str(name): camera for name, camera in self.description.cameras.items()})

    def pictures(self) -> list[PictureFile]:
        """Every file that the description promises, in capture order.

        Raises:
            RequestError: two pictures would come from one file, or one from a file that cannot be.
        """
        d = self.description
        groups = [tuple(range(3))] if d.colour == "rgb" else [(i,) for i in range(len(d.bands_nm))]
        promised: list[PictureFile] = []
        seen: dict[Path, str] = {}
        problems: list[str] = []
        for i, frame in enumerate(d.frames):
            template = frame.file or d.files or ""
            for bands in groups:
                for polarisation in self.polarisations:
                    label = f"frame {i} ({frame.illumination}), band {d.bands_nm[bands[0]]:g}, {polarisation}"
                    try:
                        name = template.format(
                            frame=i,
                            illumination=frame.illumination,
                            band=_band_label(d.bands_nm[bands[0]]),
                            camera=d.cameras[polarisation],
                        )
                    except ValueError:
                        problems.append(
                            f"files: '{template}' writes bands as whole numbers; {d.bands_nm[bands[0]]:g} is none"
                        )
                        continue
                    problems += [f"{problem}, for {label}" for problem in _name_problems(name)]
                    path = self.folder / name
                    if path in seen:
                        problems.append(f"{path} would be both {seen[path]} and {label}")
                    seen[path] = label
                    promised.append(PictureFile(path, i, polarisation, bands))
        raise_all(problems[:5])
        return promised

    def extra_pictures(self) -> list[Path]:
        """Pictures in the folder that the description does not mention."""
        known = {picture.path for picture in self.pictures()}
        if self.description.mask:
            known.add(self.folder / self.description.mask)
        try:
            return sorted(
                path
                for path in self.folder.iterdir()
                if path.suffix.lower() in EXTENSIONS and path not in known and path.is_file()
            )
        except OSError as error:
            raise RequestError(f"{self.folder} cannot be listed ({error.strerror})") from None

    def planes(self, data: bytes) -> "Picture":
        """Decode one of the capture's files into (bands of the file, y, x), uint16, linear.

        Raises:
            PictureError: it is not the kind of picture that the description declares.
        """
        import numpy as np

        d = self.description
        wanted = 3 if d.colour == "rgb" else 1
        channels = declared(io.BytesIO(data)).channels
        picture = decode(data) if channels == wanted else None
        if picture is not None:
            channels = 1 if picture.ndim == 2 else picture.shape[2]
        if picture is None or channels != wanted:
            raise PictureError(f"has {channels} channel(s); colour: {d.colour} means {wanted}")
        depth = picture.dtype.itemsize * 8
        if depth < d.bits_per_file:
            raise PictureError(f"has {depth} bits a value; bits: {d.bits} needs a 16-bit file")
        top = int(picture.max(initial=0))
        if top >= 1 << d.bits:
            raise PictureError(f"holds the value {top}, more than bits: {d.bits} can ({(1 << d.bits) - 1})")
        if d.encoding == "srgb":
            picture = linear_from_srgb(picture)
        planes = picture[None] if picture.ndim == 2 else np.moveaxis(picture, 2, 0)
        return np.ascontiguousarray(planes, dtype=np.uint16)


def read_captures(folders: Sequence[Path]) -> Capture:
    """Several captures of one kind as one: their frames one after the other, `part` counted on.

    Raises:
        RequestError: one is wrong, or they differ in what a session has one of.
    """
    captures = [read_capture(folder) for folder in folders]
    first = captures[0]
    if len(captures) == 1:
        return first
    problems = [
        f"{other.folder}: its {key} is not that of {first.folder}; captures measured together must agree in it"
        for other in captures[1:]
        for key in ("bits", "cameras", "mount", "bands_nm", "encoding", "colour", "rig", "target")
        if getattr(other.description, key) != getattr(first.description, key)
    ]
    raise_all(problems)
    root = Path(os.path.commonpath([capture.folder for capture in captures]))
    frames: list[Frame] = []
    parts = 0
    for capture in captures:
        d = capture.description
        inside = _as_text(capture.folder.relative_to(root).as_posix())
        for i, frame in enumerate(d.frames):
            name = _with_band_and_camera(frame.file or d.files or "", frame=i, illumination=frame.illumination)
            frames.append(frame.model_copy(update={"file": f"{inside}/{name}", "part": parts + frame.part}))
        parts = 1 + max(frame.part for frame in frames)
    items = next((c for c in captures if c.description.calibration is not None), first)
    calibration = items.description.calibration
    if calibration is not None:
        calibration = (items.folder / calibration).relative_to(root).as_posix()
    together = first.description.model_copy(
        update={
            "session": ".".join(dict.fromkeys(capture.description.session for capture in captures))[:100],
            "files": None,
            "frames": tuple(frames),
            "calibration": calibration,
            "mask": None,
        }
    )
    return Capture(root, together)


def _as_text(text: str) -> str:
    """A text as it stands in a template."""
    return text.replace("{", "{{").replace("}", "}}")


def _with_band_and_camera(template: str, **known: Any) -> str:
    """A template with the parts that are known filled in, and the others left."""
    out = []
    for text, name, spec, _ in string.Formatter().parse(template):
        out.append(_as_text(text))
        if name in known:
            out.append(format(known[name], spec or ""))
        elif name is not None:
            out.append("{" + name + (":" + spec if spec else "") + "}")
    return "".join(out)


def read_capture(folder: Path) -> Capture:
    """Read and check a capture folder's description (not its pictures).

    Raises:
        RequestError: it is missing or wrong; every problem is listed.
    """
    folder = Path(os.path.expanduser(folder))  # unlike Path.expanduser it leaves ~nobody as it is
    if not folder.is_dir():
        raise RequestError(f"{folder} is not a folder; expected a capture folder with capture.yaml in it")
    source = document.load(folder / "capture.yaml", what="the description of the capture")
    description = document.check(source, CaptureFile)
    return Capture(folder.resolve(), description)
