"""A store that never holds more bytes than allowed, shared by threads."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class BoundedStore(Generic[K, V]):
    """What was made and used last, up to a number of bytes; the rest is made again when asked for.

    A value that several threads ask for at once is made once, and a failure is not kept. What is
    larger than the bound is handed out without being kept.

    Args:
        max_bytes: bound on the values held here; callers may hold others.
        size: bytes of a value.
    """

    def __init__(self, max_bytes: int, size: Callable[[V], int]) -> None:
        self.max_bytes = max_bytes
        self._size = size
        self._lock = threading.Lock()
        self._values: OrderedDict[K, V] = OrderedDict()
        self._under_way: dict[K, Future[V]] = {}
        self._bytes = 0
        self._epoch = 0

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The value of `key`, by `make()` if it is not held; raises what `make` raises."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
            result = self._under_way.get(key)
            made_elsewhere = result is not None
            if result is None:
                result = self._under_way[key] = Future()
            epoch = self._epoch
        if made_elsewhere:
            return result.result()
        try:
            value = make()
        except BaseException as error:
            with self._lock:
                self._end(key, result)
            result.set_exception(error)
            raise
        with self._lock:
            self._end(key, result)
            if epoch == self._epoch:
                self._keep(key, value)
        result.set_result(value)
        return value

    def peek(self, key: K) -> V | None:
        """The value if it is held; does not count as a use."""
        with self._lock:
            return self._values.get(key)

    def clear(self) -> None:
        """Forget everything, also what is being made now."""
        with self._lock:
            self._values.clear()
            self._under_way.clear()
            self._bytes = 0
            self._epoch += 1

    @property
    def bytes_held(self) -> int:
        with self._lock:
            return self._bytes

    def held(self) -> list[K]:
        """Keys of what is held; the first is the next to go."""
        with self._lock:
            return list(self._values)

    def _end(self, key: K, result: Future[V]) -> None:
        # After `clear` the same key may be under way a second time.
        if self._under_way.get(key) is result:
            del self._under_way[key]

    def _keep(self, key: K, value: V) -> None:
        size = self._size(value)
        if size > self.max_bytes:
            return
        while self._bytes + size > self.max_bytes:
            _, oldest = self._values.popitem(last=False)
            self._bytes -= self._size(oldest)
        self._values[key] = value
        self._bytes += size
