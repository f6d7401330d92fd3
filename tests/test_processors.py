"""Results are equal to rounding on every processor: the demo's pipeline, and that of a small performance, with
instructions left out.

Before they are rounded for storage normals are within 1e-4 degrees and all else is within 1e-5 of its value, or of
the array's median where the value is smaller than that: near zero, what remains of a difference is its rounding.
What is stored in steps (normals, visibility, registered counts) is within one, and in fewer than 0.1 % of values.
A value that rounds to another step is another input below; so from there on 0.1 % of values may be off further.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.kernels.encodings import SIGNAL_STEP
from tests.processors import CHOSEN_BY, IN_STEPS, SESSIONS, SETTINGS, apart, environment, results
from tests.whole_pipeline import nodes

pytestmark = pytest.mark.slow
Arrays = dict[str, NDArray[Any]]

_STEPPED = 1e-3


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Arrays]]:
    return results(tmp_path_factory.mktemp("processors"), "64x48")


@pytest.mark.skipif(
    any(name in os.environ for name in CHOSEN_BY),
    reason="this run is under one of the settings itself, so what the machine has is not to be seen",
)
def test_a_setting_is_what_it_says(tmp_path: Path) -> None:
    """Or all of this would compare a processor with itself."""
    asked = (
        "import numpy, cv2, numba; from numpy._core._multiarray_umath import __cpu_features__ as has;"
        "print([f for f in numpy.show_config(mode='dicts')['SIMD Extensions'].get('found', []) if has[f]]);"
        "print([w for w in cv2.getCPUFeaturesLine().split() if w[0] == '*' and w[-1] != '?']);"
        "print(numba.core.codegen.JITCPUCodegen('x')._get_host_cpu_name())"
    )
    says = {}
    for setting in SETTINGS:
        command = [sys.executable, "-c", asked]
        done = subprocess.run(
            command, env=environment(setting, tmp_path), capture_output=True, text=True, check=True
        )
        says[setting] = done.stdout.splitlines()
    assert says["numpy narrower"][0] == "[]"
    assert says["OpenCV narrower"][1] == "[]"
    assert says["numba narrower"][2] == "generic"


@pytest.mark.parametrize("setting", [name for name in SETTINGS if name != "as it is"])
@pytest.mark.parametrize("session", SESSIONS)
def test_every_node_is_equal_to_rounding(session: str, setting: str, found: dict[str, dict[str, Arrays]]) -> None:
    here, there = found[session]["as it is"], found[session][setting]
    assert list(here) == list(there)
    assert {name.partition("/")[0] for name in here} == set(nodes(session))
    stepped = False
    wrong = []
    for name, one in here.items():
        other = there[name]
        far, off = apart(name, one, other)
        in_steps = name in IN_STEPS or one.dtype.kind in "biu"
        few = far.mean() < _STEPPED if in_steps or stepped else not far.any()
        if not few or (in_steps and not stepped and off.max(initial=0.0) > 1):
            unit = "steps" if in_steps else "of what is allowed"
            wrong.append(f"{name}: {far.mean():.3%} of values, by up to {off.max():.3g} {unit}")
        stepped |= in_steps and bool(far.any())
    assert not wrong, "\n".join(wrong)


def test_the_measure_tells_steps_and_last_bits_from_more() -> None:
    whole = np.array([1.0, 100.0, np.nan, 1e-9], np.float32)
    near, far = whole * np.float32(1 + 5e-6), whole * np.float32(1 + 5e-5)
    assert not apart("a/b", whole, near)[0].any()
    assert apart("a/b", whole, far)[0].tolist() == [True, True, False, False]
    assert apart("a/b", whole, np.nan_to_num(whole))[0].tolist() == [False, False, True, False]
    counts = np.array([3.0, 3.0 + SIGNAL_STEP])
    assert apart("register/signal", counts, counts + np.array([0, 2 * SIGNAL_STEP]))[1].tolist() == [0, 2]
    normal = np.array([[0.0, 0, 1], [np.nan] * 3])
    turned = np.array([[1e-5, 0, 1], [np.nan] * 3])
    assert apart("a/unrounded normal", normal, turned)[0].tolist() == [True, False]
    assert apart("a/normal", np.array([5, 6]), np.array([5, 7]))[1].tolist() == [0, 1]
