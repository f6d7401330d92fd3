"""Plans: what the thesis counts, and what follows from their times."""

import pytest

from lightstage.hw.errors import RigError
from lightstage.hw.pacing import Timing
from lightstage.hw.planning import plan, thesis_count
from lightstage.hw.sequence import minimal

TWENTY = Timing(exposure_ms=20)


def test_a_plan_without_times_has_no_rates() -> None:
    planned = plan("static")
    assert planned.names == ("C", "X", "Y", "Z", "Xc", "Yc", "Zc")
    assert (planned.images, len(planned.tracking), planned.flashes) == (7, 1, None)
    assert set(planned.rates().values()) == {None}


def test_rates_by_hand() -> None:
    planned = plan("wilson", tracking=2, timing=TWENTY)
    assert planned.images == 4 * 2 + 3
    assert planned.frame_rate_hz == pytest.approx(50)
    assert planned.tracking_rate_hz == pytest.approx(50 / 4)
    assert planned.starts_s == pytest.approx([0.02 * i for i in range(11)])


def test_a_wheel_has_exposures_and_no_rate_of_tracking() -> None:
    planned = plan("multispectral", bands_nm=(434, 576), timing=TWENTY)
    assert planned.images == len(planned.exposures) == 14
    assert planned.tracking_rate_hz is None


def test_the_sets_of_the_minimal_sequence_are_passed_on() -> None:
    assert plan("minimal", tracking=3, sets="mixed").names == minimal(3, sets="mixed")


def test_the_count_of_the_thesis_by_hand() -> None:
    # its table: 5, 9, 11, 15 images for 1, 2, 3, 4 tracking frames
    assert [thesis_count(n) for n in (1, 2, 3, 4)] == [5, 9, 11, 15]


def test_what_the_rig_cannot_show_is_refused() -> None:
    with pytest.raises(RigError):
        plan("wilson", tracking=0)
