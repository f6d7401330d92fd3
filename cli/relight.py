"""relight: a captured subject under other lights, as pictures.

All --light and the --environment light one picture together; each --led is a picture of its own, under the light of
that name where the lights item has it. Light 1 makes a white surface that faces it show 1: lights from afar have
their strength everywhere, the rig's have their power at the lights' mean distance from the stage's centre, and
under an environment of radiance 1 a white surface that sees all of it shows 1.

Where the session has a picture of its own under a light that is asked for, the two are compared.

Light is worked out in linear Rec. 709, with the gloss where it was measured, cast shadows, and light bounced once
(`kernels/appearance/relighting.py`). An environment is some hundred distant lights, by median cut.
"""

import argparse
import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from lightstage.cli.deliver import Delivery
from lightstage.cli.material import FRAME, Material, nodes_of, read_material
from lightstage.cli.run import add_run_options, override_items, paths_of, run_session, session_of
from lightstage.cli.show import Screen
from lightstage.cli.values import number, whole
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lightstage.kernels.appearance.relighting import Lamps, Surface

RECORD = "relight.json"
FORMAT = "lightstage-relight/1"
TABLE, SHEET, FILM = "relight.csv", "relight.png", "environment_turn.mp4"
LIGHTS = 256
"""Of an environment."""
_BRIGHT, _SHOWN = 99.5, 0.9
"""The exposure where none is given: this percentile of the brightest picture shows as so much of white."""
_FPS = 12.0
_STRONGEST = 1e6
"""Of a light, and of an exposure."""
_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear Rec. 709."""
_THUMB_PX, _GAP, _TITLE = 320, 8, 24


def configure(commands: Any) -> None:
    """Add the command of this file."""
    relight = commands.add_parser("relight", help="a captured subject under other lights: PNG and EXR")
    relight.add_argument("session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's demo")
    relight.add_argument("--to", required=True, type=Path, metavar="DIR")
    relight.add_argument(
        "--light",
        action="append",
        default=[],
        metavar="AZIMUTH,ELEVATION,STRENGTH",
        help="a distant light, in degrees: 0,0 is at the camera, 90,0 at the picture's right (a negative azimuth "
        "needs --light=-30,20,1); several add up",
    )
    relight.add_argument(
        "--led",
        action="append",
        default=[],
        metavar="ID|all",
        help="a picture under one of the rig's lights, such as L07; L07+L12 for both; all for one of each",
    )
    relight.add_argument("--environment", type=Path, metavar="MAP", help="a latitude-longitude map, .hdr or .exr")
    relight.add_argument(
        "--rotate",
        type=number,
        metavar="DEG",
        help="turn the environment: at 90 what was towards the camera is at the picture's right",
    )
    relight.add_argument(
        "--turn", type=whole, metavar="N", help=f"a film, {FILM}: the environment turned in N steps"
    )
    relight.add_argument(
        "--samples", type=whole, metavar="N", help=f"lights that stand for an environment (default: {LIGHTS})"
    )
    relight.add_argument(
        "--exposure",
        type=number,
        metavar="FACTOR",
        help="of the PNG: linear values times this (default: one for all pictures, by the brightest)",
    )
    relight.add_argument("--tracking", type=whole, metavar="N", help="the tracking frame (default: the first)")
    add_run_options(relight)
    relight.set_defaults(handler=handle_relight, computes=True)


@dataclass(frozen=True)
class Setup:
    """The lights of one picture."""

    name: str
    """Of its files."""
    text: str
    lamps: "Lamps"
    """(light, rgb)."""


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


def handle_relight(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage relight."""
    from lightstage.cli.demo import demo_session

    _check(options)
    lights = [_light_of(text) for text in options.light]
    environment = _environment(options)
    store = Store(options.store)
    options.session = session_of(options.session, store, screen) if options.session else demo_session(store, screen)
    setups = [*_own(lights, environment, options), *_leds(options, store)]
    delivery = Delivery(options.to, RECORD)
    delivery.claim(
        [
            *(f"{setup.name}.{form}" for setup in setups for form in ("png", "exr")),
            *(TABLE, SHEET),
            *([FILM] if options.turn else []),
        ],
        options.session,
    )
    nodes = nodes_of(options.session, store)
    summary = run_session(options, store, screen, nodes)
    paths = paths_of(summary, (*nodes, "stack"), options.session)
    material = read_material(options, store, {node: paths[node] for node in nodes})
    surface = surface_of(material)
    with delivery.making() as work:
        taken = _taken(material, setups, paths["stack"]) if options.led else {}
        files, rows = _write_pictures(work, material, surface, setups, options.exposure, taken, screen)
        if options.turn:
            files |= _write_film(work, material, surface, setups[0], environment, rows[0].exposure, options, screen)
        (work / TABLE).write_text(_as_csv(rows), encoding="utf-8")
        files[TABLE] = {"what": "a row a picture"}
        _write_sheet(work, rows)
        files[SHEET] = {"what": "all pictures on one page"}
        document = {
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
        made = delivery.settle(work, document, files)
    _say_rows(rows, screen)
    if material.gloss is None:
        screen.warn("the capture lacks one of the polarisations, so the pictures have no gloss")
    screen.say(f"{len(made)} files in {options.to}; {options.to / SHEET} shows the pictures")
    screen.document(
        {**summary, "files": [str(file) for file in made], "pictures": [row._asdict() for row in rows], **document}
    )
    return 0


def _say_rows(rows: Sequence[Row], screen: Screen) -> None:
    compared = any(row.psnr_db is not None for row in rows)
    cells = [
        [*row[:2], f"{row.exposure:.4g}", f"{row.median:.4f}", f"{row.bright:.4f}", f"{row.clipped:.2%}"]
        for row in rows
    ]
    if compared:
        for row, line in zip(rows, cells, strict=True):
            line += ["", ""] if row.psnr_db is None else [f"{row.psnr_db:.1f} dB", f"{row.ssim:.3f}"]
    head = ["picture", "lights", "exposure", "median", "99.5 %", "clipped", *(["PSNR", "SSIM"] if compared else [])]
    screen.table(head, cells, right=range(2, len(head)))
    if compared:
        screen.say("PSNR and SSIM: luminance, against the session's own pictures under these lights, noise and all")


def _check(options: argparse.Namespace) -> None:
    """What can be refused without looking at anything."""
    if not (options.light or options.led or options.environment):
        raise RequestError("relight: no light is named; give --light, --led or --environment")
    for option, value in (("--rotate", options.rotate), ("--turn", options.turn), ("--samples", options.samples)):
        if value is not None and options.environment is None:
            raise RequestError(f"{option} {value:g}: only an environment has it; add --environment MAP")
    if options.turn is not None and not 2 <= options.turn <= 1000:
        raise RequestError(f"--turn {options.turn}: a film has 2 to 1000 steps")
    if options.samples is not None and not 1 <= options.samples <= 10000:
        raise RequestError(f"--samples {options.samples}: 1 to 10000 lights stand for an environment")
    if options.exposure is not None and not 0 < options.exposure <= _STRONGEST:
        raise RequestError(
            f"--exposure {options.exposure:g}: expected a factor above 0 and up to {_STRONGEST:g}, such as 1.5"
        )


def _light_of(text: str) -> tuple[float, float, float]:
    try:
        azimuth, elevation, strength = (float(part) for part in text.split(","))
    except ValueError:
        raise RequestError(f"--light {text}: expected AZIMUTH,ELEVATION,STRENGTH, such as 45,30,1") from None
    if not (abs(azimuth) <= 360 and abs(elevation) <= 90 and 0 < strength <= _STRONGEST):
        raise RequestError(
            f"--light {text}: expected an azimuth of at most 360 degrees, an elevation of at most 90 and "
            f"a strength above 0 and up to {_STRONGEST:g}"
        )
    return azimuth, elevation, strength


def direction(azimuth_deg: float, elevation_deg: float) -> "NDArray[np.float64]":
    """(xyz): the unit vector towards a light; azimuth from the camera to the picture's right, elevation up."""
    import numpy as np

    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    across = np.cos(elevation)
    return np.array([across * np.sin(azimuth), np.sin(elevation), across * np.cos(azimuth)])


def turned(directions: "NDArray[np.float64]", degrees: float) -> "NDArray[np.float64]":
    """Directions (light, xyz) turned about the vertical: at 90 degrees +z comes to +x."""
    import numpy as np

    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    x, y, z = directions.T
    return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=1)


