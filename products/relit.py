"""A captured subject under other lights, as pictures, with a table, a sheet and, of an environment, a film.

Where the session has a picture of its own under a light that is asked for, the two are compared.

Light is worked out in linear Rec. 709, with the gloss where it was measured, cast shadows, and light bounced once
(`kernels/appearance/relighting.py`).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from lightstage.formats.exr import COLOUR, rgb, write_exr
from lightstage.formats.png import encode_png
from lightstage.formats.tables import csv_of_rows
from lightstage.formats.video import even, write_film
from lightstage.kernels.appearance.colour import linear_srgb_matrix
from lightstage.kernels.appearance.relighting import Surface, compare, relight
from lightstage.products import names
from lightstage.products.choices import FRAME
from lightstage.products.counts import LUMINANCE, WHITE_16, srgb_8, srgb_16
from lightstage.products.figures import font
from lightstage.products.light_setups import Setup, turned
from lightstage.products.material import Entry, Material
from lightstage.products.mesh import filled
from lightstage.products.progress import Progress, silent

Array = NDArray[np.float64]
FORMAT = "lightstage-relight/1"
_BRIGHT, _SHOWN = 99.5, 0.9
"""The exposure where none is given: this percentile of the brightest picture shows as so much of white."""
_FPS = 12.0
_INDEX = 1.5
"""Refractive, where none was measured: there is no gloss then, and it decides nothing."""
_THUMB_PX, _GAP, _TITLE = 320, 8, 24
_WIDER = 1.3
"""A sheet has so many more columns than rows."""


class Row(NamedTuple):
    """What the table says of a picture."""

    picture: str
    lights: str
    exposure: float
    median: float
    """Of the subject's linear luminance."""
    bright: float
    """Its 99.5th percentile."""
    clipped: float
    """Share of the subject where a channel of the PNG is at its end."""
    psnr_db: float | None = None
    """Against the session's own picture under that light, in luminance; None where it has none."""
    ssim: float | None = None


def document(material: Material) -> dict[str, Any]:
    """What the record says of all files."""
    return {
        "format": FORMAT,
        "session": material.session,
        "tracking": material.tracking,
        "frame": FRAME,
        "unit": "1 is a white surface that faces a light of strength 1",
        "gloss": "as measured"
        if material.gloss is not None
        else "none: the capture lacks one of the polarisations",
        "results": dict(material.recipes),
    }


def surface_of(material: Material) -> Surface:
    """What is lit. Colours outside Rec. 709 come to its border, and holes in the gloss take what is nearest."""
    known, gloss = material.known, material.gloss
    albedo = np.where(known[..., None], np.maximum(material.colour, 0), np.nan)
    specular = alpha = None
    if gloss is not None:
        both = filled(np.stack([gloss.specular, gloss.alpha], axis=-1))
        specular, alpha = np.maximum(both[..., 0], 0), both[..., 1]
    index = gloss.index if gloss is not None else _INDEX
    return Surface(material.normal, material.depth_mm, albedo, specular, alpha, index)


def own_pictures(material: Material, setups: Sequence[Setup], stack: Any) -> dict[str, Array]:
    """The session's own pictures under the lights of setups, (y, x) luminance, NaN where not valid, by name.

    None of a session without an absolute scale, which does not say how bright they ought to be.

    Args:
        material: of the session.
        setups: whose names are those of illuminations.
        stack: the result of the node, opened.
    """
    radiance = stack["radiance"]
    if not material.absolute or "illumination" not in radiance.dims:
        return {}
    have = [str(name) for name in radiance["illumination"].values]
    weights = np.array(LUMINANCE) @ linear_srgb_matrix(material.bands_nm, material.widths_nm)
    return {
        setup.name: np.tensordot(
            weights, radiance.isel(illumination=have.index(setup.name)).values.astype(np.float64).sum(axis=1), 1
        )
        for setup in setups
        if setup.name in have
    }


def write_pictures(
    folder: Path,
    material: Material,
    surface: Surface,
    setups: Sequence[Setup],
    exposure: float | None,
    taken: Mapping[str, Array],
    *,
    progress: Progress = silent,
) -> tuple[dict[str, Entry], list[Row]]:
    """EXR files as they come, then the PNGs, when the exposure is known; returns what they are, and the table.

    Args:
        folder: is there.
        material, surface: what is lit.
        setups: of each picture.
        exposure: of the PNG; None: one for all pictures, by the brightest.
        taken: the session's own pictures, by name of the setup, (y, x) luminance.
        progress: shows how far it is.

    Raises:
        OSError: a file cannot be written.
    """
    known = material.known
    files: dict[str, Entry] = {}
    pictures = []
    for setup in progress(setups, len(setups), "pictures"):
        light = relight(surface, material.camera, setup.lamps)
        layers = {
            "": np.concatenate([light.diffuse + light.specular, known[..., None]], axis=2),
            "diffuse": light.diffuse,
            "specular": light.specular,
        }
        channels = {
            name: values
            for layer, picture in layers.items()
            for name, values in rgb(np.nan_to_num(picture), layer).items()
        }
        name = f"{setup.name}.exr"
        write_exr(folder / name, channels, colour=COLOUR, lights=setup.text, session=material.session)
        files[name] = {
            "what": f"linear radiance under {setup.text}; black where alpha is 0",
            "channels": list(channels),
            "units": "1: a white surface that faces a light of strength 1",
            "colorInteropID": COLOUR,
        }
        pictures.append((light.diffuse + light.specular)[known])
    if exposure is None:
        brightest = max(float(np.percentile(picture.max(axis=1), _BRIGHT)) for picture in pictures)
        exposure = _SHOWN / brightest if brightest > 0 else 1.0
    rows = []
    for setup, values in zip(setups, pictures, strict=True):
        picture = np.zeros((*known.shape, 3))
        picture[known] = exposure * values
        text = f"{setup.text}; linear values times {exposure:.6g}"
        (folder / f"{setup.name}.png").write_bytes(png16(picture, known, text))
        files[f"{setup.name}.png"] = {
            "what": f"the same for the eye, {setup.text}",
            "encoding": "sRGB, 16 bits, alpha straight",
            "exposure": exposure,
        }
        luminance = values @ np.array(LUMINANCE)
        alike = None
        if setup.name in taken:
            whole = np.zeros(known.shape)
            whole[known] = luminance
            alike = compare(whole, taken[setup.name], known & np.isfinite(taken[setup.name]))
        clipped = float((exposure * values > 1).any(axis=1).mean())
        rows.append(
            Row(
                setup.name,
                setup.text,
                exposure,
                float(np.median(luminance)),
                float(np.percentile(luminance, _BRIGHT)),
                clipped,
                *(alike or ()),
            )
        )
    return files, rows


