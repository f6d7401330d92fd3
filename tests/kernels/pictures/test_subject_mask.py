"""Where the subject is."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures.subject_mask import find_subject


def test_the_subject_is_found_and_nothing_is_an_error() -> None:
    generator = np.random.default_rng(0)
    picture = generator.normal(0, 1, (80, 100))
    picture[20:60, 30:70] += 100
    picture[38:42, 48:52] -= 100  # a hole in it
    picture[5:8, 5:8] += 100  # something else
    mask = find_subject(picture)
    assert mask[25:55, 35:65].all()
    assert not mask[:19].any()
    with pytest.raises(KernelError, match="no subject stands out"):
        find_subject(np.zeros((50, 50)))


def test_a_lit_backdrop_is_no_subject() -> None:
    generator = np.random.default_rng(0)
    picture = generator.normal(10, 1, (80, 100))
    picture[20:60, 30:70] += 90
    mask = find_subject(picture)
    assert mask[25:55, 35:65].all()
    assert mask.mean() < 0.25
