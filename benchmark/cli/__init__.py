"""Commands of the benchmark: the table of a program, and its list of failures."""

import sys
from collections.abc import Mapping

from std_toolkit.cli.command import Command


def commands(module: str, options: str, *rows: tuple[str, str, str, str]) -> tuple[Command, ...]:
    """Return the commands of a program.

    Args:
        module: whose functions run.
        options: module of the options that are given without one.
        rows: name, line for the help, class of the options (or `module:Class`), and function of
            each command.
    """
    return tuple(
        Command(
            name=name,
            about=about,
            options=chosen if ":" in chosen else f"{options}:{chosen}",
            run=f"{module}:{run}",
        )
        for name, about, chosen, run in rows
    )


def report_failures(failed: Mapping[str, str], prefix: str = "") -> int:
    """Print a line for each failure; returns the exit status."""
    for key, error in failed.items():
        print(f"error: {prefix}{key}: {error}", file=sys.stderr)
    return 1 if failed else 0
