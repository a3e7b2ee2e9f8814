"""Entry point of `std-curate`: one module per subcommand, errors as one line."""

from __future__ import annotations

import argparse
import importlib
import logging
import sys
from collections.abc import Sequence

from std_toolkit import __version__
from std_toolkit.cli.command import exit_status
from std_toolkit.log import log_to_stderr

# In the order of the work. Each module has add_parser(subparsers) and run(args) -> exit status.
COMMANDS = (
    "import_",
    "info",
    "poses",
    "trajectory",
    "label",
    "propagate",
    "render",
    "check",
    "export",
    "run",
    "schema",
)


def build_parser() -> argparse.ArgumentParser:
    """The parser with all subcommands; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-curate",
        description="Curate an RGB-D recording of specular, transparent and diffuse objects: "
        "camera poses in metres, 6D labels, ground truth, checks, export.",
    )
    parser.add_argument("--version", action="version", version=f"std-toolkit {__version__}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser.add_argument("--quiet", action="store_true", help="print warnings and errors only")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in COMMANDS:
        importlib.import_module(f"std_toolkit.cli.{name}").add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. Exit status: 0 done, 1 a failure or failed gate, 2 bad usage."""
    args = build_parser().parse_args(argv)
    log_to_stderr(logging.WARNING if args.quiet else logging.INFO)
    return exit_status(lambda: args.run(args), program="std-curate", debug=args.debug)


if __name__ == "__main__":
    sys.exit(main())