def _environment(options: argparse.Namespace) -> "Lamps | None":
    """The lights of the map, as it was turned."""
    if options.environment is None:
        return None
    from lightstage.cli.pictures import read_environment
    from lightstage.kernels.appearance.relighting import Lamps, median_cut

    directions, strength = median_cut(read_environment(options.environment), options.samples or LIGHTS)
    return Lamps.distant(turned(directions, options.rotate or 0.0), strength)


def _own(
    lights: Sequence[tuple[float, float, float]], environment: "Lamps | None", options: argparse.Namespace
) -> list[Setup]:
    """The picture of --light and --environment, if they are given."""
    import numpy as np

    from lightstage.kernels.appearance.relighting import Lamps

    if not lights and environment is None:
        return []
    parts, words = [], []
    if environment is not None:
        parts.append(environment)
        words.append(options.environment.name + (f" turned by {options.rotate:g}" if options.rotate else ""))
    if lights:
        towards = np.stack([direction(azimuth, elevation) for azimuth, elevation, _ in lights])
        parts.append(Lamps.distant(towards, np.array([[strength] * 3 for _, _, strength in lights])))
        words += ["(" + ", ".join(f"{number:g}" for number in light) + ")" for light in lights]
    name = "_".join((["environment"] if environment is not None else []) + (["lights"] if lights else []))
    return [Setup(name, " + ".join(words), _together(parts))]


