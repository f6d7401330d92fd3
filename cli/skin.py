"""skin: melanin and haemoglobin of a session on one page, and the spectra of picked points.

The page shows the subject in colour (six bands to sRGB, `kernels/appearance/colour.py`), melanin, haemoglobin, and
the residual of the fit, each map on its own scale from 0 to what 99 % of the points stay below. The spectra are
medians over a small square around each point, with the fit of the pigments and the standard error; `average` is
the median over the subject.

A spectrum's angle is that to the nearest spectrum which living skin can have by the layered model
(`kernels/appearance/skin_layers.py`), as vectors over the bands, so brightness does not count. Measured skins are
within 7 degrees.
"""

import argparse
import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.figures import pyplot
from lightstage.cli.run import add_run_options, override_items, paths_of, run_session, session_of
from lightstage.cli.show import Screen
from lightstage.cli.values import whole
from lightstage.formats.whole_file import write_whole
from lightstage.store.errors import RequestError, WorkError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_POINTS = 8
_HALF_PX = 2
"""A point is the median of a square of 2 x 2 + 1 pixels a side."""
NODES = ("reflectance", "chromophores")
PIGMENTS = ("melanin", "haemoglobin", "baseline", "residual")
_SHARES = {"little melanin": ("melanin", 10), "much melanin": ("melanin", 98), "much blood": ("haemoglobin", 98)}
"""What is picked where no point is given: the percentile of a map."""


def configure(commands: Any) -> None:
    """Add the command of this file."""
    skin = commands.add_parser(
        "skin", help="pigment maps: import if need be, run, draw the maps and spectra of points"
    )
    skin.add_argument("session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's demo")
    skin.add_argument(
        "--at",
        action="append",
        default=[],
        metavar="X,Y",
        help=f"the spectrum of this pixel, up to {MOST_POINTS} times (default: little and much pigment)",
    )
    skin.add_argument("--tracking", type=whole, metavar="N", help="the tracking frame (default: the first)")
    add_run_options(skin)
    skin.set_defaults(handler=handle_skin, computes=True)


@dataclass(frozen=True)
class Skin:
    """One tracking frame. Pictures are (band, y, x) or (y, x), NaN where not known."""

    session: str
    tracking: int
    bands_nm: tuple[float, ...]
    widths_nm: tuple[float | None, ...]
    reflectance: "NDArray[np.float32]"
    standard_error: "NDArray[np.float32]"
    maps: "Mapping[str, NDArray[np.float32]]"
    passing: "NDArray[np.float64]"
    params: Any
    attrs: Mapping[str, Any]


@dataclass(frozen=True)
class Point:
    """A spectrum and what the model says of it; spectra are (band,)."""

    name: str
    at: tuple[int, int] | None
    """(x, y); None for the average."""
    reflectance: "NDArray[np.float64]"
    standard_error: "NDArray[np.float64]"
    """Of one pixel."""
    fit: "NDArray[np.float64]"
    pigments: Mapping[str, float]
    angle_deg: float


