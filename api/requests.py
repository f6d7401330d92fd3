"""A request (`dag.request`) made of Python values or of a command's texts; both are refused alike."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lightstage.dag.request import Request as Request
from lightstage.dag.sources import ROOT
from lightstage.store.errors import RequestError

Frames = str | tuple[int, int] | None
"""`A:B` or (A, B), half-open; None: all."""

PIPELINE, CALIBRATION = "pipeline.yaml", "calibration.yaml"
"""The packaged pipelines, of subjects and of the rig's targets."""


def make_request(
    session: str,
    nodes: Sequence[str] = (),
    *,
    changes: Mapping[str, Any] | Sequence[str] = (),
    frames: Frames = None,
    pipeline: str | Path | None = None,
    items: Mapping[str, str | Path] | Sequence[str] = (),
    packaged: str = PIPELINE,
) -> Request:
    """A request.

    Args:
        changes: parameters that differ from the pipeline's, {"normals.method": "minimal"}, or as with --set.
        items: calibration items for this request alone, {"homography": "h.yaml"}, or as with --calibration.
        packaged: which pipeline is meant where none is named.

    Raises:
        RequestError: one of them has not the form that it must have.
    """
    if isinstance(changes, Mapping):
        changes = [f"{name}={_text(name, value)}" for name, value in changes.items()]
    pairs = [*items.items()] if isinstance(items, Mapping) else [_pair(text) for text in items]
    return Request(
        session=session,
        pipeline=pipeline_path(pipeline, packaged),
        nodes=tuple(nodes),
        overrides=tuple(changes),
        frames=parse_frames(frames),
        items=tuple((kind, Path(path)) for kind, path in pairs),
    )


def pipeline_path(given: str | Path | None, packaged: str = PIPELINE) -> Path:
    """The pipeline file: the one given, the current folder's, or the packaged one."""
    if given is not None:
        return Path(given)
    local = Path(packaged)
    return local if local.is_file() else ROOT / packaged


def parse_frames(frames: Frames) -> tuple[int, int] | None:
    """A range of frames.

    Raises:
        RequestError: it is none.
    """
    if frames is None:
        return None
    text = frames if isinstance(frames, str) else ":".join(map(str, frames))
    first, colon, last = text.partition(":")
    digits = all(re.fullmatch(r"[0-9]{1,9}", part) for part in (first, last))
    if not (colon and digits and int(first) < int(last)):
        raise RequestError(f"--frames {text}: expected A:B with A < B, half-open, such as 0:10")
    return int(first), int(last)


def _pair(text: str) -> tuple[str, str]:
    kind, equals, path = text.partition("=")
    if not (equals and path):
        raise RequestError(f"--calibration {text}: expected KIND=FILE, such as homography=homography.yaml")
    return kind, path


_WORD = re.compile(r"[A-Za-z][\w-]*")
_NO_TEXT = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n", "nan", "inf"})
"""Words that YAML does not, or not everywhere, read as text."""


def _text(name: str, value: Any) -> str:
    """A parameter's value as --set has it, which reads YAML."""
    if isinstance(value, str) and _WORD.fullmatch(value) and value.lower() not in _NO_TEXT:
        return value
    try:
        return json.dumps(value, default=_plain)
    except TypeError:
        raise RequestError(f"--set {name}: expected a number, a text or a list, found {value!r}") from None


def _plain(value: Any) -> Any:
    """A number or an array of numpy's."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError
