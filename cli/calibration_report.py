"""The page of `calibrate --report`."""

from pathlib import Path
from typing import Any


def write_report(path: Path, item: str, plan: Any, result: Any, verdict: list[str], store: Any) -> None:
    """To come."""
