"""Small files that tell when they have changed."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.store.errors import DamagedFileError
from lightstage.store.sealed import intact, is_sealed, seal, unseal

PLAIN = st.dictionaries(
    st.text().filter(lambda key: key != "seal"),
    st.recursive(st.none() | st.booleans() | st.integers() | st.text(), lambda inner: st.lists(inner)),
)


@given(PLAIN, st.sampled_from([None, 1]))
def test_it_is_json_and_comes_back(plain: dict[str, object], indent: int | None) -> None:
    data = seal(plain, indent=indent)
    assert unseal(data, "file") == plain
    assert list(json.loads(data)) == ["seal", *plain]


def test_every_flipped_bit_and_every_cut_is_noticed() -> None:
    data = seal({"white_level": 1023, "illumination": ["X", "C"], "images": [[["0f", "a1", 3]]]})
    for place in range(len(data)):
        for bit in range(8):
            wrong = data[:place] + bytes([data[place] ^ (1 << bit)]) + data[place + 1 :]
            assert not intact(wrong), (place, bit)
        assert not intact(data[:place])
    assert not intact(data + b" ")


def test_a_file_without_a_seal_is_damaged() -> None:
    data = json.dumps({"white_level": 1023}).encode()
    assert not is_sealed(data)
    assert is_sealed(seal({}))
    with pytest.raises(DamagedFileError, match=r"session\.json is damaged; import it again"):
        unseal(data, "session.json", "import it again")


def test_its_own_name_is_not_taken() -> None:
    with pytest.raises(ValueError, match="first member"):
        seal({"seal": "mine"})
