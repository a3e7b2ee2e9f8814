"""Entry point of `std-scan`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from std_toolkit.cli.command import Command, Program

if TYPE_CHECKING:
    from std_toolkit.scanning.options import ScanOptions


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command. Exit status: 0 done, 1 a failure, 2 wrong usage."""
    return PROGRAM.main(arguments)


def run_scan(options: ScanOptions) -> int:
    """Scan and print where the model is."""
    from std_toolkit.scanning.scan_step import scan

    result = scan(options)
    for line in result.warnings:
        print(f"warning: {line}", file=sys.stderr)
    print(f"{options.out / result.name}.obj: {len(result.faces)} faces")
    for name, value in result.facts.items():
        print(f"  {name}: {value}")
    print(f"report: {options.out / 'report.html'}")
    return 0


PROGRAM = Program(
    name="std-scan",
    about="Make a metric, watertight, textured CAD model of an object from photos.",
    commands=(
        Command(
            name="photos",
            about="make the model from photos of the object on the printed board",
            options="std_toolkit.scanning.options:ScanOptions",
            run="std_toolkit.scanning.cli:run_scan",
        ),
    ),
)


if __name__ == "__main__":
    sys.exit(main())
