"""The page of `calibrate --report`: what was detected drawn on the picture, residuals, and the verdict.

One HTML file with its pictures in it, so that it can be sent and kept.
"""

import base64
import html
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lightstage.formats.whole_file import write_whole
from lightstage.hw.cameras import reference_index
from lightstage.products.figures import pyplot

if TYPE_CHECKING:
    import xarray
    from numpy.typing import NDArray

_STYLE = """
body { font: 16px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
li.doubtful { color: #9a3412; } li.bad { color: #b91c1c; font-weight: 600; } li { margin: .25rem 0; }
img { max-width: 100%; border: 1px solid #ddd; } figcaption { color: #555; font-size: .9rem; }
table { border-collapse: collapse; font-size: .9rem; } td, th { padding: .15rem .7rem; text-align: right; }
th { border-bottom: 1px solid #999; } td:first-child, th:first-child { text-align: left; }
"""


@dataclass(frozen=True)
class Evidence:
    """What a report shows."""

    session: str
    facts: Mapping[str, Any]
    """The session's."""
    shape: tuple[int, int]
    """Of its pictures."""
    recipe: str
    """Of the node that measured."""
    result: "xarray.Dataset"
    """The node's."""
    verdict: Sequence[tuple[str, str]]
    """Severity and sentence."""
    picture: "Callable[[int, int], NDArray[np.uint16]]"
    """(y, x) counts of a frame's first band, by frame and index of the polarisation."""
    open_node: "Callable[[str], xarray.Dataset]"
    """The result of another node of the same run."""

    @property
    def reference(self) -> int:
        """Index of the reference camera's polarisation."""
        return reference_index(list(self.facts["polarisation"]))

    def array(self, name: str) -> Any:
        """An array of the result."""
        return self.result[name].values

    def labels(self, name: str) -> list[Any]:
        """A coordinate of the result."""
        return list(self.result[name].values.tolist())


