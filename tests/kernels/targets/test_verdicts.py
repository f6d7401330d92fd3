"""Verdicts are pairs of one of three words and a sentence, wherever they are given."""

import subprocess
import sys
from importlib import import_module
from typing import get_args, get_type_hints

import pytest

from lightstage.dag.stage import Finding, Stage, function
from lightstage.kernels.targets.verdicts import Severity, Verdict
from lightstage.stages import TABLE
from lightstage.stages.calibration import MEASURED

WORDS = ("good", "doubtful", "bad")


def test_kernels_and_the_engine_use_the_same_words() -> None:
    assert get_args(Severity) == WORDS
    assert get_args(get_type_hints(Finding)["severity"]) == WORDS
    ((pair,),) = (get_args(Verdict),)
    assert get_args(pair) == (Severity, str)


@pytest.mark.parametrize("name", MEASURED)
def test_what_judges_a_measurement_returns_one(name: str) -> None:
    stage: Stage = import_module(TABLE[name]).STAGE
    assert stage.verdict is not None
    assert get_type_hints(function(stage.verdict))["return"] == Verdict


def test_it_loads_nothing() -> None:
    code = "import sys, lightstage.kernels.targets.verdicts; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
