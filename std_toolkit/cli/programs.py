"""The console scripts, and `python -m std_toolkit.cli.programs std-bench ...`.

All of them start here, so that the other packages of this distribution are found beside this one.
A folder of the user called `benchmark` or `sensors` that precedes them in `sys.path` (the working
folder with `python -m`, or `PYTHONPATH=.`) would hide them. Programs are named, not imported: this
package does not depend on the others.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

from std_toolkit.log import escape_what_cannot_be_encoded
from std_toolkit.plugins import install

if TYPE_CHECKING:
    from std_toolkit.cli.command import Program

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
    return _load(name).main(arguments)


def _load(name: str) -> Program:
    install()
    escape_what_cannot_be_encoded()
    try:
        program: Program = import_module(PROGRAMS[name]).PROGRAM
    except KeyboardInterrupt:  # a signal is handled once the program runs
        print("interrupted; nothing was begun", file=sys.stderr)
        sys.exit(130)
    return program


# Entry points of the distribution.
annotate = partial(run, "std-annotate")
bench = partial(run, "std-bench")
curate = partial(run, "std-curate")
record = partial(run, "std-record")
report = partial(run, "std-report")
restore = partial(run, "std-restore")
scan = partial(run, "std-scan")
simulate = partial(run, "std-sim")
train = partial(run, "std-train")

if __name__ == "__main__":
    sys.exit(_load(sys.argv[1]).main(sys.argv[2:], is_process=True))