def _together(parts: "Sequence[Lamps]") -> "Lamps":
    import numpy as np

    from lightstage.kernels.appearance.relighting import Lamps

    return Lamps(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _leds(options: argparse.Namespace, store: Store) -> list[Setup]:
    """The pictures of --led.

    Raises:
        RequestError: the session has no lights item, or no light of that name.
    """
    if not options.led:
        return []
    from lightstage.dag.plan import bound_items
    from lightstage.store.document import nearest
    from lightstage.store.sessions import read_session

    session = read_session(options.session, store)
    items = bound_items(session, store, override_items(options.calibration, store))
    if "lights" not in items:
        raise RequestError(
            f"session '{session.name}' has no lights item, which says where the rig's lights are; "
            "--light and --environment do without"
        )
    every = _rig(items["lights"].values)
    setups: dict[str, Setup] = {}
    for text in options.led:
        for name in list(every) if text == "all" else [text]:
            members = name.split("+")
            missing = [member for member in members if member not in every]
            if missing:
                have = f"{next(iter(every))} to {list(every)[-1]}"
                raise RequestError(
                    f"--led {text}: the rig has no light '{missing[0]}'{nearest(missing[0], every)}; it has {have}"
                )
            setups[name] = Setup(name, name, _together([every[member] for member in members]))
    return list(setups.values())


def _rig(item: Mapping[str, Any]) -> "dict[str, Lamps]":
    """The rig's lights by name; a light without a place is distant."""
    import numpy as np

    from lightstage.kernels.appearance.relighting import Lamps
    from lightstage.kernels.normals.near_light import Lights

    lights = Lights.of(item, near=False)
    every = {}
    for k, entry in enumerate(item["lights"]):
        strength = np.full((1, 3), lights.power[k])
        if entry["position_mm"] is None:
            every[entry["id"]] = Lamps.distant(lights.position[[k]] / lights.distance, strength)
        else:
            every[entry["id"]] = Lamps(lights.position[[k]], strength, np.array([lights.distance]))
    return every


def _taken(material: Material, setups: Sequence[Setup], path: Path) -> "dict[str, NDArray[np.float64]]":
    """The session's own pictures under the lights of setups, (y, x) luminance, NaN where not valid, by name.

    None of a session without an absolute scale, which does not say how bright they ought to be.
    """
    import numpy as np

    from lightstage.kernels.appearance.colour import linear_srgb_matrix
    from lightstage.store.grid import open_dataset

    stack = open_dataset(path)["radiance"]
    if not material.absolute or "illumination" not in stack.dims:
        return {}
    have = [str(name) for name in stack["illumination"].values]
    weights = np.array(_LUMINANCE) @ linear_srgb_matrix(material.bands_nm, material.widths_nm)
    return {
        setup.name: np.tensordot(
            weights, stack.isel(illumination=have.index(setup.name)).values.astype(np.float64).sum(axis=1), 1
        )
        for setup in setups
        if setup.name in have
    }


def surface_of(material: Material) -> "Surface":
    """What is lit. Colours outside Rec. 709 come to its border, and holes in the gloss take what is nearest."""
    import numpy as np

    from lightstage.cli.mesh import filled
    from lightstage.kernels.appearance.relighting import Surface

    known, gloss = material.known, material.gloss
    albedo = np.where(known[..., None], np.maximum(material.colour, 0), np.nan)
    specular = alpha = None
    if gloss is not None:
        both = filled(np.stack([gloss.specular, gloss.alpha], axis=-1))
        specular, alpha = np.maximum(both[..., 0], 0), both[..., 1]
    index = gloss.index if gloss is not None else 1.5
    return Surface(material.normal, material.depth_mm, albedo, specular, alpha, index)


def _write_pictures(
    work: Path,
    material: Material,
    surface: "Surface",
    setups: Sequence[Setup],
    exposure: float | None,
    taken: "Mapping[str, NDArray[np.float64]]",
    screen: Screen,
) -> tuple[dict[str, dict[str, Any]], list[Row]]:
    """EXR files as they come, then the PNGs, when the exposure is known; returns what they are, and the table.

    Args:
        taken: the session's own pictures, by name of the setup, (y, x) luminance.
    """
    import numpy as np

    from lightstage.cli.pictures import png16
    from lightstage.formats.exr import COLOUR, rgb, write_exr
    from lightstage.kernels.appearance.relighting import compare, relight

    known = material.known
    files: dict[str, dict[str, Any]] = {}
    pictures = []
    for setup in screen.progress(setups, len(setups), "pictures"):
        made = relight(surface, material.camera, setup.lamps)
        layers = {
            "": np.concatenate([made.diffuse + made.specular, known[..., None]], axis=2),
            "diffuse": made.diffuse,
            "specular": made.specular,
        }
        channels = {
            name: values
            for layer, picture in layers.items()
            for name, values in rgb(np.nan_to_num(picture), layer).items()
        }
        name = f"{setup.name}.exr"
        write_exr(work / name, channels, colour=COLOUR, lights=setup.text, session=material.session)
        files[name] = {
            "what": f"linear radiance under {setup.text}; black where alpha is 0",
            "channels": list(channels),
            "units": "1: a white surface that faces a light of strength 1",
            "colorInteropID": COLOUR,
        }
        pictures.append((made.diffuse + made.specular)[known])
    if exposure is None:
        brightest = max(float(np.percentile(picture.max(axis=1), _BRIGHT)) for picture in pictures)
        exposure = _SHOWN / brightest if brightest > 0 else 1.0
    rows = []
    for setup, values in zip(setups, pictures, strict=True):
        picture = np.zeros((*known.shape, 3))
        picture[known] = exposure * values
        text = f"{setup.text}; linear values times {exposure:.6g}"
        (work / f"{setup.name}.png").write_bytes(png16(picture, known, text))
        files[f"{setup.name}.png"] = {
            "what": f"the same for the eye, {setup.text}",
            "encoding": "sRGB, 16 bits, alpha straight",
            "exposure": exposure,
        }
        luminance = values @ np.array(_LUMINANCE)
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


def _write_film(
    work: Path,
    material: Material,
    surface: "Surface",
    setup: Setup,
    environment: "Lamps | None",
    exposure: float,
    options: argparse.Namespace,
    screen: Screen,
) -> dict[str, dict[str, Any]]:
    """The environment turned in steps, from where the picture has it; other lights stay."""
    import numpy as np

    from lightstage.cli.film import write_film
    from lightstage.kernels.appearance.colour import encode_srgb
    from lightstage.kernels.appearance.relighting import relight

    assert environment is not None
    count = len(environment.places)
    rows, columns = (size + size % 2 for size in material.known.shape)  # H.264 has a colour for two by two pixels

    def frames() -> Iterator[Any]:
        for step in screen.progress(range(options.turn), options.turn, "frames"):
            places = setup.lamps.places.copy()
            places[:count] = turned(places[:count], 360.0 * step / options.turn)
            made = relight(surface, material.camera, setup.lamps._replace(places=places))
            canvas = np.zeros((rows, columns, 3), np.uint8)
            shown = encode_srgb(exposure * np.nan_to_num(made.diffuse + made.specular))
            canvas[: shown.shape[0], : shown.shape[1]] = np.floor(255 * shown + 0.5)
            yield canvas

    write_film(work / FILM, frames(), (columns, rows), _FPS)
    return {
        FILM: {
            "what": f"the environment turned once round in {options.turn} steps",
            "exposure": exposure,
            "fps": _FPS,
        }
    }


def _write_sheet(work: Path, rows: Sequence[Row]) -> None:
    """The PNGs of all pictures beside each other, as they are."""
    import math

    from PIL import Image, ImageDraw

    from lightstage.cli.film import font

    across = min(len(rows), max(1, math.ceil(math.sqrt(1.3 * len(rows)))))
    thumbs = []
    for row in rows:
        with Image.open(work / f"{row.picture}.png") as opened:
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
    sheet.save(work / SHEET)


def _as_csv(rows: Sequence[Row]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["picture", "lights", "exposure", "median", "percentile_99_5", "clipped", "psnr_db", "ssim"])
    for row in rows:
        table.writerow([*row[:2], *("" if number is None else f"{number:.6g}" for number in row[2:])])
    return text.getvalue()
