"""Pigment maps against truth, and the skin models on measured spectra; writes the tables of docs/methods/skin.md.

`maps` runs the real command on `rendered/static_A` of the shared data, whose melanin and haemoglobin are known, and
judges inside the truth mask where the estimate is known. The other tables take spectra that others measured
(`real/skin_spectra`: skin by M. Vrhel, 400 to 700 nm; a ColorChecker) through the six pass bands of that capture, bells.
"""

from typing import Any, Literal

import colour
import numpy as np
import scipy.io
import xarray
from numpy.typing import NDArray

from benchmarks.accuracy import DATA, DOCS, Bench, partial_correlation
from benchmarks.pages import write_tables
from lightstage.kernels.appearance import absorption, skin_layers
from lightstage.kernels.appearance import colour as of_bands
from lightstage.kernels.appearance.chromophores import chromophores, predicted
from lightstage.stages.chromophores import ChromophoresParams
from lightstage.store.document import load

Array = NDArray[Any]
SETTINGS = {
    "beer_lambert (the default)": [],
    "beer_lambert, flat pass bands": ["pass_band=flat"],
    "kubelka_munk": ["model=kubelka_munk"],
    "kubelka_munk, flat pass bands": ["model=kubelka_munk", "pass_band=flat"],
}
SKINS = ("Caucasian", "Asian", "EastIndian", "AfricanAmerican")
ERROR = 0.02
"""Relative, in every band: a guess of what spectrum and table are worth."""


