"""Content digests."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.store.digest import canonical, digest_array, digest_value

plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=12,
)


@given(plain)
def test_equal_values_have_equal_digests_whatever_their_order(value: object) -> None:
    assert digest_value(_reordered(value)) == digest_value(value)


def _reordered(value: object) -> object:
    if isinstance(value, dict):
        return {key: _reordered(value[key]) for key in reversed(list(value))}
    if isinstance(value, list):
        return tuple(_reordered(item) for item in value)
    return value


def test_types_that_compare_equal_stay_apart_and_signed_zeros_do_not() -> None:
    assert digest_value(1) != digest_value(1.0)
    assert digest_value(True) != digest_value(1)
    assert digest_value(-0.0) == digest_value(0.0)


def test_what_has_no_canonical_form_is_refused() -> None:
    with pytest.raises(TypeError):
        canonical({1: 2})
    with pytest.raises(TypeError):
        canonical(object())
    with pytest.raises(ValueError, match="Out of range"):
        canonical(float("nan"))


def test_arrays_with_the_same_bytes_but_another_shape_or_dtype_differ() -> None:
    a = np.arange(12, dtype=np.uint16)
    assert len({digest_array(a), digest_array(a.reshape(3, 4)), digest_array(a.view(np.int16))}) == 3


def test_memory_layout_and_byte_order_do_not_count() -> None:
    a = np.arange(12, dtype=np.float32).reshape(3, 4)
    assert digest_array(np.asfortranarray(a)) == digest_array(a)
    assert digest_array(a.astype(">f4")) == digest_array(a)
    assert digest_array(np.repeat(a, 2, axis=0)[::2]) == digest_array(a)