def png16(linear: Array, alpha: NDArray[np.bool_], text: str) -> bytes:
    """A 16-bit RGBA PNG in sRGB, said in its `sRGB`, `gAMA` and `cHRM` chunks; alpha is straight.

    Args:
        linear: (y, x, rgb); values beyond 0..1 are clipped.
        alpha: (y, x): where the picture is opaque; it is black elsewhere.
        text: its `Comment`.
    """
    counts = np.zeros((*alpha.shape, 4), np.uint16)
    counts[..., :3] = np.where(alpha[..., None], srgb_16(linear), 0)
    counts[..., 3] = np.where(alpha, WHITE_16, 0)
    return encode_png(counts, light="srgb", comment=text)


def write_turn(
    folder: Path,
    material: Material,
    surface: Surface,
    setup: Setup,
    exposure: float,
    steps: int,
    *,
    progress: Progress = silent,
) -> dict[str, Entry]:
    """A film of the environment turned in steps, from where the picture has it; other lights stay.

    Args:
        folder: is there.
        material, surface: what is lit.
        setup: with an environment.
        exposure: of the film.
        steps: of a whole turn.
        progress: shows how far it is.

    Raises:
        OSError: it cannot be written.
    """
    rows, columns = (even(size) for size in material.known.shape)

    def frames() -> Iterator[NDArray[np.uint8]]:
        for step in progress(range(steps), steps, "frames"):
            places = setup.lamps.places.copy()
            places[: setup.turning] = turned(places[: setup.turning], 360.0 * step / steps)
            light = relight(surface, material.camera, setup.lamps._replace(places=places))
            canvas = np.zeros((rows, columns, 3), np.uint8)
            shown = srgb_8(exposure * np.nan_to_num(light.diffuse + light.specular))
            canvas[: shown.shape[0], : shown.shape[1]] = shown
            yield canvas

    write_film(folder / names.RELIGHT_FILM, frames(), (columns, rows), _FPS)
    return {
        names.RELIGHT_FILM: {
            "what": f"the environment turned once round in {steps} steps",
            "exposure": exposure,
            "fps": _FPS,
        }
    }


def write_table(folder: Path, rows: Sequence[Row]) -> dict[str, Entry]:
    """A row a picture.

    Raises:
        OSError: it cannot be written.
    """
    head = ("picture", "lights", "exposure", "median", "percentile_99_5", "clipped", "psnr_db", "ssim")
    table = csv_of_rows(
        head, ([*row[:2], *("" if number is None else f"{number:.6g}" for number in row[2:])] for row in rows)
    )
    (folder / names.RELIGHT_TABLE).write_bytes(table)
    return {names.RELIGHT_TABLE: {"what": "a row a picture"}}


def write_sheet(folder: Path, rows: Sequence[Row]) -> dict[str, Entry]:
    """The PNGs of all pictures beside each other, as they are in the folder.

    Raises:
        OSError: it cannot be written.
    """
    across = min(len(rows), max(1, math.ceil(math.sqrt(_WIDER * len(rows)))))
    thumbs = []
    for row in rows:
        with Image.open(folder / f"{row.picture}.png") as opened:
            thumb = opened.convert("RGBA")
        thumb.thumbnail((_THUMB_PX, _THUMB_PX))
        thumbs.append(thumb)
    wide, high = (max(thumb.size[i] for thumb in thumbs) for i in (0, 1))
    down = -(-len(rows) // across)
    size = (across * (wide + _GAP) + _GAP, down * (high + _TITLE + _GAP) + _GAP)
    sheet = Image.new("RGB", size, (24, 24, 24))
    draw = ImageDraw.Draw(sheet)
    for i, (row, thumb) in enumerate(zip(rows, thumbs, strict=True)):
        left, top = _GAP + (i % across) * (wide + _GAP), _GAP + (i // across) * (high + _TITLE + _GAP)
        draw.text((left, top + 2), row.picture, fill=(225, 225, 225), font=font(14))
        sheet.paste(thumb, (left, top + _TITLE), thumb)
    sheet.save(folder / names.RELIGHT_SHEET)
    return {names.RELIGHT_SHEET: {"what": "all pictures on one page"}}
