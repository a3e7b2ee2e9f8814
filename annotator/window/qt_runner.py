"""Threads whose results come back into Qt's event loop."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QObject, Qt, Signal, Slot

from annotator.desk.runner import ThreadRunner


class _Postman(QObject):
    """Calls functions in the thread it was made in; they may be handed in from any thread."""

    _handed_in = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self._handed_in.connect(self._call, Qt.ConnectionType.QueuedConnection)

    @Slot(object)
    def _call(self, call: Callable[[], None]) -> None:
        call()

    def deliver(self, call: Callable[[], None]) -> None:
        self._handed_in.emit(call)


class QtRunner(ThreadRunner):
    """Results are delivered in the thread that makes it, while its event loop runs."""

    def __init__(self) -> None:
        self._postman = _Postman()
        super().__init__(self._postman.deliver)
