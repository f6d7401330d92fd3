"""A refusal of the rig is a sentence, wherever it was raised."""

import pickle

import pytest

from lightstage.hw.errors import RigError
from lightstage.hw.illuminations import EXPECTED
from lightstage.hw.sequence import parse


def test_its_sentence_survives_another_process() -> None:
    error = RigError("light 42 cannot be left out: frequency 2 has lights 0 to 41")
    assert str(pickle.loads(pickle.dumps(error))) == "light 42 cannot be left out: frequency 2 has lights 0 to 41"
    assert isinstance(error, ValueError)


def test_it_says_what_would_be_right() -> None:
    with pytest.raises(RigError) as refused:
        parse("X W")
    assert "'W'" in str(refused.value)
    assert EXPECTED in str(refused.value)
    assert "\n" not in str(refused.value)
