"""Messages stay until they are read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from annotator.app.events import SHOWN_S, Notices


class Clock:
    """Keeps what is to be called later."""

    def __init__(self) -> None:
        self.waiting: list[tuple[float, Callable[[], None]]] = []

    def later(self, seconds: float, action: Callable[[], None]) -> None:
        self.waiting.append((seconds, action))

    def ring(self) -> None:
        waiting, self.waiting = self.waiting, []
        for _, action in waiting:
            action()


def make() -> tuple[Notices, Clock, list[Any]]:
    shown: list[Any] = [[]]
    clock = Clock()
    return Notices(lambda notices: shown.append(notices), clock.later), clock, shown


def texts(shown: list[Any]) -> list[str]:
    return [n.text for n in shown[-1]]


def test_news_do_not_push_an_error_away_and_vanish_by_themselves() -> None:
    notices, clock, shown = make()
    notices.tell("cannot be read", "error")
    notices.tell("saved")
    notices.tell("carried")
    assert texts(shown) == ["cannot be read", "carried"]
    assert {seconds for seconds, _ in clock.waiting} == {SHOWN_S["info"]}
    clock.ring()
    assert texts(shown) == ["cannot be read"]


def test_an_error_stays_until_it_is_closed() -> None:
    notices, _, shown = make()
    notices.tell("first", "error")
    notices.tell("second", "warning")
    notices.close(shown[-1][0].number)
    assert texts(shown) == ["second"]


def test_the_same_message_is_not_shown_twice() -> None:
    notices, _, shown = make()
    for _ in range(3):
        notices.tell("no depth", "warning")
    assert texts(shown) == ["no depth"]
