"""Processors that this one can be taken for: libraries pick other instructions on each, and so other last bits.

`python -m tests.processors [--only SETTING] [PYTEST OPTION...]` runs the tests under each setting, or one of them,
and says which one is running (`make test-processors`).
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.encodings import SIGNAL_STEP

REPOSITORY = Path(__file__).resolve().parent.parent
Arrays = dict[str, NDArray[Any]]

DEGREES, RELATIVE = 1e-4, 1e-5
"""By how much normals, and all else, may differ before they are rounded for storage."""
IN_STEPS = {"register/signal": SIGNAL_STEP}
"""Floats that are multiples of something, by NODE/ARRAY."""
SESSIONS: Mapping[str, Sequence[str]] = {"head": (), "performer": ("--sequence", "wilson", "--tracking", "2")}
"""What the virtual rig captures, and how: a still head, and the shortest performance with two full windows."""


def _settings() -> Mapping[str, Mapping[str, str]]:
    """Environment variables by what they narrow; none where a processor has nothing that can be left out."""
    numpy_finds = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    # a star marks what OpenCV has code for beside the code that runs anywhere
    opencv_picks = [word.strip("*?") for word in cv2.getCPUFeaturesLine().split() if word.startswith("*")]
    return {
        "as it is": {},
        "numpy narrower": {"NPY_DISABLE_CPU_FEATURES": ",".join(numpy_finds)} if numpy_finds else {},
        "OpenCV narrower": {"OPENCV_CPU_DISABLE": ",".join(opencv_picks)} if opencv_picks else {},
        "numba narrower": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    }


SETTINGS = _settings()
CHOSEN_BY = ("NPY_DISABLE_CPU_FEATURES", "OPENCV_CPU_DISABLE", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")


def environment(setting: str, compiled: Path) -> dict[str, str]:
    """Of a process under a setting; `compiled` is a folder for code that numba makes for another processor."""
    found = {name: value for name, value in os.environ.items() if name not in CHOSEN_BY} | dict(SETTINGS[setting])
    if "NUMBA_CPU_NAME" in found:
        found["NUMBA_CACHE_DIR"] = str(compiled)
    return found


def performs(session: str) -> bool:
    """Whether the subject of a session moves."""
    return bool(SESSIONS[session])


def results(work: Path, size: str) -> dict[str, dict[str, Arrays]]:
    """By session and setting, all arrays of nodes of pipeline.yaml, from the same pictures of the virtual rig."""
    from lightstage.cli.main import main as lightstage

    for session, words in SESSIONS.items():
        demo = ["demo", "--size", size, "--session", session, *words]
        assert lightstage(["--store", str(work / "store"), *demo]) == 0
    running = {}
    for setting in SETTINGS:
        store, out = work / setting / "store", work / f"{setting}.npz"
        shutil.copytree(work / "store", store, symlinks=True)
        running[out] = subprocess.Popen(
            [sys.executable, "-m", "tests.whole_pipeline", str(store), str(out), *SESSIONS],
            cwd=REPOSITORY,
            env=environment(setting, work / "compiled"),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
    for process in running.values():
        _, said = process.communicate(timeout=1200)
        assert process.returncode == 0, said
    found = {out.stem: dict(np.load(out)) for out in running}
    return {
        session: {
            setting: {
                name.removeprefix(f"{session}/"): a for name, a in arrays.items() if name.startswith(f"{session}/")
            }
            for setting, arrays in found.items()
        }
        for session in SESSIONS
    }


def apart(name: str, one: NDArray[Any], other: NDArray[Any]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which values differ by more than is allowed, and by how much, in steps or in what is allowed."""
    if name.endswith("/unrounded normal"):
        off = np.degrees(np.linalg.norm(np.nan_to_num(one) - np.nan_to_num(other), axis=-1)) / DEGREES
        lost = (np.isnan(one) != np.isnan(other)).any(axis=-1)
        return (off > 1) | lost, off
    values, others = (np.nan_to_num(np.asarray(a, np.float64)) for a in (one, other))
    difference = np.abs(values - others)
    if one.dtype.kind in "biu":
        return difference > 0, difference
    lost = np.isnan(one) != np.isnan(other)
    if name in IN_STEPS:
        return (difference > 0) | lost, difference / IN_STEPS[name]
    known = np.abs(values[np.isfinite(one) & (values != 0)])
    usual = float(np.median(known)) if known.size else 1.0
    off = difference / np.maximum(np.abs(values), usual) / RELATIVE
    return (off > 1) | lost, off


def main(arguments: list[str]) -> int:
    """Run pytest under every setting; 1 when any run failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=SETTINGS, action="append", help="this setting; may be given again")
    options, words = parser.parse_known_args(arguments)
    chosen = {name: SETTINGS[name] for name in options.only or SETTINGS}
    failed = []
    with tempfile.TemporaryDirectory() as compiled:
        for name, variables in chosen.items():
            said = " ".join(f"{key}={value}" for key, value in variables.items()) or "nothing set"
            sys.stdout.write(f"\n== {name}: {said}\n")
            sys.stdout.flush()
            command = [sys.executable, "-m", "pytest", *(words or ["-n", "2"])]
            done = subprocess.run(command, cwd=REPOSITORY, env=environment(name, Path(compiled)), check=False)
            if done.returncode:
                failed.append(name)
    sys.stdout.write(
        f"\nfailed under: {', '.join(failed)}\n" if failed else f"\ngreen under: {', '.join(chosen)}\n"
    )
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
