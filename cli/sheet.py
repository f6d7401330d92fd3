"""The contact sheet: what a session looks like, on one page.

Constant picture, diffuse and specular component, normals as RGB, and the histogram of the normalising constant.
"""

from pathlib import Path
from typing import Any

from lightstage.cli.deliver import noted
from lightstage.cli.figures import pyplot
from lightstage.formats.whole_file import whole_file
from lightstage.store.errors import RequestError
from lightstage.store.results import current_path
from lightstage.store.root import Store


def contact_sheet(session: str, store: Store) -> Path:
    """Draw a session's contact sheet, unless it shows the results in use already, and return where it is.

    Raises:
        RequestError: the session has no normals yet.
    """
    shown = f"{current_path(session, 'stack', store)}\n{current_path(session, 'normals', store)}\n"
    path = store.root / "pictures" / f"{session}.png"
    note = path.with_suffix(".txt")
    if path.is_file() and note.is_file() and note.read_text() == noted(path, shown):
        return path
    path.parent.mkdir(exist_ok=True)
    with whole_file(path) as beside:
        _draw(session, store, beside)
    note.write_text(noted(path, shown))
    return path


def _draw(session: str, store: Store, path: Path) -> None:
    plt = pyplot()
    import numpy as np

    from lightstage.store.grid import open_dataset
    from lightstage.store.sessions import read_session

    stack = open_dataset(current_path(session, "stack", store))
    normals = open_dataset(current_path(session, "normals", store))
    facts = read_session(session, store).facts
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
    here = normals.isel(tracking=0, band=normal_band)
    rgb = np.nan_to_num((here.normal.transpose("y", "x", "xyz").values + 1) / 2)
    lit = here.albedo.values > 0.05 * np.nanpercentile(here.albedo.values, 99)

    count = len(panels) + 2
    aspect = stack.sizes["y"] / stack.sizes["x"]
    figure, axes = plt.subplots(1, count, figsize=(4 * count, 4 * aspect + 0.9), layout="constrained")
    for axis, (title, picture) in zip(axes, panels, strict=False):
        top = np.nanpercentile(picture[lit] if lit.any() else picture, 99.5)
        axis.imshow(
            np.clip(np.nan_to_num(picture) / max(top, 1e-30), 0, 1) ** (1 / 2.2), cmap="gray", vmin=0, vmax=1
        )
        axis.set_title(title)
    axes[-2].imshow(rgb * lit[..., None])
    axes[-2].set_title(f"normals ({normals.attrs['method']}, {normals.attrs['component']})")
    for axis in axes[:-1]:
        axis.set_axis_off()
    values = here.norm.values[lit & np.isfinite(here.norm.values)]
    axes[-1].hist(values, bins=120, range=(0, 0.6), color="0.35")
    axes[-1].axvline(1 / 3, color="C3", linewidth=1, label="ideal 1/3")
    if values.size:
        axes[-1].axvline(float(np.median(values)), color="C0", linewidth=1, label=f"median {np.median(values):.3f}")
    axes[-1].set_title("norm")
    axes[-1].set_yticks([])
    axes[-1].legend(frameon=False)
    spectral = f"{nm:g} nm" if nm else "unfiltered"
    figure.suptitle(f"{session}: {len(facts['illumination'])} frames, {spectral}")

    try:
        figure.savefig(path, dpi=110)
    finally:
        plt.close(figure)


def _best_band(stack: Any) -> int:
    """The band nearest to 576 nm, where skin shows both melanin and blood."""
    import numpy as np

    bands = stack.band.values
    if bands.size == 0:
        raise RequestError("the session has no band")
    return int(np.argmin(np.abs(bands - 576)))
