"""How figures are written: headings, units, digits, and which way is better."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """A figure of the leaderboard.

    Attributes:
        name: its column.
        heading, unit: as people read it.
        factor: from the stored to the written unit.
        digits: after the point.
        less_is_better: None where neither way is.
        printed_digits: of figures that a paper prints, which has fewer.
    """

    name: str
    heading: str
    unit: str = ""
    factor: float = 1.0
    digits: int = 2
    less_is_better: bool | None = True
    printed_digits: int = 2

    def text(self, value: float | None, *, printed: bool = False) -> str:
        """The figure as it is written; empty where there is none."""
        if value is None or math.isnan(value):
            return ""
        return f"{value * self.factor:.{self.printed_digits if printed else self.digits}f}"

    @property
    def title(self) -> str:
        """Heading and unit."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading


METRICS = (
    Column("rmse", "RMSE", "mm", 1e3, 1, printed_digits=0),
    Column("rel", "REL", "", 1.0, 4, printed_digits=3),
    Column("mae", "MAE", "mm", 1e3, 1, printed_digits=0),
    Column("d105", "δ1.05", "%", 1e2, 2, less_is_better=False),
    Column("d110", "δ1.10", "%", 1e2, 2, less_is_better=False),
    Column("d125", "δ1.25", "%", 1e2, 2, less_is_better=False),
)
COVERAGE = Column("coverage", "answered", "%", 1e2, 2, less_is_better=False)
SPEED = Column("frames_per_s", "speed", "frames/s", 1.0, 1, less_is_better=False)
PARAMETERS = Column("parameters", "parameters", "M", 1e-6, 2, less_is_better=None)
MACS = Column("gmacs", "MACs", "G", 1.0, 1, less_is_better=None)
MEMORY = Column("peak_memory_mib", "peak memory", "MiB", 1.0, 0, less_is_better=None)
COSTS = (SPEED, PARAMETERS, MACS, MEMORY)
BOARD = (*METRICS, COVERAGE)
