"""Stimulus pictures through the command, and what is refused."""

from collections.abc import Callable

import numpy as np
import pytest

from lightstage.stages.stimulus import KINDS, StimulusParams
from tests.conftest import Answer


def test_a_wrong_light_is_named() -> None:
    with pytest.raises(ValueError, match="light '0,95,1': expected azimuth,elevation,strength"):
        StimulusParams(lights="0,95,1")


@pytest.mark.slow
def test_the_stage_runs_on_the_virtual_rig(lightstage: Callable[..., Answer]) -> None:
    import xarray

    assert lightstage("demo", "--session", "head", "--size", "102x78", "--bands", "434,576,655").code == 0
    done = lightstage("run", "stimulus", "--session", "head", "--set", "stimulus.cast_shadows=true", "--json")
    assert done.code == 0, done.err
    opened = xarray.open_zarr(done.json["nodes"]["stimulus"]["path"], chunks=None)
    assert list(opened.kind.values) == list(KINDS)
    shape, texture, both = opened.image.values[0]
    np.testing.assert_allclose(both, shape * texture, atol=1e-6)
    assert np.isfinite(shape).sum() > 1000
    refused = lightstage("run", "stimulus", "--session", "head", "--set", "relief.fuse=none")
    assert refused.code != 0
    assert "fuse: bands" in refused.err
