"""A capture folder that appears whole, and how its files are written."""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from lightstage.hw.errors import RigError


def appearing(folder: Path, what: dict[str, Any], write: Callable[[Path], None]) -> Path:
    """Let `write` fill a folder, which then appears under its name; nothing happens when it holds `what` already.

    Raises:
        RigError: the folder holds something else.
    """
    marker = yaml.safe_dump(plain(what), sort_keys=False)
    note = folder / "virtual_rig.yaml"
    if note.is_file() and note.read_bytes() == marker.encode():
        return folder
    if folder.exists():
        raise RigError(f"{folder} holds something else; remove it, or name another folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        write(work)
        (work / "virtual_rig.yaml").write_text(marker)
        os.chmod(work, 0o755)
        os.rename(work, folder)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    return folder


def plain(value: Any) -> Any:
    """As YAML knows it."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list | np.ndarray):
        return [plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def dump(path: Path, value: dict[str, Any]) -> None:
    """Write YAML."""
    path.write_text(yaml.safe_dump(plain(value), sort_keys=False, default_flow_style=None, width=110))


def save(path: Path, picture: NDArray[np.uint16]) -> None:
    """Write a picture.

    Raises:
        RigError: the disk does not take it.
    """
    if not cv2.imwrite(str(path), picture):
        raise RigError(f"{path} cannot be written; is the disk full?")
