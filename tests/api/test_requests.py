"""Requests made of Python values say the same as those made of a command's texts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightstage
from lightstage.api.requests import make_request
from lightstage.store.document import scalar


def test_values_and_texts_make_the_same_request() -> None:
    values = make_request(
        "s",
        ["normals"],
        changes={"normals.method": "minimal", "align.window": 3},
        frames=(0, 10),
        pipeline="p.yaml",
        items={"homography": "h.yaml"},
    )
    texts = make_request(
        "s",
        ["normals"],
        changes=["normals.method=minimal", "align.window=3"],
        frames="0:10",
        pipeline=Path("p.yaml"),
        items=["homography=h.yaml"],
    )
    assert values == texts
    assert hash(values) == hash(texts)


@pytest.mark.parametrize(
    "value",
    [
        "minimal",
        "no",
        "true",
        "1",
        "1e-3",
        "a: b",
        "",
        "NaN",
        3,
        -0.25,
        1e-7,
        1e12,
        True,
        None,
        [1, 2.5],
        ["x", "y"],
    ],
)
def test_a_value_is_read_as_it_was_given(value: Any) -> None:
    (text,) = make_request("s", changes={"node.name": value}).overrides
    read = scalar(text.removeprefix("node.name="))
    assert read == (tuple(value) if isinstance(value, list) else value)
    assert type(read) is type(value) or isinstance(value, list)


def test_numbers_of_numpy_are_numbers() -> None:
    assert make_request("s", changes={"n.p": np.float64(0.5)}).overrides == ("n.p=0.5",)
    assert make_request("s", changes={"n.p": np.array([1, 2])}).overrides == ("n.p=[1, 2]",)


@pytest.mark.parametrize("frames", [(3, 3), (5, 2), (-1, 2), "3", "a:b", (1, 2, 3)])
def test_frames_that_are_no_range_are_refused(frames: Any) -> None:
    with pytest.raises(lightstage.RequestError, match=r"--frames .*: expected A:B with A < B"):
        make_request("s", frames=frames)


def test_a_value_that_no_pipeline_can_hold_is_refused() -> None:
    with pytest.raises(lightstage.RequestError, match=r"--set n\.p: expected a number, a text or a list"):
        make_request("s", changes={"n.p": object()})
