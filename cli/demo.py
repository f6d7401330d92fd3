"""demo."""

from typing import Any


def configure(commands: Any) -> None:
    """Add the commands of this file."""
