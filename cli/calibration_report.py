"""The page of `calibrate --report`: what was detected drawn on the picture, residuals, and the verdict.

One HTML file with its pictures in it, so that it can be sent and kept.
"""

import base64
import html
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.formats.whole_file import write_whole
from lightstage.products.figures import pyplot
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.dag.plan import Plan
    from lightstage.dag.stage import Finding, Result

_STYLE = """
body { font: 16px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
li.doubtful { color: #9a3412; } li.bad { color: #b91c1c; font-weight: 600; } li { margin: .25rem 0; }
img { max-width: 100%; border: 1px solid #ddd; } figcaption { color: #555; font-size: .9rem; }
table { border-collapse: collapse; font-size: .9rem; } td, th { padding: .15rem .7rem; text-align: right; }
th { border-bottom: 1px solid #999; } td:first-child, th:first-child { text-align: left; }
"""


def write_report(
    path: Path, item: str, plan: "Plan", result: "Result", verdict: "list[Finding]", store: Store
) -> None:
    """Write the page.

    Raises:
        WorkError: it cannot be written.
    """
    session = plan.session
    figures = _FIGURES[item](plan, result, store) if item in _FIGURES else []
    rows = _TABLES[item](result) if item in _TABLES else ((), [])
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>{item}: {html.escape(session.name)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{item}, measured from {html.escape(session.name)}</h1>",
        f"<p>Rig {html.escape(str(session.facts['rig'] or 'not named'))}, captured "
        f"{html.escape(str(session.facts['captured'] or 'at an unknown time'))}; {session.sizes['frame']} frames "
        f"of {session.shape[1]} x {session.shape[0]}; stage recipe {plan.nodes[item].recipe}.</p>",
        "<h2>Verdict</h2><ul>",
        *(f"<li class={finding.severity}>{html.escape(finding.sentence)}</li>" for finding in verdict),
        "</ul>",
    ]
    for title, caption, figure in figures:
        parts.append(
            f"<h2>{html.escape(title)}</h2><figure><img alt='{html.escape(title)}' "
            f"src='data:image/png;base64,{_encoded(figure)}'><figcaption>{html.escape(caption)}</figcaption></figure>"
        )
    header, body = rows
    if body:
        parts.append("<h2>Numbers</h2><table><tr>" + "".join(f"<th>{h}</th>" for h in header) + "</tr>")
        parts += ["<tr>" + "".join(f"<td>{html.escape(str(v))}</td>" for v in row) + "</tr>" for row in body]
        parts.append("</table>")
    parts.append("</body></html>\n")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, "\n".join(parts).encode())


_Drawn = list[tuple[str, str, Any]]


def _encoded(figure: Any) -> str:
    plt = pyplot()

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, bbox_inches="tight")
    plt.close(figure)
    return base64.b64encode(buffer.getvalue()).decode()


def _picture(plan: "Plan", store: Store, frame: int, polarisation: str | None = None) -> Any:
    """(y, x) counts of a frame's first band, of the reference camera or the one asked for."""
    names = list(plan.session.polarisations)
    which = names.index(polarisation or ("cross" if "cross" in names else names[0]))
    ref = plan.session.images[frame][0][which]
    return store.chunks.get(ref, dtype="<u2", shape=plan.session.shape)


def _brightened(picture: Any) -> Any:
    """Square root, from the dark to the brightest thousandth."""
    import numpy as np

    low, high = np.percentile(picture, [1, 99.9])
    return np.sqrt(np.clip((picture - low) / max(high - low, 1), 0, 1))


def _axes(width: float = 9.0, height: float = 6.0, columns: int = 1) -> tuple[Any, Any]:
    plt = pyplot()

    figure, axes = plt.subplots(1, columns, figsize=(width, height), squeeze=False)
    row: Any = axes[0]
    return figure, row


def _lights(plan: "Plan", result: "Result", store: Store) -> _Drawn:
    import numpy as np

    from lightstage.kernels.targets.labels import LIGHT_STATUS

    names = list(result.labels["light"])
    illumination = list(plan.session.facts["illumination"])
    places = plan.session.facts.get("part", [0] * len(illumination))
    drawn: _Drawn = []
    for part in range(result.arrays["outline"].shape[0]):
        frames = [i for i, name in enumerate(illumination) if name[0] == "L" and places[i] == part]
        picture = np.max([_picture(plan, store, i) for i in frames], axis=0)
        figure, axes = _axes()
        ax = axes[0]
        ax.imshow(_brightened(picture), cmap="gray")
        ring = result.arrays["outline"][part]
        ax.plot(*np.vstack([ring, ring[:1]]).T, color="tab:cyan", lw=0.8)
        at, status = result.arrays["at_px"][part], result.arrays["status"][part]
        for k, name in enumerate(names):
            if np.isfinite(at[k]).all():
                colour = "lime" if LIGHT_STATUS[status[k]] == "seen" else "orange"
                ax.plot(*at[k], "+", color=colour, ms=7)
                ax.annotate(name, at[k], color=colour, fontsize=6, xytext=(3, 3), textcoords="offset points")
        low, high = ring.min(axis=0) - 15, ring.max(axis=0) + 15
        ax.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
        drawn.append(
            (
                f"What was detected{f', place {part}' if result.arrays['outline'].shape[0] > 1 else ''}",
                "The brightest of all one-light pictures, the ball's outline (cyan) and every highlight (green: "
                "seen, orange: cut by the outline).",
                figure,
            )
        )
    residual = result.arrays["residual_mm"]
    if np.isfinite(residual).any():
        figure, axes = _axes(9, 3)
        axes[0].bar(range(len(names)), np.nan_to_num(residual), color="tab:blue")
        axes[0].set_xticks(range(len(names)), names, rotation=90, fontsize=6)
        axes[0].set_ylabel("mm off its place")
        drawn.append(
            ("Residuals", "How far each seen light is from its place in the layout, across its ray.", figure)
        )
    return drawn


def _lights_table(result: "Result") -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    import numpy as np

    rows = []
    for k, name in enumerate(result.labels["light"]):
        place = result.arrays["position_mm"][k]
        where = place if np.isfinite(place).all() else result.arrays["direction"][k]
        rows.append(
            (
                name,
                *(f"{v:.2f}" for v in where),
                _number(result.arrays["sigma_mm"][k]),
                _number(result.arrays["residual_mm"][k]),
            )
        )
    return ("light", "x", "y", "z", "sigma mm", "off its place mm"), rows


def _number(value: float) -> str:
    return "" if value != value else f"{value:.2f}"


def _arrows(points: Any, residual: Any, size: tuple[int, int], title: str) -> _Drawn:
    import numpy as np

    figure, axes = _axes()
    ax = axes[0]
    scale = max(float(np.median(np.linalg.norm(residual, axis=1))), 1e-4)
    arrows = ax.quiver(
        *points.T, *residual.T, angles="xy", scale_units="xy", scale=scale / (0.02 * size[1]), width=0.002
    )
    ax.quiverkey(arrows, 0.85, 0.96, scale, f"{scale:.3f} px", labelpos="E")
    ax.set(xlim=(0, size[1]), ylim=(size[0], 0), aspect="equal")
    return [
        (
            title,
            "Each arrow is a corner's residual, enlarged: noise points anywhere, a lens or parallax does not.",
            figure,
        )
    ]


def _homography(plan: "Plan", result: "Result", store: Store) -> _Drawn:
    drawn = _corners(plan, store)
    a = result.arrays
    return drawn + _arrows(a["points"], a["residual"], plan.session.shape, "Residual field")


def _camera(plan: "Plan", result: "Result", store: Store) -> _Drawn:
    a = result.arrays
    flat = _arrows(a["points"].reshape(-1, 2), a["residual"].reshape(-1, 2), plan.session.shape, "Residual field")
    return _corners(plan, store) + flat


def _corners(plan: "Plan", store: Store) -> _Drawn:
    """The boards with the corners found on them, the reference camera."""
    from lightstage.store.grid import open_dataset
    from lightstage.store.results import current_path

    found = open_dataset(current_path(plan.session.name, "corners", store))
    names = list(plan.session.polarisations)
    which = names.index("cross") if "cross" in names else 0
    frames = min(4, plan.session.sizes["frame"])
    figure, axes = _axes(9, 7.0 / frames + 1, frames)
    for i in range(frames):
        ax = axes[i]
        points = found.points.values[i, which]
        ax.imshow(_brightened(_picture(plan, store, i)), cmap="gray")
        ax.plot(points[..., 0].ravel(), points[..., 1].ravel(), "-", color="tab:cyan", lw=0.4)
        ax.plot(points[..., 0].ravel(), points[..., 1].ravel(), "+", color="lime", ms=3)
        ax.plot(*points[0, 0], "o", mfc="none", color="tab:red")
        ax.axis("off")
    return [("What was detected", "Corners in their order; the red circle is the first.", figure)]


