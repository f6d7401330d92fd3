"""A ball under near lights, for all subjects."""

from typing import Any

import pytest

from tests.kernels.near_rig import lights_of
from tests.scenes import light_places, near_ball


@pytest.fixture(scope="session")
def ball() -> tuple[Any, ...]:
    places, drive = light_places()
    return (*near_ball(places, drive), lights_of(places, drive))
