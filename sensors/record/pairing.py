"""Images of several streams, put together by the time they were taken."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass
class StreamCount:
    """What became of a stream's images.

    Attributes:
        arrived: images.
        lost: numbers that the camera counted but never came: lost before they reached us.
        single: images that had no partner in the other streams.
    """

    arrived: int = 0
    lost: int = 0
    single: int = 0


@dataclass
class Pairing:
    """Sets of images, one of each stream, whose times lie within half a frame of each other.

    The first stream leads: every image of it gets the nearest one of each other stream. Whether one
    is the nearest is known when a later one has come, or when none is nearer than what came already
    at the same time; so images of one trigger leave at once.

    Args:
        streams: names; the first leads.
        period_ms: from frame to frame.
    """

    streams: Sequence[str]
    period_ms: float
    counts: dict[str, StreamCount] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.counts = {name: StreamCount() for name in self.streams}
        self._waiting: dict[str, deque[tuple[float, Any]]] = {n: deque() for n in self.streams}
        self._last: dict[str, tuple[int, float]] = {}

    def add(self, stream: str, number: int, time_ms: float, image: Any) -> Iterator[dict[str, Any]]:
        """Take an image; yields the sets that it completes, by stream name.

        Args:
            number: the camera's frame number, for counting losses.
            time_ms: milliseconds of a clock that all streams share.
        """
        count = self.counts[stream]
        count.arrived += 1
        if stream in self._last:
            number_before, time_before = self._last[stream]
            if time_ms <= time_before:  # twice the same, or out of order
                count.single += 1
                return
            # A counter that starts anew, after a reset, is no loss.
            if number > number_before + 1:
                count.lost += number - number_before - 1
        self._last[stream] = (number, time_ms)
        self._waiting[stream].append((time_ms, image))
        yield from self._complete()

    def _complete(self) -> Iterator[dict[str, Any]]:
        leader, others = self.streams[0], self.streams[1:]
        while self._waiting[leader]:
            time_ms, image = self._waiting[leader][0]
            found: dict[str, Any] = {leader: image}
            for name in others:
                waiting = self._waiting[name]
                # Those that are nearer to no later leader than to this one, but too old for it.
                while len(waiting) > 1 and abs(waiting[1][0] - time_ms) <= abs(
                    waiting[0][0] - time_ms
                ):
                    waiting.popleft()
                    self.counts[name].single += 1
                if waiting and waiting[0][0] < time_ms - self.period_ms / 2:
                    waiting.popleft()
                    self.counts[name].single += 1
                if not waiting:
                    if self._is_past(name, time_ms):
                        break
                    return  # its image is still on the way
                if waiting[0][0] > time_ms + self.period_ms / 2:
                    break
                if len(waiting) == 1 and waiting[0][0] < time_ms - self.period_ms / 4:
                    return  # a nearer one may come
                found[name] = waiting[0][1]
            self._waiting[leader].popleft()
            if len(found) < len(self.streams):
                self.counts[leader].single += 1
                continue
            for name in others:
                self._waiting[name].popleft()
            yield found

    def _is_past(self, name: str, time_ms: float) -> bool:
        """A stream that has gone on cannot bring an image for this time any more."""
        return name in self._last and self._last[name][1] >= time_ms + self.period_ms / 2

    def finish(self) -> Iterator[dict[str, Any]]:
        """Sets that were waiting for something nearer; nothing comes any more."""
        leader, others = self.streams[0], self.streams[1:]
        for time_ms, image in self._waiting[leader]:
            found = {leader: image}
            for name in others:
                near = [w for w in self._waiting[name] if abs(w[0] - time_ms) <= self.period_ms / 2]
                if near:
                    best = min(near, key=lambda w: abs(w[0] - time_ms))
                    self._waiting[name].remove(best)
                    found[name] = best[1]
            if len(found) == len(self.streams):
                yield found
            else:
                self.counts[leader].single += 1
        self._waiting[leader].clear()
        for name in others:
            self.counts[name].single += len(self._waiting[name])
            self._waiting[name].clear()
