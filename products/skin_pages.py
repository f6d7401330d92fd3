"""The pages of `skin.py`: maps of the pigments, and the spectra of points.

The maps show the subject in colour (six bands to sRGB, `kernels/appearance/colour.py`), melanin, haemoglobin, and
the residual of the fit, each on its own scale from 0 to what 99 % of the points stay below.
"""

from collections.abc import Sequence

import numpy as np

from lightstage.kernels.appearance.colour import encode_srgb, linear_srgb_matrix
from lightstage.products.figures import png_of, pyplot
from lightstage.products.skin import Point, Skin

_TOP_PERCENT = 99
_RAMPS = {"melanin": "copper_r", "haemoglobin": "Reds", "residual": "viridis"}


def maps_page(skin: Skin, points: Sequence[Point]) -> bytes:
    """The maps with the points marked, as a PNG."""
    matrix = linear_srgb_matrix(skin.bands_nm, skin.widths_nm)
    colour = encode_srgb(np.moveaxis(np.tensordot(matrix, np.nan_to_num(skin.reflectance), 1), 0, 2))
    height, width = skin.reflectance.shape[1:]
    figure, axes = pyplot().subplots(2, 2, figsize=(11, 10.2 * height / width + 1.4), layout="constrained")
    axes = axes.ravel()
    axes[0].imshow(colour)
    axes[0].set_title(f"colour (sRGB, D65, of {len(skin.bands_nm)} bands)")
    texts = {
        "melanin": f"melanin ({skin.attrs['melanin_unit']})",
        "haemoglobin": f"haemoglobin ({skin.attrs['haemoglobin_unit']})",
        "residual": "residual (relative error of the fit, RMS over bands)",
    }
    for axis, (name, text) in zip(axes[1:], texts.items(), strict=True):
        picture = skin.maps[name]
        known = picture[np.isfinite(picture)]
        top = float(np.percentile(known, _TOP_PERCENT)) if known.size else 1.0
        shown = axis.imshow(picture, cmap=_RAMPS[name], vmin=0, vmax=max(top, 1e-6))
        figure.colorbar(shown, ax=axis, shrink=0.85)
        axis.set_facecolor("0.8")
        axis.set_title(text, fontsize=10)
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])
    for i, point in enumerate(point for point in points if point.at is not None):
        assert point.at is not None
        axes[0].plot(*point.at, "o", color=f"C{i + 1}", markersize=7, markeredgecolor="white")
    figure.suptitle(f"{skin.session}: tracking frame {skin.tracking}, model {skin.model.model}")
    return png_of(figure)


def spectra_page(skin: Skin, points: Sequence[Point]) -> bytes:
    """The points' spectra with their fit, as a PNG."""
    figure, axis = pyplot().subplots(figsize=(7.5, 4.8), layout="constrained")
    for i, point in enumerate(points):
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
    axis.set_title(f"{skin.session}: medians (dots), noise of a pixel (bars), fit of {skin.model.model} (lines)")
    return png_of(figure)
