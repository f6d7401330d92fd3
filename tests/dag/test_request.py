"""A request is made once and never changed, and holds every option of a run but where it is computed."""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import pytest

from lightstage.cli.run import add_run_options, request_of
from lightstage.dag.request import Request

OTHER: dict[str, tuple[tuple[str, ...], Any]] = {
    "overrides": (("--set", "normals.method=ratio"), ("normals.method=ratio",)),
    "frames": (("--frames", "0:3"), (0, 3)),
    "pipeline": (("--pipeline", "other.yaml"), Path("other.yaml")),
    "items": (("--calibration", "homography=h.yaml"), (("homography", Path("h.yaml")),)),
}
"""Per field of a request, an option of a run that gives it another value, and that value."""


def test_two_that_ask_for_the_same_are_the_same() -> None:
    first = Request("ball", Path("p.yaml"), ("normals",), frames=(0, 3))
    assert first == Request(session="ball", pipeline=Path("p.yaml"), nodes=("normals",), frames=(0, 3))
    assert len({first, Request("ball", Path("p.yaml"), ("normals",), frames=(0, 3))}) == 1
    assert first != Request("ball", Path("p.yaml"), ("normals",))


def test_what_is_not_asked_for_is_all_that_the_pipeline_computes() -> None:
    usual = Request("ball", Path("p.yaml"))
    assert (usual.nodes, usual.overrides, usual.frames, usual.items) == ((), (), None, ())


@pytest.mark.parametrize("field", [field.name for field in dataclasses.fields(Request)])
def test_no_field_changes(field: str) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(Request("ball", Path("p.yaml")), field, None)


def test_every_option_of_a_run_is_in_the_request_but_where_it_is_computed() -> None:
    parser = argparse.ArgumentParser()
    add_run_options(parser)
    plain = parser.parse_args([])
    usual = request_of(plain, "ball")
    reached = {"workers", "scheduler"}
    for field, (words, value) in OTHER.items():
        given = parser.parse_args(words)
        reached |= {name for name in vars(plain) if vars(given)[name] != vars(plain)[name]}
        assert request_of(given, "ball") == dataclasses.replace(usual, **{field: value})
    assert reached == set(vars(plain))
