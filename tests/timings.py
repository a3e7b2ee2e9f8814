"""What the tests may cost: processor seconds of each package in one run of `make test`.

The time is that of the tests' process and of the child processes that ended; a run over the budget
fails, with the table. The same work takes up to four times as long on a machine that is slow or
shared. Limits are therefore told in units of fixed work, which is measured beside the tests.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections import defaultdict

UNIT = (
    "import argparse, asyncio, unittest.mock, xml.dom.minidom, email.message,"
    " concurrent.futures, multiprocessing.pool, sqlite3, http.client"
)
UNIT_S = 0.1  # of the machine that the budgets are told for

# About twice what a loaded machine of two cores takes.
BUDGET_S = {
    "annotator": 1000.0,
    "benchmark": 1800.0,
    "sensors": 1200.0,
    "std_toolkit": 2200.0,
    "": 450.0,  # files in tests/ itself
}

# Files whose cost is shown.
_SHOWN = 30


def processor_time() -> float:
    """Seconds of this process and of its ended children."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def processor_time_of(code: str) -> float:
    """Seconds that a Python process takes for some code."""
    before = processor_time()
    subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, check=True)
    return processor_time() - before


class Timings:
    """Sums what each package costs.

    Attributes:
        spent_s: processor seconds by package.
        by_file_s: processor seconds by file of tests.
        slowness: of this machine, beside the one that the budgets are told for; at least 1.
    """

    def __init__(self) -> None:
        self.spent_s: defaultdict[str, float] = defaultdict(float)
        self.by_file_s: defaultdict[str, float] = defaultdict(float)
        self.slowness = 1.0
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
        self.by_file_s[nodeid.partition("::")[0]] += seconds

    def measure_slowness(self) -> None:
        """Measure the machine while the tests run; the slowest moment counts."""
        units = sorted(processor_time_of(UNIT) for _ in range(5))
        self.slowness = max(self.slowness, units[2] / UNIT_S)
        self._last = processor_time()

    def budget_s(self, name: str) -> float:
        """Processor seconds that a package may take on this machine."""
        return BUDGET_S[name] * self.slowness

    def table(self) -> list[str]:
        """Lines: package, processor seconds, budget; then the dearest files."""
        rows = sorted(self.spent_s.items(), key=lambda row: -row[1])
        dearest = sorted(self.by_file_s.items(), key=lambda row: -row[1])[:_SHOWN]
        return [
            *(
                f"{name or 'tests':12}{s:8.0f} s of {self.budget_s(name):5.0f} s"
                for name, s in rows
            ),
            *(f"{s:8.0f} s {name}" for name, s in dearest),
        ]

    def over(self) -> list[str]:
        """Packages that cost more than they may."""
        return [name or "tests" for name, s in self.spent_s.items() if s > self.budget_s(name)]
