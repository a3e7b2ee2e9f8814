"""The bounded store against a plain list, and under threads."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from annotator.app.image_cache import BoundedStore

MAX_BYTES = 100
SIZES = st.lists(st.integers(0, 130), min_size=12, max_size=12)


@given(SIZES, st.lists(st.integers(0, 11), max_size=60))
def test_holds_what_was_used_last_within_the_bound(sizes: list[int], asked: list[int]) -> None:
    store: BoundedStore[int, bytes] = BoundedStore(MAX_BYTES, len)
    expected: list[int] = []
    for key in asked:
        held = key in expected
        made = []
        value = store.get(key, lambda key=key, made=made: made.append(key) or bytes(sizes[key]))
        assert len(value) == sizes[key]
        assert made == ([] if held else [key])
        if held:
            expected.remove(key)
        if sizes[key] <= MAX_BYTES:
            expected.append(key)
        while sum(sizes[k] for k in expected) > MAX_BYTES:
            del expected[0]
        assert store.held() == expected
        assert store.bytes_held == sum(sizes[k] for k in expected) <= MAX_BYTES


def test_the_bound_holds_at_every_moment_under_threads() -> None:
    store: BoundedStore[int, bytes] = BoundedStore(MAX_BYTES, len)
    largest = []

    def use(seed: int) -> None:
        for i in range(400):
            key = (seed * 7 + i * i) % 40
            assert store.get(key, lambda key=key: bytes(key)) == bytes(key)
            largest.append(store.bytes_held)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(use, range(8)))
    assert 0 < max(largest) <= MAX_BYTES
    assert store.bytes_held == sum(store.held())


def test_what_many_ask_for_at_once_is_made_once() -> None:
    store: BoundedStore[str, bytes] = BoundedStore(MAX_BYTES, len)
    asked, made = threading.Barrier(6), []

    def make() -> bytes:
        made.append(1)
        # All others have asked, or wait at the lock, by the time that this ends.
        threading.Event().wait(0.1)
        return b"value"

    def ask(_: int) -> bytes:
        asked.wait()
        return store.get("key", make)

    with ThreadPoolExecutor(6) as pool:
        assert set(pool.map(ask, range(6))) == {b"value"}
    assert made == [1]


def test_a_failure_reaches_all_who_wait_and_is_not_kept() -> None:
    store: BoundedStore[str, bytes] = BoundedStore(MAX_BYTES, len)
    asked = threading.Barrier(3)

    def fail() -> bytes:
        threading.Event().wait(0.1)
        raise ValueError("damaged")

    def ask(_: int) -> str:
        asked.wait()
        with pytest.raises(ValueError, match="damaged"):
            store.get("key", fail)
        return "told"

    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(ask, range(3))) == ["told"] * 3
    assert store.get("key", lambda: b"mended") == b"mended"


def test_what_was_begun_before_clearing_is_not_kept() -> None:
    store: BoundedStore[str, bytes] = BoundedStore(MAX_BYTES, len)

    def make() -> bytes:
        store.clear()
        return b"old"

    assert store.get("key", make) == b"old"
    assert store.peek("key") is None
    assert store.bytes_held == 0


def test_looking_is_no_use() -> None:
    store: BoundedStore[int, bytes] = BoundedStore(2, len)
    store.get(1, lambda: b"1")
    store.get(2, lambda: b"2")
    assert store.peek(1) == b"1"
    store.get(3, lambda: b"3")
    assert store.held() == [2, 3]
