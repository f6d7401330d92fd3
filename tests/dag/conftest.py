"""A capture of three pictures in a store, and the two stages whose numbers anybody can work out."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from lightstage.dag.answer import Answer, answer, lay_out
from lightstage.dag.plan import State, look_up
from lightstage.dag.request import Request
from lightstage.store.importer import import_capture
from lightstage.store.root import Store
from tests.scenes import one_camera_capture
from tests.store.tiny import PIPELINE, TABLE


def table() -> Mapping[str, str]:
    """The stages."""
    return TABLE


class Tiny:
    """capture -> scaled (each picture) -> summed (all of a band), of the session `c`: 3 pictures, 1 band."""

    def __init__(self, folder: Path, store: Store) -> None:
        self.store = store
        self.capture = one_camera_capture(folder / "c", ["C", "X", "Y"], shape=(2, 3))
        self.session = import_capture(self.capture, store).session
        self.pipeline = folder / "pipeline.yaml"
        self.pipeline.write_text(PIPELINE)

    def request(self, *nodes: str, **more: Any) -> Request:
        """Nodes of the session."""
        return Request("c", self.pipeline, nodes, **more)

    def run(self, *nodes: str, **more: Any) -> Answer:
        """A request, answered."""
        return answer(self.request(*nodes, **more), self.store, table)

    def state(self, *nodes: str, **more: Any) -> State:
        """A request, looked up."""
        request = self.request(*nodes, **more)
        return look_up(lay_out(request, self.store, table), self.store, frames=request.frames)


@pytest.fixture
def tiny(tmp_path: Path, store: Store) -> Tiny:
    return Tiny(tmp_path, store)


@pytest.fixture
def stages() -> Callable[[], Mapping[str, str]]:
    return table
