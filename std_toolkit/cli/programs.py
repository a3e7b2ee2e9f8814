"""The console scripts, and `python -m std_toolkit.cli.programs std-bench ...`.

All of them start here, so that the other packages of this distribution are found beside this one.
A folder of the user called `benchmark` or `sensors` that precedes them in `sys.path` (the working
folder with `python -m`, or `PYTHONPATH=.`) would hide them. Programs are named, not imported: this
package does not depend on the others.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from std_toolkit.cli.command import Program
from std_toolkit.plugins import install

PROGRAMS: dict[str, str] = {
    "std-annotate": "annotator.cli",
    "std-bench": "benchmark.cli.bench",
    "std-curate": "std_toolkit.cli.main",
    "std-record": "sensors.record.cli",
    "std-report": "benchmark.cli.report",
    "std-restore": "benchmark.cli.restore",
    "std-scan": "std_toolkit.cli.scanning",
    "std-sim": "sensors.simulation.cli",
    "std-train": "benchmark.cli.train",
}


def run(name: str, arguments: Sequence[str] | None = None) -> int:
    """Run a program; returns its exit status."""
    install()
    status: int = import_module(PROGRAMS[name]).main(arguments)
    return status


def annotate() -> int:
    """`std-annotate`."""
    return run("std-annotate")


def bench() -> int:
    """`std-bench`."""
    return run("std-bench")


def curate() -> int:
    """`std-curate`."""
    return run("std-curate")


def record() -> int:
    """`std-record`."""
    return run("std-record")


def report() -> int:
    """`std-report`."""
    return run("std-report")


def restore() -> int:
    """`std-restore`."""
    return run("std-restore")


def scan() -> int:
    """`std-scan`."""
    return run("std-scan")


def simulate() -> int:
    """`std-sim`."""
    return run("std-sim")


def train() -> int:
    """`std-train`."""
    return run("std-train")


if __name__ == "__main__":
    install()
    program: Program = import_module(PROGRAMS[sys.argv[1]]).PROGRAM
    sys.exit(program.main(sys.argv[2:], is_process=True))
