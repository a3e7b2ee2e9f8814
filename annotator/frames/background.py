"""A few threads that work off a list which may be replaced or dropped at any time."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger


class BackgroundReader:
    """Calls `read(item)` for items in order; threads live only while there is work.

    Args:
        read: what to do; a ToolkitError is logged and the next item taken.
        threads: how many work at once.
    """

    def __init__(self, read: Callable[[int], object], *, threads: int = 1) -> None:
        self._read = read
        self._threads = threads
        self._waiting: deque[int] = deque()
        self._running = 0
        self._closed = False
        self._changed = threading.Condition()

    def request(self, items: Iterable[int]) -> None:
        """Read these, instead of what is still waiting. Nothing once closed."""
        with self._changed:
            if self._closed:
                return
            self._waiting = deque(dict.fromkeys(items))
            for _ in range(min(self._threads, len(self._waiting)) - self._running):
                self._running += 1
                threading.Thread(target=self._work, name="read-frames").start()

    def cancel(self) -> None:
        """Drop what is waiting; what is being read now ends by itself."""
        self.request(())

    def close(self) -> None:
        """Cancel, and wait for what is being read now; call it from outside of `read`."""
        with self._changed:
            self._waiting.clear()
            self._closed = True
        self.wait()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until nothing is left to read; False if that took longer than `timeout_s`."""
        with self._changed:
            return self._changed.wait_for(lambda: self._running == 0, timeout_s)

    def _work(self) -> None:
        while True:
            with self._changed:
                # When the program ends, Python waits for this thread: stop after this item.
                if not self._waiting or not threading.main_thread().is_alive():
                    self._waiting.clear()
                    self._running -= 1
                    self._changed.notify_all()
                    return
                item = self._waiting.popleft()
            try:
                self._read(item)
            except ToolkitError as error:
                # Whoever needs it gets the error when asking for it.
                logger.debug("reading ahead: %s", error)
            except Exception:
                logger.exception("reading ahead failed")
