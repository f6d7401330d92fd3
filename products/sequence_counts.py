"""How many images a sequence needs, drawn against its tracking frames."""

from collections.abc import Sequence
from pathlib import Path

from lightstage.formats.whole_file import whole_file
from lightstage.products.figures import pyplot

PICTURES = (".png", ".svg", ".pdf")


def draw(rows: Sequence[tuple[int, int, int, int]], path: Path) -> None:
    """Draw a graph of the counts.

    Args:
        rows: tracking frames, and the images of Wilson's sequence, of the minimal one, and of the thesis' table.
        path: ends in one of PICTURES.

    Raises:
        OSError: it cannot be written.
    """
    plt = pyplot()
    n, wilson, minimal, thesis = zip(*rows, strict=True)
    figure, axis = plt.subplots(figsize=(6.4, 4), layout="constrained")
    axis.plot(n, wilson, "o-", markersize=3, label="Wilson, 4n + 3")
    axis.plot(n, minimal, "o-", markersize=3, label="minimal, 3n + 2")
    odd = [(a, c) for a, b, c in zip(n, minimal, thesis, strict=True) if b != c]
    if odd:
        axis.plot(*zip(*odd, strict=True), "x", color="0.4", label="the thesis where it differs, 3n + 3")
    axis.set_xlabel("tracking frames n")
    axis.set_ylabel("images")
    axis.set_xlim(0)
    axis.set_ylim(0)
    axis.grid(alpha=0.3)
    axis.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with whole_file(path) as beside:
            figure.savefig(beside, dpi=110)
    finally:
        plt.close(figure)
