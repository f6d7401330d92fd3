"""The contact sheet: what a session looks like, on one page.

Constant picture, diffuse and specular component, normals as RGB, and the histogram of the normalising constant.
"""

from typing import Any

import numpy as np

from lightstage.products.errors import ProductError
from lightstage.products.figures import png_of, pyplot

LIT = 0.05
"""Of the 99th percentile of the albedo: what is darker is background."""
_BEST_NM = 576
"""Where skin shows both melanin and blood."""
_GAMMA = 2.2
_UNKNOWN = "tab:red"


def contact_sheet(session: str, stack: Any, normals: Any, frames: int) -> bytes:
    """A session's contact sheet, as a PNG.

    Args:
        session: its name.
        stack, normals: the results of these nodes, opened.
        frames: how many the session has.

    Raises:
        ProductError: the session has no band.
    """
    illumination = [str(name) for name in stack.illumination.values]
    first = illumination.index("C") if "C" in illumination else 0
    band = _best_band(stack)
    nm = float(stack.band.values[band])
    components = [str(name) for name in stack.component.values]
    dim = stack.radiance.dims[0]
    pictures = {
        c: stack.radiance.isel({dim: first, "band": band, "component": i}).values for i, c in enumerate(components)
    }
    name = {"C": "constant light"}.get(illumination[first], illumination[first])
    panels: list[tuple[str, Any]] = []
    if "specular" in pictures:
        panels.append((f"{name}, parallel", pictures["diffuse"] / 2 + pictures["specular"]))
    panels += [(f"{name}, {component}", picture) for component, picture in pictures.items()]
    normal_band = band if normals.sizes["band"] == stack.sizes["band"] else 0
    first_normals = normals.isel(tracking=0, band=normal_band)
    rgb = np.nan_to_num((first_normals.normal.transpose("y", "x", "xyz").values + 1) / 2)
    lit = first_normals.albedo.values > LIT * np.nanpercentile(first_normals.albedo.values, 99)

    count = len(panels) + 2
    aspect = stack.sizes["y"] / stack.sizes["x"]
    figure, axes = pyplot().subplots(1, count, figsize=(4 * count, 4 * aspect + 0.9), layout="constrained")
    grey = pyplot().get_cmap("gray").with_extremes(bad=_UNKNOWN)  # black would look like skin without light
    for axis, (title, picture) in zip(axes, panels, strict=False):
        top = np.nanpercentile(picture[lit] if lit.any() else picture, 99.5)
        axis.imshow(np.clip(picture / max(top, 1e-30), 0, 1) ** (1 / _GAMMA), cmap=grey, vmin=0, vmax=1)
        axis.set_title(title)
    axes[-2].imshow(rgb * lit[..., None])
    axes[-2].set_title(f"normals ({normals.attrs['method']}, {normals.attrs['component']})")
    for axis in axes[:-1]:
        axis.set_axis_off()
    values = first_normals.norm.values[lit & np.isfinite(first_normals.norm.values)]
    axes[-1].hist(values, bins=120, range=(0, 0.6), color="0.35")
    axes[-1].axvline(1 / 3, color="C3", linewidth=1, label="ideal 1/3")
    if values.size:
        axes[-1].axvline(float(np.median(values)), color="C0", linewidth=1, label=f"median {np.median(values):.3f}")
    axes[-1].set_title("norm")
    axes[-1].set_yticks([])
    axes[-1].legend(frameon=False)
    spectral = f"{nm:g} nm" if nm else "unfiltered"
    unknown = any(np.isnan(picture).any() for _, picture in panels)
    note = "; red: saturated, or not seen by both cameras" if unknown else ""
    figure.suptitle(f"{session}: {frames} frames, {spectral}{note}")
    return png_of(figure)


def _best_band(stack: Any) -> int:
    """The band nearest to _BEST_NM."""
    bands = stack.band.values
    if bands.size == 0:
        raise ProductError("the session has no band")
    return int(np.argmin(np.abs(bands - _BEST_NM)))
