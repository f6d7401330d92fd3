"""chromophores: melanin and haemoglobin of every point, from its reflectance in three or more bands.

`model: beer_lambert` takes skin for a bright base under two absorbers,

    -ln rho_b = M eps_m,b + H eps_h,b + baseline,    M, H >= 0

eps is absorption relative to 576 nm, averaged over the pass band of b (`absorption.py`). M and H are optical
depths at 576 nm along the mean way of the light. Divide H by ln(10) times the extinction of haemoglobin there
(4.9e4 cm-1 per mol/l at a saturation of 0.75) for concentration times way, in mol/l cm.

The base is what skin without pigments sends back, exp(-baseline). Its brightness is unknown: it holds how strongly
this skin scatters, and every error of shading or exposure that the bands share; so baseline is fitted, and of
either sign. Its colour is taken to be grey. A real dermis is a little redder, which adds a constant to M (0.13
for the dermis of `skin_layers.py`, 0.04 for one that rises from 0.80 to 0.87) and nothing to its differences; to
take out a colour that is too red would hold the M of fair skin at zero, and what was there could not be had back.

`model: kubelka_munk` puts melanin over a dermis that scatters, with blood in vessels; H is then the part of the
dermis' volume that is blood, from a look-up table, and `baseline` is 0 where scattering is as tabulated. This is
the one for living skin: straight optical depths cannot follow the Soret band, where hardly any light comes back
that has met blood (docs/methods/skin.md).

The fit is least squares, weighted by 1 / ((error / rho)^2 + model_error^2), and exact: for `beer_lambert` the
best of every set of absorbers at zero (Lawson and Hanson 1974), for `kubelka_munk` the best of the table, M and
baseline in closed form at each of its entries, then a parabola between them. `residual` is the RMS over bands of
ln rho - fit: about the relative error of reflectance.

Six bands may also tell oxyhaemoglobin from deoxyhaemoglobin. `oxygenation` comes from a fit with both, and is NaN
where its predicted standard error, model_error included, is beyond `oxygenation_error`; errors that bands share
in a whole picture (a filter's centre) are not in that.

Must have run before: reflectance, with a `bands` item.

Sources: Dawson et al. (1980), doi:10.1088/0031-9155/25/4/008, and Takiwaki et al. (1994) for optical density of
skin as a sum over pigments; Stamatas and Kollias (2004), doi:10.1117/1.1647545, for baseline and oxygenation;
Jacques (2013), doi:10.1088/0031-9155/58/11/R37.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.kernels.appearance.pigment_maps import MAPS, OXYGEN_BANDS, OXYGEN_MAPS


class ChromophoresParams(Params):
    """Parameters of `chromophores`."""

    model: Literal["beer_lambert", "kubelka_munk"] = Field(
        "beer_lambert", description="optical depths over a bright base; or a scattering dermis, for living skin"
    )
    saturation: float = Field(0.75, ge=0, le=1, description="of the blood, for haemoglobin; not for oxygenation")
    model_error: float = Field(
        0.01, gt=0, le=0.5, description="relative error of each band's reflectance beside noise: bands item, table"
    )
    pass_band: Literal["flat", "gaussian"] = Field(
        "gaussian", description="of filters without a curve: with width_nm at half maximum, or flat, width_nm wide"
    )
    vessel_radius_um: float = Field(15.0, ge=0, le=100, description="of kubelka_munk; 0: blood spread evenly")
    oxygenation_error: float = Field(0.1, gt=0, description="oxygenation is NaN where its standard error is larger")


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: ChromophoresParams
) -> Mapping[str, Any]:
    entries = {entry["centre_nm"]: entry for entry in items["bands"]["bands"]}
    lacking = [nm for nm in facts["bands_nm"] if nm not in entries]
    if lacking:
        have = ", ".join(f"{centre:g}" for centre in entries)
        raise StageError(f"the bands item has no band at {lacking[0]:g} nm (it has {have})")
    fields = ("centre_nm", "width_nm", "curve")
    bands = [{name: entries[nm].get(name) for name in fields} for nm in facts["bands_nm"]]
    return {"bands": bands, "pass_band": params.pass_band}


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: ChromophoresParams) -> Arrangement:
    (above,) = grids
    bands = [nm for nm in above.along("band") if nm]
    if len(bands) < 3 or len(bands) < len(above.along("band")):
        have = ", ".join(f"{nm:g} nm" if nm else "unfiltered light" for nm in above.along("band"))
        raise StageError(f"chromophores needs three or more filtered bands, this session has {have}")
    layered = params.model == "kubelka_munk"
    attrs = {
        "model": params.model,
        "melanin_unit": "optical depth at 576 nm",
        "haemoglobin_unit": "part of the dermis' volume that is blood" if layered else "optical depth at 576 nm",
    }
    outputs = set(MAPS)
    if layered or len(bands) < OXYGEN_BANDS:
        attrs["oxygenation"] = (
            "left out: model: beer_lambert tells it" if layered else "left out: needs five or more bands"
        )
    else:
        outputs |= set(OXYGEN_MAPS)
        attrs["oxygenation"] = f"NaN where its predicted standard error is beyond {params.oxygenation_error:g}"
    sizes = {name: size for name, size in above.sizes.items() if name != "band"}
    labels = {name: label for name, label in above.labels.items() if "band" not in label[0]}
    return Arrangement(Grid(sizes, labels, attrs), outputs=frozenset(outputs))


STAGE = Stage(
    name="chromophores",
    version=1,
    summary="melanin and haemoglobin",
    params=ChromophoresParams,
    inputs={
        "reflectance": Input("reflectance", ("tracking", "band", "y", "x")),
        "standard_error": Input("standard_error", ("tracking", "band", "y", "x")),
    },
    calibration={"bands": Needs(required=True, why="bands do not compare, and their pass bands are not known")},
    outputs={
        name: Output(("tracking", "y", "x"), "float32", attrs={"units": "1", "long_name": text})
        for name, text in (MAPS | OXYGEN_MAPS).items()
    },
    blocks=("tracking",),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.appearance.chromophores:prepare",
    prepared=("passing",),
    kernel="lightstage.kernels.appearance.chromophores:chromophores",
)
