"""What is asked for: made once, passed on, never changed.

Everything in a request decides what comes out, and all of it is in the key that its answer is remembered under
(`recall`). Where it is computed, and what is shown meanwhile, decides nothing and is no part of it.
"""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Request:
    """Nodes of a pipeline for a session."""

    session: str
    pipeline: Path
    """The file; it counts by what it holds."""
    nodes: tuple[str, ...] = ()
    """Empty: all that the pipeline computes unasked."""
    overrides: tuple[str, ...] = ()
    """`node.param=value`."""
    frames: tuple[int, int] | None = None
    """Half-open; None: all."""
    items: tuple[tuple[str, Path], ...] = ()
    """Calibration items given for this request alone: kind and file."""
