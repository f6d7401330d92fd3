"""The names of illuminations by hand, and what they need to be read: nothing."""

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.hw import illuminations as names


@pytest.mark.parametrize("name", ["C", "O", "X", "Zc", "T0", "T3", "L00", "L7", "L345", "L999999"])
def test_known(name: str) -> None:
    assert names.is_known(name)


@pytest.mark.parametrize("name", ["", "c", "Cc", "W", "T4", "L", "L-1", "L1234567", "X ", "XX", "Lc", "l00"])
def test_unknown(name: str) -> None:
    assert not names.is_known(name)


def test_pairs_by_hand() -> None:
    assert [names.complement(name) for name in ("X", "Xc", "Z")] == ["Xc", "X", "Zc"]
    assert names.pairs(["Zc", "Y", "X", "Xc", "Z", "C"]) == [("X", "Xc"), ("Z", "Zc")]
    assert names.pairs({"X": 1, "C": 2}) == []
    assert [names.is_complement(name) for name in ("Yc", "Y", "C", "Lc")] == [True, False, False, False]
    assert [names.axis_number(name) for name in ("X", "Yc", "Z")] == [0, 1, 2]


@given(st.integers(0, 999_999))
def test_a_lights_name_holds_its_number(number: int) -> None:
    name = names.light_name(number)
    assert names.is_known(name)
    assert names.is_light(name)
    assert names.light_number(name) == number


def test_every_name_is_of_one_kind() -> None:
    for name in ("C", "O", "X", "Xc", "T2", "L04"):
        kinds = [
            names.is_gradient(name),
            names.is_light(name),
            names.is_test(name),
            name in (names.CONSTANT, names.DARK),
        ]
        assert sum(kinds) == 1, name
    assert names.test_number("T2") == 2


@pytest.mark.slow
def test_names_sets_and_tables_load_no_numbers() -> None:
    code = (
        "import sys, lightstage.hw.illuminations, lightstage.kernels.pictures.picture_sets\n"
        "import lightstage.kernels.normals.gradient_methods, lightstage.kernels.errors\n"
        "heavy = {'numpy', 'numba', 'cv2', 'scipy', 'pydantic'} & {name.split('.')[0] for name in sys.modules}\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
