"""What the tests may cost: processor seconds of each package in one run of `make test`.

Processor time hardly depends on what else the machine does. It is that of the tests' process and of
the child processes that ended; a run over the budget fails, with the table.
"""

from __future__ import annotations

import resource
import time
from collections import defaultdict

# About twice what a loaded machine of two cores takes.
BUDGET_S = {
    "annotator": 1000.0,
    "benchmark": 1800.0,
    "sensors": 1200.0,
    "std_toolkit": 2200.0,
    "": 450.0,  # files in tests/ itself
}


def processor_time() -> float:
    """Seconds of this process and of its ended children."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


class Timings:
    """Sums what each package costs."""

    def __init__(self) -> None:
        self.spent_s: defaultdict[str, float] = defaultdict(float)
        self._last = processor_time()

    def lap(self) -> float:
        """Processor seconds since the last call."""
        now = processor_time()
        lap, self._last = now - self._last, now
        return lap

    def add(self, nodeid: str, seconds: float) -> None:
        """Count a part of a test for its package."""
        _, folder, *_ = f"{nodeid}//".split("/")
        self.spent_s[folder if folder in BUDGET_S else ""] += seconds

    def table(self) -> list[str]:
        """Lines: package, processor seconds, budget."""
        rows = sorted(self.spent_s.items(), key=lambda row: -row[1])
        return [f"{name or 'tests':12}{s:8.0f} s of {BUDGET_S[name]:5.0f} s" for name, s in rows]

    def over(self) -> list[str]:
        """Packages that cost more than they may."""
        return [name or "tests" for name, s in self.spent_s.items() if s > BUDGET_S[name]]
