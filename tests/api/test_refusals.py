"""What products, formats and kernels refuse is a wrong request; what else goes wrong is not."""

import pytest

from lightstage.api.refusals import refusals
from lightstage.formats.errors import FormatError
from lightstage.kernels.errors import KernelError
from lightstage.products.errors import ProductError
from lightstage.store.errors import RequestError


@pytest.mark.parametrize("kind", [FormatError, KernelError, ProductError])
def test_their_sentence_is_that_of_a_wrong_request(kind: type[Exception]) -> None:
    with (
        pytest.raises(RequestError, match=r"^--at 3,4 is outside; choose another$"),
        refusals("--at ", "; choose another"),
    ):
        raise kind("3,4 is outside")


def test_a_fault_of_ours_stays_one() -> None:
    with pytest.raises(ValueError, match="shapes"), refusals():
        raise ValueError("shapes do not fit")
    with refusals():
        pass
