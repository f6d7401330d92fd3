"""skin: pigment maps of a capture, with the picture and the spectra to judge them by.

The sheet shows the albedo in colour, melanin, haemoglobin, what the model does not explain, and the spectra of
picked points with two standard errors; the spectra are also written as CSV, a row per point and band.
"""

import argparse
import csv
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cli.alignment import given_points
from cli.demo import demo_session
from cli.run import add_run_options, run_session, session_of
from cli.show import Screen
from store.errors import RequestError, WorkError
from store.root import Store

_AROUND_PX = 2
"""A spectrum is the mean over so many pixels to each side."""


def configure(commands: Any) -> None:
    """Add the command of this file."""
    skin = commands.add_parser("skin", help="melanin and haemoglobin maps, with spectra of picked points")
    skin.add_argument("session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's demo")
    skin.add_argument(
        "--at",
        action="append",
        default=[],
        metavar="X,Y",
        help="a spectrum of this pixel (repeatable; default: three)",
    )
    add_run_options(skin)
    skin.set_defaults(handler=handle_skin)


def handle_skin(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage skin."""
    from dag.plan import bound_items
    from store.grid import open_dataset
    from store.sessions import read_session

    store = Store(options.store)
    options.session = session_of(options.session, store, screen) if options.session else demo_session(store, screen)
    session = read_session(options.session, store)
    rows, columns = session.shape
    points = given_points(options.at, (rows, columns)) if options.at else []
    summary = run_session(options, store, screen, ["chromophores"])
    opened = {n: open_dataset(Path(summary["nodes"][n]["path"])) for n in ("chromophores", "reflectance")}
    items = bound_items(session, store, {})
    widths = {
        e["centre_nm"]: e.get("width_nm") for e in (items["bands"].values["bands"] if "bands" in items else ())
    }
    sheet = store.root / "pictures" / f"{session.name}-skin.png"
    table = sheet.with_suffix(".csv")
    sheet.parent.mkdir(exist_ok=True)
    points = points or _default_points(opened["chromophores"])
    spectra = _spectra(opened, points)
    try:
        _write_table(table, spectra)
        _draw(sheet, session.name, opened, widths, spectra)
    except OSError as error:
        raise WorkError(f"{sheet} or its table cannot be written ({error.strerror or error})") from None
    screen.say(f"spectra: {table}")
    screen.say(f"picture: {sheet}")
    screen.document({**summary, "picture": str(sheet), "spectra": str(table)})
    return 0


def _default_points(maps: Any) -> list[tuple[int, int]]:
    """(x, y) in the subject: where melanin is low, in the middle, and high, away from its rim."""
    import cv2
    import numpy as np

    melanin = maps.melanin.values[0]
    known = np.isfinite(melanin)
    inner = cv2.erode(known.astype(np.uint8), np.ones((9, 9))) > 0
    inner = inner if inner.any() else known
    if not inner.any():
        raise RequestError("no point of the capture has pigments, so there are no spectra to show")
    smooth = cv2.blur(np.where(known, melanin, 0).astype(np.float32), (5, 5))
    places = np.argwhere(inner)
    order = np.argsort(smooth[inner], kind="stable")
    picked = [places[order[round(part * (len(order) - 1))]] for part in (0.1, 0.5, 0.9)]
    return [(int(x), int(y)) for y, x in picked]


def _spectra(opened: Any, points: Sequence[tuple[int, int]]) -> list[dict[str, Any]]:
    import numpy as np

    reflectance, maps = opened["reflectance"], opened["chromophores"]
    found = []
    for x, y in points:
        here = {
            "y": slice(max(y - _AROUND_PX, 0), y + _AROUND_PX + 1),
            "x": slice(max(x - _AROUND_PX, 0), x + _AROUND_PX + 1),
        }
        values = reflectance.reflectance.isel(tracking=0, **here).values
        errors = reflectance.standard_error.isel(tracking=0, **here).values
        known = np.isfinite(values).all(axis=0)
        if not known.any():
            raise RequestError(f"--at {x},{y}: no reflectance is known there; pick a point on the subject")
        means = {n: float(np.nanmean(maps[n].isel(tracking=0, **here).values)) for n in ("melanin", "haemoglobin")}
        found.append(
            {
                "x": x,
                "y": y,
                "band": [float(b) for b in reflectance.band.values],
                "mean": values[:, known].mean(axis=1),
                # noise of neighbouring pixels is independent
                "error": np.sqrt((errors[:, known] ** 2).sum(axis=1)) / known.sum(),
                **means,
            }
        )
    return found


def _write_table(path: Path, spectra: Sequence[dict[str, Any]]) -> None:
    temporary = path.with_name(f".{path.name}.part")
    with open(temporary, "w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(["x", "y", "band_nm", "reflectance", "standard_error", "melanin", "haemoglobin"])
        for s in spectra:
            for band, mean, error in zip(s["band"], s["mean"], s["error"], strict=True):
                row = [f"{band:g}", f"{mean:.5f}", f"{error:.5f}", f"{s['melanin']:.4f}", f"{s['haemoglobin']:.4f}"]
                out.writerow([s["x"], s["y"], *row])
    os.replace(temporary, path)


def _draw(path: Path, name: str, opened: Any, widths: dict[float, Any], spectra: Sequence[dict[str, Any]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np

    from stages.colour import encode_srgb, linear_srgb_matrix

    maps, reflectance = opened["chromophores"], opened["reflectance"]
    bands = [float(b) for b in reflectance.band.values]
    matrix = linear_srgb_matrix(bands, [widths.get(b) for b in bands])
    colour = np.einsum("cb,byx->yxc", matrix, reflectance.reflectance.values[0])
    aspect = reflectance.sizes["y"] / reflectance.sizes["x"]
    figure, axes = plt.subplots(1, 5, figsize=(21, 4 * aspect + 1.2), layout="constrained")
    axes[0].imshow(encode_srgb(colour))
    axes[0].set_title("albedo, D65")
    for axis, (array, label) in zip(
        axes[1:4],
        (("melanin", "melanin"), ("haemoglobin", "haemoglobin"), ("residual", "residual: what the model leaves")),
        strict=True,
    ):
        values = maps[array].values[0]
        top = np.nanpercentile(values, 99) if np.isfinite(values).any() else 1.0
        shown = axis.imshow(values, vmin=0, vmax=max(float(top), 1e-9), cmap="viridis")
        axis.set_title(label)
        figure.colorbar(shown, ax=axis, shrink=0.8)
    for k, s in enumerate(spectra):
        tone = f"C{k}"
        for axis in axes[:4]:
            axis.plot(s["x"], s["y"], "o", color=tone, markersize=6, markerfacecolor="none")
        axes[4].errorbar(
            s["band"], s["mean"], 2 * s["error"], color=tone, marker="o", label=f"({s['x']}, {s['y']})"
        )
    for axis in axes[:4]:
        axis.set_axis_off()
    axes[4].set_xlabel("nm")
    axes[4].set_ylim(bottom=0)
    scale = reflectance.attrs.get("scale", "relative")
    axes[4].set_title(f"reflectance ({scale}), two standard errors")
    axes[4].legend(frameon=False)
    figure.suptitle(f"{name}: {maps.attrs.get('model', '')}")
    temporary = path.with_name(f".{path.stem}.part.png")
    try:
        figure.savefig(temporary, dpi=90)
    finally:
        plt.close(figure)
    os.replace(temporary, path)
