"""Which tracking frame of a session a product is of."""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.products.errors import ProductError


def tracking_frame(results: Mapping[str, Any], first: str, session: str, asked: int | None) -> int:
    """The tracking frame asked for, or the first that a node has; every result has it.

    Args:
        results: opened, by node.
        first: the node whose first frame it is.
        session: its name.
        asked: None for the first.

    Raises:
        ProductError: a result lacks it.
    """
    have = [int(frame) for frame in results[first]["tracking"].values]
    frame = have[0] if asked is None and have else asked
    for node, dataset in results.items():
        check_frame(frame, dataset["tracking"].values, node, session)
    assert frame is not None
    return frame


def check_frame(frame: int | None, have: Sequence[int], node: str, session: str) -> None:
    """A node has a tracking frame.

    Raises:
        ProductError: it has not.
    """
    if frame is None or frame not in have:
        which = f"tracking frame {frame}" if frame is not None else "tracking frame"
        listed = ", ".join(map(str, have)) or "none"
        raise ProductError(f"'{node}' of session '{session}' has no {which}; it has {listed}")