def handle_skin(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage skin."""
    from lightstage.cli.demo import demo_session

    points = [_point_of(text) for text in options.at]
    if len(points) > MOST_POINTS:
        raise RequestError(f"--at is given {len(points)} times; at most {MOST_POINTS} spectra are drawn")
    store = Store(options.store)
    options.session = session_of(options.session, store, screen) if options.session else demo_session(store, screen)
    summary = run_session(options, store, screen, NODES)
    skin = read_skin(options, store, paths_of(summary, NODES, options.session))
    picked = spectra(skin, points)
    stem = store.root / "pictures" / f"{skin.session}_skin"
    files = {
        "picture": stem.with_name(f"{stem.name}.png"),
        "spectra": stem.with_name(f"{stem.name}_spectra.png"),
        "table": stem.with_name(f"{stem.name}_spectra.csv"),
    }
    try:
        stem.parent.mkdir(exist_ok=True)
        _draw_maps(skin, picked, files["picture"])
        _draw_spectra(skin, picked, files["spectra"])
        write_whole(files["table"], _as_csv(skin, picked).encode())
    except OSError as error:
        raise WorkError(f"{stem.parent} cannot be written ({error.strerror or error})") from None
    screen.table(
        ("point", "x, y", "melanin", "haemoglobin", "baseline", "residual", "angle to skin"),
        [
            (
                point.name,
                "" if point.at is None else f"{point.at[0]}, {point.at[1]}",
                *(f"{point.pigments[name]:.3f}" for name in PIGMENTS),
                f"{point.angle_deg:.1f}°",
            )
            for point in picked
        ],
        right=(2, 3, 4, 5, 6),
    )
    for what, file in files.items():
        screen.say(f"{what}: {file}")
    screen.document(
        {
            **summary,
            **{what: str(file) for what, file in files.items()},
            "tracking": skin.tracking,
            "units": {name: skin.attrs[f"{name}_unit"] for name in ("melanin", "haemoglobin")},
            "points": [
                {
                    "name": point.name,
                    "at": None if point.at is None else list(point.at),
                    "reflectance": [round(float(v), 5) for v in point.reflectance],
                    "fit": [round(float(v), 5) for v in point.fit],
                    **{name: round(value, 5) for name, value in point.pigments.items()},
                    "angle_deg": round(point.angle_deg, 2),
                }
                for point in picked
            ],
        }
    )
    return 0


def read_skin(options: argparse.Namespace, store: Store, paths: Mapping[str, Path]) -> Skin:
    """The results at `paths`, by node.

    Raises:
        RequestError: there is no such tracking frame.
    """
    import numpy as np

    from lightstage.dag.plan import bound_items
    from lightstage.kernels.appearance.absorption import pass_bands
    from lightstage.stages.chromophores import ChromophoresParams
    from lightstage.store.grid import open_dataset
    from lightstage.store.sessions import read_session

    session = read_session(options.session, store)
    reflectance, pigments = (open_dataset(paths[node]) for node in NODES)
    have = [int(frame) for frame in pigments["tracking"].values]
    frame = have[0] if options.tracking is None and have else options.tracking
    if frame not in have:
        listed = ", ".join(map(str, have)) or "none"
        raise RequestError(
            f"'chromophores' of session '{session.name}' has no tracking frame {frame}; it has {listed}"
        )
    albedo, maps = (part.isel(tracking=have.index(frame)) for part in (reflectance, pigments))
    items = bound_items(session, store, override_items(options.calibration, store))
    entries = {entry["centre_nm"]: entry for entry in items["bands"].values["bands"]}
    bands = [entries[float(nm)] for nm in albedo["band"].values]
    params = ChromophoresParams(**pigments.attrs["parameters"])
    return Skin(
        session.name,
        frame,
        tuple(float(nm) for nm in albedo["band"].values),
        tuple(entry["width_nm"] for entry in bands),
        np.asarray(albedo["reflectance"].values, np.float32),
        np.asarray(albedo["standard_error"].values, np.float32),
        {name: np.asarray(maps[name].values, np.float32) for name in PIGMENTS},
        pass_bands(bands, params.pass_band),
        params,
        pigments.attrs,
    )


def _point_of(text: str) -> tuple[int, int]:
    try:
        x, y = (int(part) for part in text.split(","))
    except ValueError:
        raise RequestError(f"--at {text}: expected X,Y in whole pixels, such as 120,200") from None
    return x, y


def spectra(skin: Skin, points: Sequence[tuple[int, int]]) -> list[Point]:
    """The average and each point, or what is picked where none is given.

    Raises:
        RequestError: a point is outside the picture, or nothing is known there; or nothing is known anywhere.
    """
    import numpy as np

    height, width = skin.reflectance.shape[1:]
    known = np.isfinite(skin.reflectance).all(axis=0) & np.isfinite(skin.maps["residual"])
    if not known.any():
        raise RequestError(f"session '{skin.session}' has no point whose reflectance is known in every band")
    named = {f"point {i + 1}": point for i, point in enumerate(points)} or _picked(skin, known)
    found = [_spectrum(skin, "average", None, known)]
    for name, (x, y) in named.items():
        if not (0 <= x < width and 0 <= y < height):
            raise RequestError(
                f"--at {x},{y} is outside the picture; X is 0 to {width - 1} and Y is 0 to {height - 1}"
            )
        around = np.zeros_like(known)
        around[max(0, y - _HALF_PX) : y + _HALF_PX + 1, max(0, x - _HALF_PX) : x + _HALF_PX + 1] = True
        if not (around & known).any():
            raise RequestError(
                f"--at {x},{y}: nothing is known of the reflectance there; choose a point on the subject"
            )
        found.append(_spectrum(skin, name, (x, y), around & known))
    return found


def _picked(skin: Skin, known: "NDArray[np.bool_]") -> dict[str, tuple[int, int]]:
    """(x, y) where a smoothed map is nearest to a percentile of it, well inside of what is known."""
    import cv2
    import numpy as np

    side = max(3, skin.reflectance.shape[2] // 40) | 1
    inner = cv2.erode(known.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=0) > 0
    if not inner.any():
        inner = known
    places = {}
    for name, (pigment, percent) in _SHARES.items():
        smooth = cv2.blur(np.where(known, skin.maps[pigment], 0).astype(np.float32), (side, side))
        wanted = np.percentile(smooth[inner], percent)
        y, x = np.unravel_index(int(np.where(inner, np.abs(smooth - wanted), np.inf).argmin()), inner.shape)
        places[name] = (int(x), int(y))
    return places


def _spectrum(skin: Skin, name: str, at: tuple[int, int] | None, where: "NDArray[np.bool_]") -> Point:
    import numpy as np

    from lightstage.kernels.appearance.chromophores import chromophores, predicted
    from lightstage.kernels.appearance.skin_layers import likeness

    rho, error = (
        np.median(picture[:, where], axis=1, keepdims=True)[..., None]
        for picture in (skin.reflectance, skin.standard_error)
    )
    settings = skin.params.model_dump(exclude={"pass_band"})
    made = chromophores(rho, error, passing=skin.passing, **settings)
    pigments = {name: float(made[name][0, 0]) for name in PIGMENTS}
    fit = predicted(
        *(np.array([pigments[name]]) for name in PIGMENTS[:3]),
        passing=skin.passing,
        model=skin.params.model,
        saturation=skin.params.saturation,
        vessel_radius_um=skin.params.vessel_radius_um,
    )[0]
    spectrum, noise = (values[:, 0, 0].astype(np.float64) for values in (rho, error))
    found = likeness(
        np.maximum(spectrum, 1e-4),
        skin.passing,
        saturation=skin.params.saturation,
        vessel_radius_um=skin.params.vessel_radius_um,
    )
    return Point(name, at, spectrum, noise, fit, pigments, found.angle_deg)


def _draw_maps(skin: Skin, picked: Sequence[Point], path: Path) -> None:
    plt = pyplot()
    import numpy as np

    from lightstage.kernels.appearance.colour import encode_srgb, linear_srgb_matrix

    matrix = linear_srgb_matrix(skin.bands_nm, skin.widths_nm)
    colour = encode_srgb(np.moveaxis(np.tensordot(matrix, np.nan_to_num(skin.reflectance), 1), 0, 2))
    height, width = skin.reflectance.shape[1:]
    figure, axes = plt.subplots(2, 2, figsize=(11, 10.2 * height / width + 1.4), layout="constrained")
    axes = axes.ravel()
    axes[0].imshow(colour)
    axes[0].set_title(f"colour (sRGB, D65, of {len(skin.bands_nm)} bands)")
    texts = {
        "melanin": f"melanin ({skin.attrs['melanin_unit']})",
        "haemoglobin": f"haemoglobin ({skin.attrs['haemoglobin_unit']})",
        "residual": "residual (relative error of the fit, RMS over bands)",
    }
    ramps = {"melanin": "copper_r", "haemoglobin": "Reds", "residual": "viridis"}
    for axis, (name, text) in zip(axes[1:], texts.items(), strict=True):
        picture = skin.maps[name]
        known = picture[np.isfinite(picture)]
        top = float(np.percentile(known, 99)) if known.size else 1.0
        shown = axis.imshow(picture, cmap=ramps[name], vmin=0, vmax=max(top, 1e-6))
        figure.colorbar(shown, ax=axis, shrink=0.85)
        axis.set_facecolor("0.8")
        axis.set_title(text, fontsize=10)
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])
    for i, point in enumerate(point for point in picked if point.at is not None):
        assert point.at is not None
        axes[0].plot(*point.at, "o", color=f"C{i + 1}", markersize=7, markeredgecolor="white")
    figure.suptitle(f"{skin.session}: tracking frame {skin.tracking}, model {skin.params.model}")
    _save(figure, path)


def _draw_spectra(skin: Skin, picked: Sequence[Point], path: Path) -> None:
    plt = pyplot()

    figure, axis = plt.subplots(figsize=(7.5, 4.8), layout="constrained")
    for i, point in enumerate(picked):
        where = "" if point.at is None else f" ({point.at[0]}, {point.at[1]})"
        label = f"{point.name}{where}: M {point.pigments['melanin']:.2f}, H {point.pigments['haemoglobin']:.3f}"
        axis.errorbar(
            skin.bands_nm, point.reflectance, yerr=point.standard_error, fmt="o", color=f"C{i}", label=label
        )
        axis.plot(skin.bands_nm, point.fit, color=f"C{i}", linewidth=1)
    axis.set_xlabel("wavelength, nm")
    axis.set_ylabel("reflectance")
    axis.set_ylim(bottom=0)
    axis.legend(frameon=False, fontsize=8)
    axis.set_title(f"{skin.session}: medians (dots), noise of a pixel (bars), fit of {skin.params.model} (lines)")
    _save(figure, path)


def _save(figure: Any, path: Path) -> None:
    plt = pyplot()

    data = io.BytesIO()
    try:
        figure.savefig(data, format="png", dpi=110)
    finally:
        plt.close(figure)
    write_whole(path, data.getvalue())


def _as_csv(skin: Skin, picked: Sequence[Point]) -> str:
    """A row a point and band."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(
        ["point", "x", "y", "band_nm", "reflectance", "standard_error", "fit", *PIGMENTS, "angle_to_skin_deg"]
    )
    for point in picked:
        place = ("", "") if point.at is None else point.at
        for i, nm in enumerate(skin.bands_nm):
            rows.writerow(
                [point.name, *place, f"{nm:g}"]
                + [f"{v[i]:.5f}" for v in (point.reflectance, point.standard_error, point.fit)]
                + [f"{point.pigments[name]:.5f}" for name in PIGMENTS]
                + [f"{point.angle_deg:.2f}"]
            )
    return text.getvalue()