def maps(bench: Bench) -> list[str]:
    """One row per model."""
    folder = DATA / "rendered" / "static_A"
    session = bench.take_in(folder)
    truth = np.load(folder / "truth" / "ground_truth_cam1.npz")
    true_m, true_h = truth["melanin"].astype(float), truth["haemoglobin"].astype(float)
    lines = [
        "| model | M with true M | H with true H | M with true H, given true M | H with true M, given true H | slope of M | slope of H | residual | condition | oxygenation, median (5 to 95 %), known at |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, settings in SETTINGS.items():
        words = [word for setting in settings for word in ("--set", f"chromophores.{setting}")]
        node = bench.call("run", "chromophores", "--session", session, *words)["nodes"]["chromophores"]
        made = xarray.open_zarr(node["path"], chunks=None)
        found = [made[k].values[0].astype(float) for k in ("melanin", "haemoglobin")]
        judged = truth["mask"] & np.isfinite(found[0])
        m, h, tm, th = (values[judged] for values in (*found, true_m, true_h))
        oxygen = "-"
        if "oxygenation" in made:
            share = made["oxygenation"].values[0][judged]
            low, middle, high = np.nanpercentile(share, [5, 50, 95])
            oxygen = f"{middle:.2f} ({low:.2f} to {high:.2f}), {np.isfinite(share).mean():.0%}"
        lines.append(
            f"| {name} | {np.corrcoef(m, tm)[0, 1]:.3f} | {np.corrcoef(h, th)[0, 1]:.3f} | {partial_correlation(m, th, tm):+.3f} "
            f"| {partial_correlation(h, tm, th):+.3f} | {np.polyfit(tm, m, 1)[0]:.2f} | {np.polyfit(th, h, 1)[0]:.2f} "
            f"| {made.attrs['median_residual']:.3f} | {made.attrs['condition_number']:.1f} | {oxygen} |"
        )
    return lines


def skins(_: Bench) -> list[str]:
    """One row per measured skin."""
    lines = [
        "| skin | beer_lambert: RMS | M | H | kubelka_munk: RMS | M | blood, % | baseline | angle, degrees |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    kept: dict[Literal["beer_lambert", "kubelka_munk"], list[float]] = {"beer_lambert": [], "kubelka_munk": []}
    for name, rho in measured_skins():
        fits = {model: fitted(rho, ChromophoresParams(model=model, model_error=ERROR)) for model in kept}
        for model, (rms, _found) in fits.items():
            kept[model].append(rms)
        (rms_b, b), (rms_k, k) = fits["beer_lambert"], fits["kubelka_munk"]
        angle = skin_layers.likeness(rho, passing(), saturation=0.75, vessel_radius_um=15).angle_deg
        lines.append(
            f"| {name} | {rms_b:.4f} | {b[0]:.2f} | {b[1]:.3f} | {rms_k:.4f} | {k[0]:.2f} | {100 * k[1]:.2f} | {k[2]:+.2f} | {angle:.1f} |"
        )
    means = {model: f"**{np.mean(values):.4f}**" for model, values in kept.items()}
    return [*lines, f"| mean | {means['beer_lambert']} | | | {means['kubelka_munk']} | | | | |"]


def knobs(_: Bench) -> list[str]:
    """What the fixed numbers of the layered model do to the mean RMS."""
    lines = [
        "| vessel radius, um | saturation | RMS, mean | RMS, most | blood, %, median |",
        "|---|---|---|---|---|",
    ]
    for radius, saturation in (
        (0, 0.75),
        (5, 0.75),
        (10, 0.75),
        (15, 0.5),
        (15, 0.75),
        (15, 0.9),
        (25, 0.75),
        (40, 0.75),
    ):
        params = ChromophoresParams(
            model="kubelka_munk", model_error=ERROR, vessel_radius_um=float(radius), saturation=saturation
        )
        fits = [fitted(rho, params) for _name, rho in measured_skins()]
        rms = [value for value, _found in fits]
        blood = 100 * np.median([found[1] for _value, found in fits])
        lines.append(f"| {radius} | {saturation:g} | {np.mean(rms):.4f} | {np.max(rms):.4f} | {blood:.2f} |")
    return lines


def others(_: Bench) -> list[str]:
    """The patches of a ColorChecker, which are no skin."""
    stored = scipy.io.loadmat(DATA / "real" / "skin_spectra" / "macbethChart.mat")
    nm, values = stored["wavelength"][:, 0].astype(float), stored["data"]
    lines = ["| subject | blood of the best fit, % | misfit | angle, degrees | warned |", "|---|---|---|---|---|"]
    subjects = [(f"patch {i + 1}", passing() @ np.interp(absorption.NM, nm, v)) for i, v in enumerate(values.T)]
    for name, rho in [*subjects, ("an even grey", np.full(6, 0.4))]:
        found = skin_layers.likeness(rho, passing(), saturation=0.75, vessel_radius_um=15)
        warned = "no" if found.doubt is None else "blood" if found.doubt.startswith("no blood") else "misfit"
        lines.append(
            f"| {name} | {100 * found.blood:.2f} | {found.misfit:.2f} | {found.angle_deg:.1f} | {warned} |"
        )
    found_all = [
        skin_layers.likeness(rho, passing(), saturation=0.75, vessel_radius_um=15) for _n, rho in measured_skins()
    ]
    blood = [100 * found.blood for found in found_all]
    misfit, angle = [found.misfit for found in found_all], [found.angle_deg for found in found_all]
    warned = sum(found.doubt is not None for found in found_all)
    lines.append(
        f"| {len(found_all)} measured skins | {min(blood):.2f} to {max(blood):.2f} | {min(misfit):.2f} to {max(misfit):.2f} "
        f"| {min(angle):.1f} to {max(angle):.1f} | {warned} |"
    )
    return lines


def passing() -> Array:
    """Pass bands of the capture, (band, nm)."""
    path = DATA / "rendered" / "static_A" / "calibration" / "bands.yaml"
    return absorption.pass_bands(load(path, what="an item").value["bands"])


def measured_skins() -> list[tuple[str, Array]]:
    """Name and reflectance in the bands; a band that begins below 400 nm counts from there, where the spectra begin."""
    kept = passing() * (absorption.NM >= 400)
    kept /= kept.sum(axis=1, keepdims=True)
    found = []
    for name in SKINS:
        stored = scipy.io.loadmat(DATA / "real" / "skin_spectra" / f"{name}_Vhrel.mat")
        nm = stored["wavelength"][0].astype(float)
        for i, spectrum in enumerate(stored["data"].T):
            found.append((f"{name} {i + 1}", kept @ np.interp(absorption.NM, nm, spectrum)))
    return found


def fitted(rho: Array, params: ChromophoresParams) -> tuple[float, Array]:
    """RMS error of reflectance, and M, H, baseline."""
    settings = params.model_dump(exclude={"pass_band"})
    value = rho.astype(np.float32)[:, None, None]
    made = chromophores(value, np.zeros_like(value), passing=passing(), **settings)
    found = np.array([made[name][0] for name in ("melanin", "haemoglobin", "baseline")], float)
    of_model = {name: settings[name] for name in ("model", "saturation", "vessel_radius_um")}
    fit = predicted(*found, passing=passing(), **of_model)[0]
    return float(np.sqrt(np.mean((fit - rho) ** 2))), found[:, 0]


def colours(bench: Bench) -> list[str]:
    """Colour made of the six bands, with the blood component and without, against that of the measured spectrum."""
    entries = load(DATA / "rendered" / "static_A" / "calibration" / "bands.yaml", what="bands").value["bands"]
    centres, widths = [e["centre_nm"] for e in entries], [e["width_nm"] for e in entries]
    seen = of_bands.observed()
    passing = np.stack([of_bands.pass_band(c, w) for c, w in zip(centres, widths, strict=True)])
    lines = ["| spectra | smoothest alone: CIEDE2000, mean, most | with blood |", "|---|---|---|"]
    for name, spectra in _spectra(of_bands.NM).items():
        true = seen @ spectra
        cells = []
        for blood in (False, True):
            found = seen @ of_bands.spectrum_matrix(centres, widths, blood=blood) @ (passing @ spectra)
            white = colour.XYZ_to_xy(seen.sum(axis=1))
            labs = [colour.XYZ_to_Lab(xyz.T, white) for xyz in (found, true)]
            off = np.asarray(colour.delta_E(*labs, method="CIE 2000"))
            cells.append(f"{off.mean():.2f}, {off.max():.2f}")
        lines.append(f"| {name} ({spectra.shape[1]}) | {' | '.join(cells)} |")
    return lines


def _spectra(nm: Array) -> dict[str, Array]:
    """Measured reflectance (nm, spectrum): skin by group, and a ColorChecker."""
    folder = DATA / "real" / "skin_spectra"
    out = {}
    for name in SKINS:
        stored = scipy.io.loadmat(folder / f"{name}_Vhrel.mat")
        out[f"skin, {name}"] = np.stack(
            [np.interp(nm, stored["wavelength"][0], s) for s in stored["data"].T], axis=1
        )
    chart = scipy.io.loadmat(folder / "macbethChart.mat")
    at = chart["wavelength"][:, 0].astype(float)
    return out | {"ColorChecker": np.stack([np.interp(nm, at, s) for s in chart["data"].T], axis=1)}


if __name__ == "__main__":
    works = {"maps": maps, "skins": skins, "knobs": knobs, "others": others, "colours": colours}
    write_tables(__doc__, DOCS / "methods" / "skin.md", works)
