"""Other copies of the package than the one under test, to be edited, and processes that use them."""

import importlib
import shutil
import sys
from pathlib import Path

from lightstage.dag.sources import PACKAGE, ROOT


def copy_package(folder: Path) -> Path:
    """The package below a folder, with files in the place of links; returns the package's own folder."""
    shutil.copytree(ROOT, folder / PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
    return folder / PACKAGE


def use_package(folder: Path) -> None:
    """Let this process import the package that lies below a folder, and nothing of another."""
    for name in [n for n in sys.modules if n.partition(".")[0] == PACKAGE]:
        del sys.modules[name]
    sys.path[:] = [str(folder), *(p for p in sys.path if not (Path(p or ".") / PACKAGE).is_dir())]
    importlib.invalidate_caches()
