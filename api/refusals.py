"""What a product, a file format or a kernel refuses, as a request that was wrong."""

from collections.abc import Iterator
from contextlib import contextmanager

from lightstage.store.errors import RequestError


@contextmanager
def refusals(about: str = "", remedy: str = "") -> Iterator[None]:
    """Their sentences become those of a request that was wrong.

    Args:
        about: what stands before the sentence, such as an option.
        remedy: what stands after it.

    Raises:
        RequestError: in the place of a refusal.
    """
    from lightstage.formats.errors import FormatError
    from lightstage.kernels.errors import KernelError
    from lightstage.products.errors import ProductError

    try:
        yield
    except (FormatError, KernelError, ProductError) as refusal:
        raise RequestError(f"{about}{refusal}{remedy}") from None
