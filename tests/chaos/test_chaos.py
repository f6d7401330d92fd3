"""One trial of every part, so that the trials themselves stay whole; `make chaos` makes them all."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.chaos.outcome import Outcome, table
from tests.conftest import REPOSITORY


@pytest.mark.slow
def test_one_trial_of_each_part_holds(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "tests.chaos", "--jobs", "1", "--trials", "1"]
    parts = ("flips", "kills", "disks", "races", "edits", "malformed", "equivalence")
    words += [word for part in parts for word in ("--part", part)]
    made = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, timeout=600, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    assert f"| **all** | | **{len(parts)}** | **0** | **0** | **0** |" in made.stdout


def test_the_table_counts_by_kind_and_names_what_was_not_tried() -> None:
    made = [
        Outcome("flips", "a bit", 0, "held"),
        Outcome("flips", "a bit", 6, "wrong", "other values"),
        Outcome("disks", "a disk of a size", 0, "skipped", "tmpfs cannot be mounted"),
        Outcome("workers", "no workers", 1, "hang"),
    ]
    assert table(made).splitlines() == [
        "| part | kind | tried | wrong | hang | unclear |",
        "|---|---|---:|---:|---:|---:|",
        "| flips | a bit | 2 | 1 | 0 | 0 |",
        "| workers | no workers | 1 | 0 | 1 | 0 |",
        "| **all** | | **3** | **1** | **1** | **0** |",
        "",
        "Not tried on this machine: disks, a disk of a size: tmpfs cannot be mounted.",
    ]
