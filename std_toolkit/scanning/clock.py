"""The clock of a scan: what each stage took, and how much time is left."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter

import msgspec

from std_toolkit.io.documents import write_document
from std_toolkit.jobs.artefact import read_record
from std_toolkit.log import logger

# Seconds of the stages of one scan, relative to each other: 76 photos of 1280x720 of a bottle.
STAGES = {
    "poses": 86.0, "masks": 148.0, "hull": 6.0, "depth maps": 86.0, "surface": 30.0,
    "texture": 15.0, "symmetry": 8.0, "files": 11.0,
}  # fmt: skip
REVOLVED = {name: STAGES[name] for name in ("poses", "masks", "texture", "symmetry", "files")}
_OF_A_SIDE = ("poses", "masks", "hull", "depth maps")
JOINED = {
    **{name: STAGES[name] for name in _OF_A_SIDE},
    **{f"{name} of the flipped": STAGES[name] for name in _OF_A_SIDE},
    "turn": 40.0, "surface": 45.0, "texture": 25.0, "symmetry": 8.0, "files": 15.0,
}  # fmt: skip

_FILE = "seconds.json"
# A stage that took less than this share of its time before was kept.
_KEPT = 0.3


class Took(msgspec.Struct, frozen=True):
    """`.scan/seconds.json`: seconds of the finished stages, when they were computed."""

    seconds: dict[str, float]


class Clock:
    """Times the stages of a scan and says after each how much time is left.

    Args:
        work: folder that keeps the times.
        stages: usual seconds of all stages; their ratio counts, as machines differ.
        more: seconds of what follows this scan, in the same unit as `stages`.

    Attributes:
        seconds: time of each stage of this run.
        more: as above; it may be set when it is known.
    """

    def __init__(self, work: Path, stages: Mapping[str, float], *, more: float = 0.0) -> None:
        self.seconds: dict[str, float] = {}
        self._path, self._stages, self.more = work / _FILE, dict(stages), more
        before = read_record(self._path, Took)
        self._took = {} if before is None else dict(before.seconds)
        self._began = perf_counter()

    def lap(self, name: str) -> None:
        """End a stage."""
        now = perf_counter()
        self.seconds[name] = now - self._began
        self._began = now
        # A stage that is kept tells nothing of the speed, unless it was timed before.
        if self.seconds[name] > _KEPT * self._took.get(name, 0.0):
            self._took[name] = self.seconds[name]
            write_document(self._path, Took(seconds=self._took))
        left = self.left(list(self.seconds))
        logger.info("%s: %s%s", name, in_words(self.seconds[name]),
                    "" if left is None else f"; about {in_words(left)} left")  # fmt: skip

    def left(self, done: Sequence[str]) -> float | None:
        """Seconds that are left after some stages, by what they took; None for no knowledge."""
        usual = sum(self._stages.get(name, 0.0) for name in done)
        if not usual:
            return None
        took = sum(self._took.get(name, 0.0) for name in done if name in self._stages)
        rest = sum(s for name, s in self._stages.items() if name not in done) + self.more
        return took / usual * rest if rest else None


def in_words(seconds: float) -> str:
    """A time for people.

    >>> in_words(4.4), in_words(100), in_words(260), in_words(4000)
    ('4 s', '100 s', '4 minutes', '1 h 7 min')
    """
    if seconds < 120:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} minutes" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