def _defects(plan: "Plan", result: "Result", store: Store) -> _Drawn:
    import numpy as np

    mask = "hot" if "hot" in result.arrays else "dead"
    drawn: _Drawn = []
    for i, polarisation in enumerate(result.labels["polarisation"]):
        figure, axes = _axes(9, 3.6, 2)
        picture = result.arrays["mean"][i]
        low, high = np.percentile(picture, [0.5, 99.5])
        image = axes[0].imshow(picture, cmap="viridis", vmin=low, vmax=high)
        figure.colorbar(image, ax=axes[0], label="counts")
        y, x = np.nonzero(result.arrays[mask][i])
        axes[0].plot(x, y, "o", mfc="none", color="tab:red", ms=6)
        axes[1].hist(picture.ravel(), bins=200, log=True, color="tab:blue")
        axes[1].set_xlabel("counts")
        caption = f"The mean of the frames; {mask} pixels are circled."
        drawn.append((plan.session.facts["cameras"][polarisation], caption, figure))
    return drawn


def _bands(plan: "Plan", result: "Result", store: Store) -> _Drawn:
    figure, axes = _axes(9, 3.6, 2)
    axes[0].imshow(_brightened(_picture(plan, store, 0)), cmap="gray")
    axes[0].contour(result.arrays["target"], [0.5], colors="tab:cyan", linewidths=0.8)
    labels = [f"{nm:g}" for nm in result.labels["band"]]
    axes[1].bar(labels, result.arrays["scale"], color="tab:blue")
    axes[1].set(xlabel="nm", ylabel="counts per unit reflectance")
    return [
        ("What was measured", "The target's region (cyan) in the first band, and the scale of every band.", figure)
    ]


def _synchronisation(plan: "Plan", result: "Result", store: Store) -> _Drawn:
    import numpy as np

    figure, axes = _axes(9, 4, 2)
    image = axes[0].imshow(np.nan_to_num(result.arrays["drive"]), aspect="auto", cmap="magma", vmin=0, vmax=1)
    figure.colorbar(image, ax=axes[0], label="drive")
    axes[0].set(xlabel="light", ylabel="frame of the test")
    for i in np.flatnonzero(result.arrays["wrong"]):
        axes[0].axhline(i, color="tab:cyan", lw=1)
    for side in ("before", "after"):
        axes[1].plot(result.arrays[f"leak_{side}_percent"], "o-", ms=3, label=f"of the one {side}")
    axes[1].set(xlabel="frame of the test", ylabel="leak, percent")
    axes[1].legend()
    return [("Which lights lit each frame", "Frames that show something else are marked in cyan.", figure)]


def _polarisers(plan: "Plan", result: "Result", store: Store) -> _Drawn:
    import numpy as np

    figure, axes = _axes(9, 3.6, 2)
    names = list(result.labels["light"])
    axes[0].bar(range(len(names)), 100 * np.nan_to_num(result.arrays["residual"]), color="tab:blue")
    axes[0].set_xticks(range(0, len(names), 5), names[::5], fontsize=7)
    axes[0].set_ylabel("remains at the right angle, percent")
    axes[1].errorbar(
        range(len(names)), result.arrays["least_deg"], yerr=result.arrays["theta0_se_deg"], fmt="o", ms=3
    )
    axes[1].set(xlabel="light", ylabel="right angle, degrees")
    return [
        ("Polarisers", "What cross polarisation leaves of each highlight, and the setting that does so.", figure)
    ]


_FIGURES: Mapping[str, Callable[["Plan", "Result", Store], _Drawn]] = {
    "lights": _lights,
    "camera": _camera,
    "homography": _homography,
    "dark": _defects,
    "flat": _defects,
    "bands": _bands,
    "synchronisation": _synchronisation,
    "polarisers": _polarisers,
}
_TABLES: Mapping[str, Callable[["Result"], tuple[tuple[str, ...], list[tuple[Any, ...]]]]] = {
    "lights": _lights_table
}
