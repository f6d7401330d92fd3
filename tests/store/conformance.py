"""What every place that holds a store's files must do, whatever it is made of: a suite to inherit from.

A subclass gives a `place` fixture: a `Place`, whose first methods go through the code under test and whose
`raw_` methods reach the same files past it, so that a fault in reading cannot hide one in writing. A place that
is reached by network inherits the same class.
"""

import contextlib
import threading
from abc import ABC, abstractmethod

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

NAMES = st.tuples(st.sampled_from(["", "a/", "a/b/", "c-1/"]), st.sampled_from(["0", "1.json", "x"])).map("".join)
DATA = st.binary(max_size=300)
LARGE = 1 << 20


class Place(ABC):
    """Files by name; a name is a relative path with slashes."""

    @abstractmethod
    def put(self, name: str, data: bytes) -> None:
        """Let a name hold data, in place of what it held."""

    @abstractmethod
    def put_if_absent(self, name: str, data: bytes) -> bool:
        """Let a name hold data unless it holds something; says whether it did."""

    @abstractmethod
    def get(self, name: str) -> bytes | None:
        """What a name holds, or None."""

    @abstractmethod
    def names(self) -> list[str]:
        """Every name that holds something, in order."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Let a name hold nothing; no error where it holds nothing already."""

    @abstractmethod
    def raw_get(self, name: str) -> bytes | None:
        """What a name holds, past the code under test."""

    @abstractmethod
    def raw_put(self, name: str, data: bytes) -> None:
        """Let a name hold data, past the code under test."""

    @abstractmethod
    def raw_names(self) -> list[str]:
        """Every name, past the code under test; with what is being written, which no name of ours is."""

    @abstractmethod
    def failing(self) -> contextlib.AbstractContextManager[None]:
        """While this is open, what is written cannot be finished."""


class PlaceConformance:
    """The suite; inherit it under a name that begins with Test, with a `place` fixture."""

    @pytest.fixture
    def place(self) -> Place:
        raise NotImplementedError

    def test_what_is_put_is_there_and_comes_back(self, place: Place) -> None:
        for name, data in (("a", b"one"), ("deep/er/b", b""), ("deep/c.json", bytes(range(256)) * 40)):
            place.put(name, data)
            assert place.raw_get(name) == data
            assert place.get(name) == data

    def test_what_others_have_put_is_read(self, place: Place) -> None:
        place.raw_put("x/y", b"from elsewhere")
        assert place.get("x/y") == b"from elsewhere"
        place.raw_put("x/y", b"changed")
        assert place.get("x/y") == b"changed"

    def test_what_is_not_there_is_none(self, place: Place) -> None:
        assert place.get("a") is None
        assert place.get("no/folder/either") is None
        place.put("a", b"1")
        assert place.get("b") is None

    def test_putting_again_replaces(self, place: Place) -> None:
        place.put("a", b"a longer first text")
        place.put("a", b"second")
        assert place.raw_get("a") == b"second"
        assert place.raw_names() == ["a"]

    def test_of_two_put_where_nothing_is_the_first_stays(self, place: Place) -> None:
        assert place.put_if_absent("n/a", b"first")
        assert not place.put_if_absent("n/a", b"second")
        assert place.raw_get("n/a") == b"first"
        place.raw_put("n/b", b"")
        assert not place.put_if_absent("n/b", b"something")
        assert place.raw_get("n/b") == b""
        assert place.raw_names() == ["n/a", "n/b"]

    def test_one_of_many_at_once_is_first(self, place: Place) -> None:
        won: list[bytes] = []
        start = threading.Barrier(4)

        def put(data: bytes) -> None:
            start.wait()
            if place.put_if_absent("race/x", data):
                won.append(data)

        threads = [threading.Thread(target=put, args=(bytes([i]) * 1000,)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(won) == 1
        assert place.raw_get("race/x") == won[0]

    def test_nobody_sees_a_half(self, place: Place) -> None:
        values = (b"1" * LARGE, b"2" * (LARGE // 2))
        place.put("a", values[0])
        seen: set[bytes | None] = set()
        done = threading.Event()

        def look() -> None:
            while not done.is_set():
                seen.add(place.get("a"))

        reader = threading.Thread(target=look)
        reader.start()
        for i in range(20):
            place.put("a", values[i % 2])
        done.set()
        reader.join()
        assert seen <= set(values)

    def test_what_cannot_be_finished_changes_nothing(self, place: Place) -> None:
        place.put("a", b"old")
        with place.failing():
            for put in (place.put, place.put_if_absent):
                with pytest.raises(Exception, match="full"):
                    put("a", b"new")
                with pytest.raises(Exception, match="full"):
                    put("b", b"new")
        assert place.raw_get("a") == b"old"
        assert place.get("b") is None
        place.put("b", b"now")
        assert place.raw_names() == ["a", "b"]

    def test_names_are_listed_in_order_and_without_what_is_being_written(self, place: Place) -> None:
        for name in ("b", "a/2", "a/10", "c/d/e"):
            place.put(name, b"x")
        place.raw_put("a/1", b"x")
        assert place.names() == sorted(["b", "a/2", "a/10", "c/d/e", "a/1"])

    def test_what_is_removed_is_gone(self, place: Place) -> None:
        place.put("a/b", b"x")
        place.put("a/c", b"x")
        place.remove("a/b")
        assert place.raw_get("a/b") is None
        assert place.names() == ["a/c"]
        place.remove("a/b")
        place.remove("never/there")
        assert place.put_if_absent("a/b", b"again")
        assert place.raw_get("a/b") == b"again"

    def test_it_is_a_mapping_of_names(self, place: Place) -> None:
        """Any order of puts and removals leaves what a dictionary would hold."""
        step = st.tuples(st.sampled_from(["put", "absent", "remove", "raw"]), NAMES, DATA)

        @settings(max_examples=15, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
        @given(st.lists(step, max_size=12))
        def agrees(steps: list[tuple[str, str, bytes]]) -> None:
            for name in place.names():
                place.remove(name)
            model: dict[str, bytes] = {}
            for what, name, data in steps:
                if what == "put":
                    place.put(name, data)
                    model[name] = data
                elif what == "absent":
                    assert place.put_if_absent(name, data) == (name not in model)
                    model.setdefault(name, data)
                elif what == "raw":
                    place.raw_put(name, data)
                    model[name] = data
                else:
                    place.remove(name)
                    model.pop(name, None)
                assert place.get(name) == model.get(name)
            assert {name: place.raw_get(name) for name in place.raw_names()} == model
            assert place.names() == sorted(model)

        agrees()