def write_report(path: Path, item: str, evidence: Evidence) -> None:
    """Write the page.

    Raises:
        WorkError: it cannot be written.
    """
    facts, (height, width) = evidence.facts, evidence.shape
    figures = _FIGURES[item](evidence) if item in _FIGURES else []
    rows = _TABLES[item](evidence) if item in _TABLES else ((), [])
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>{item}: {html.escape(evidence.session)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{item}, measured from {html.escape(evidence.session)}</h1>",
        f"<p>Rig {html.escape(str(facts['rig'] or 'not named'))}, captured "
        f"{html.escape(str(facts['captured'] or 'at an unknown time'))}; {len(facts['illumination'])} frames "
        f"of {width} x {height}; stage recipe {evidence.recipe}.</p>",
        "<h2>Verdict</h2><ul>",
        *(f"<li class={severity}>{html.escape(sentence)}</li>" for severity, sentence in evidence.verdict),
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


def _brightened(picture: Any) -> Any:
    """Square root, from the dark to the brightest thousandth."""
    low, high = np.percentile(picture, [1, 99.9])
    return np.sqrt(np.clip((picture - low) / max(high - low, 1), 0, 1))


def _axes(width: float = 9.0, height: float = 6.0, columns: int = 1) -> tuple[Any, Any]:
    plt = pyplot()

    figure, axes = plt.subplots(1, columns, figsize=(width, height), squeeze=False)
    row: Any = axes[0]
    return figure, row


def _lights(evidence: Evidence) -> _Drawn:
    names = evidence.labels("light")
    illumination = list(evidence.facts["illumination"])
    meanings = evidence.result["status"].attrs["meanings"].split()
    places = evidence.facts.get("part", [0] * len(illumination))
    drawn: _Drawn = []
    outlines = evidence.array("outline")
    for part, ring in enumerate(outlines):
        frames = [i for i, name in enumerate(illumination) if name[0] == "L" and places[i] == part]
        picture = np.max([evidence.picture(i, evidence.reference) for i in frames], axis=0)
        figure, axes = _axes()
        ax = axes[0]
        ax.imshow(_brightened(picture), cmap="gray")
        ax.plot(*np.vstack([ring, ring[:1]]).T, color="tab:cyan", lw=0.8)
        at, status = evidence.array("at_px")[part], evidence.array("status")[part]
        for k, name in enumerate(names):
            if np.isfinite(at[k]).all():
                colour = "lime" if meanings[status[k]] == "seen" else "orange"
                ax.plot(*at[k], "+", color=colour, ms=7)
                ax.annotate(name, at[k], color=colour, fontsize=6, xytext=(3, 3), textcoords="offset points")
        low, high = ring.min(axis=0) - 15, ring.max(axis=0) + 15
        ax.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
        drawn.append(
            (
                f"What was detected{f', place {part}' if len(outlines) > 1 else ''}",
                "The brightest of all one-light pictures, the ball's outline (cyan) and every highlight (green: "
                "seen, orange: cut by the outline).",
                figure,
            )
        )
    residual = evidence.array("residual_mm")
    if np.isfinite(residual).any():
        figure, axes = _axes(9, 3)
        axes[0].bar(range(len(names)), np.nan_to_num(residual), color="tab:blue")
        axes[0].set_xticks(range(len(names)), names, rotation=90, fontsize=6)
        axes[0].set_ylabel("mm off its place")
        drawn.append(
            ("Residuals", "How far each seen light is from its place in the layout, across its ray.", figure)
        )
    return drawn


def _lights_table(evidence: Evidence) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    rows = []
    for k, name in enumerate(evidence.labels("light")):
        place = evidence.array("position_mm")[k]
        where = place if np.isfinite(place).all() else evidence.array("direction")[k]
        rows.append(
            (
                name,
                *(f"{v:.2f}" for v in where),
                _number(evidence.array("sigma_mm")[k]),
                _number(evidence.array("residual_mm")[k]),
            )
        )
    return ("light", "x", "y", "z", "sigma mm", "off its place mm"), rows


def _number(value: float) -> str:
    return "" if value != value else f"{value:.2f}"


def _arrows(points: Any, residual: Any, size: tuple[int, int], title: str) -> _Drawn:
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


def _homography(evidence: Evidence) -> _Drawn:
    points, residual = evidence.array("points"), evidence.array("residual")
    return _corners(evidence) + _arrows(points, residual, evidence.shape, "Residual field")


def _camera(evidence: Evidence) -> _Drawn:
    points, residual = (evidence.array(name).reshape(-1, 2) for name in ("points", "residual"))
    return _corners(evidence) + _arrows(points, residual, evidence.shape, "Residual field")


def _corners(evidence: Evidence) -> _Drawn:
    """The boards with the corners found on them, the reference camera."""
    corners = evidence.open_node("corners").points.values
    frames = min(4, len(evidence.facts["illumination"]))
    figure, axes = _axes(9, 7.0 / frames + 1, frames)
    for i in range(frames):
        ax = axes[i]
        points = corners[i, evidence.reference]
        ax.imshow(_brightened(evidence.picture(i, evidence.reference)), cmap="gray")
        ax.plot(points[..., 0].ravel(), points[..., 1].ravel(), "-", color="tab:cyan", lw=0.4)
        ax.plot(points[..., 0].ravel(), points[..., 1].ravel(), "+", color="lime", ms=3)
        ax.plot(*points[0, 0], "o", mfc="none", color="tab:red")
        ax.axis("off")
    return [("What was detected", "Corners in their order; the red circle is the first.", figure)]


def _defects(evidence: Evidence) -> _Drawn:
    mask = "hot" if "hot" in evidence.result else "dead"
    drawn: _Drawn = []
    for i, polarisation in enumerate(evidence.labels("polarisation")):
        figure, axes = _axes(9, 3.6, 2)
        picture = evidence.array("mean")[i]
        low, high = np.percentile(picture, [0.5, 99.5])
        image = axes[0].imshow(picture, cmap="viridis", vmin=low, vmax=high)
        figure.colorbar(image, ax=axes[0], label="counts")
        y, x = np.nonzero(evidence.array(mask)[i])
        axes[0].plot(x, y, "o", mfc="none", color="tab:red", ms=6)
        axes[1].hist(picture.ravel(), bins=200, log=True, color="tab:blue")
        axes[1].set_xlabel("counts")
        caption = f"The mean of the frames; {mask} pixels are circled."
        drawn.append((evidence.facts["cameras"][polarisation], caption, figure))
    return drawn


def _bands(evidence: Evidence) -> _Drawn:
    figure, axes = _axes(9, 3.6, 2)
    axes[0].imshow(_brightened(evidence.picture(0, evidence.reference)), cmap="gray")
    axes[0].contour(evidence.array("target"), [0.5], colors="tab:cyan", linewidths=0.8)
    labels = [f"{nm:g}" for nm in evidence.labels("band")]
    axes[1].bar(labels, evidence.array("scale"), color="tab:blue")
    axes[1].set(xlabel="nm", ylabel="counts per unit reflectance")
    return [
        ("What was measured", "The target's region (cyan) in the first band, and the scale of every band.", figure)
    ]


def _synchronisation(evidence: Evidence) -> _Drawn:
    figure, axes = _axes(9, 4, 2)
    image = axes[0].imshow(np.nan_to_num(evidence.array("drive")), aspect="auto", cmap="magma", vmin=0, vmax=1)
    figure.colorbar(image, ax=axes[0], label="drive")
    axes[0].set(xlabel="light", ylabel="frame of the test")
    for i in np.flatnonzero(evidence.array("wrong")):
        axes[0].axhline(i, color="tab:cyan", lw=1)
    for side in ("before", "after"):
        axes[1].plot(evidence.array(f"leak_{side}_percent"), "o-", ms=3, label=f"of the one {side}")
    axes[1].set(xlabel="frame of the test", ylabel="leak, percent")
    axes[1].legend()
    return [("Which lights lit each frame", "Frames that show something else are marked in cyan.", figure)]


def _polarisers(evidence: Evidence) -> _Drawn:
    figure, axes = _axes(9, 3.6, 2)
    names = evidence.labels("light")
    axes[0].bar(range(len(names)), 100 * np.nan_to_num(evidence.array("residual")), color="tab:blue")
    axes[0].set_xticks(range(0, len(names), 5), names[::5], fontsize=7)
    axes[0].set_ylabel("remains at the right angle, percent")
    axes[1].errorbar(
        range(len(names)), evidence.array("least_deg"), yerr=evidence.array("theta0_se_deg"), fmt="o", ms=3
    )
    axes[1].set(xlabel="light", ylabel="right angle, degrees")
    return [
        ("Polarisers", "What cross polarisation leaves of each highlight, and the setting that does so.", figure)
    ]


_FIGURES: Mapping[str, Callable[[Evidence], _Drawn]] = {
    "lights": _lights,
    "camera": _camera,
    "homography": _homography,
    "dark": _defects,
    "flat": _defects,
    "bands": _bands,
    "synchronisation": _synchronisation,
    "polarisers": _polarisers,
}
_TABLES: Mapping[str, Callable[[Evidence], tuple[tuple[str, ...], list[tuple[Any, ...]]]]] = {
    "lights": _lights_table
}
