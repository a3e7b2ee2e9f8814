"""How long an annotator worked on each object, told from the times of the edits."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime

# Whoever does nothing for longer may be looking, or away: more is not counted.
LONGEST_PAUSE_S = 30.0


class HandsOn:
    """Seconds by object id.

    The time from one edit to the next belongs to the object of the latter (shared out evenly among
    several). Pauses count with `LONGEST_PAUSE_S` at most, and what comes before the first edit not
    at all, so the sum is a lower bound of the time spent.
    """

    def __init__(self) -> None:
        self._last: datetime | None = None
        self._seconds: dict[int, float] = {}

    def edited(self, time: str, objects: Iterable[int]) -> None:
        """An edit was made, undone or redone at `time` (UTC, ISO 8601)."""
        now, numbers = datetime.fromisoformat(time), list(objects)
        if self._last is not None:
            gap = min(max((now - self._last).total_seconds(), 0.0), LONGEST_PAUSE_S)
            for i in numbers:
                self._seconds[i] = self._seconds.get(i, 0.0) + gap / len(numbers)
        self._last = now

    def saved(self, objects: Iterable[int]) -> None:
        """The seconds of these objects were written down: counting starts anew."""
        for i in objects:
            self._seconds.pop(i, None)

    def pause(self) -> None:
        """The annotator left: the time until the next edit is nobody's."""
        self._last = None

    def seconds(self, object_id: int) -> float:
        return round(self._seconds.get(object_id, 0.0), 1)
