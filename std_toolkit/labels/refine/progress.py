"""How much of a computation is done, told while it is under way."""

from __future__ import annotations

from collections.abc import Callable

# Told the fraction done, 0 to 1, never less than before. What it raises ends the computation: so
# a computation is cancelled.
Progress = Callable[[float], None]


def untold(_: float) -> None:
    """Nobody asks."""


def part(whole: Progress, start: float, end: float) -> Progress:
    """For a step of a computation that takes it from `start` to `end`."""
    return lambda fraction: whole(start + (end - start) * min(max(fraction, 0.0), 1.0))
