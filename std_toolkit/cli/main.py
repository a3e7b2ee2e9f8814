"""Entry point of `std-curate`: one module per subcommand, errors as one line."""

from __future__ import annotations

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Sequence

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
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
    try:
        return int(args.run(args))
    except ToolkitError as error:
        if args.debug:
            raise
        print(f"error: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        # `std-curate info SCENE | head` is no error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if args.debug:
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(f"error: {where}{error.strerror or error}", file=sys.stderr)
        return 1
    except Exception as error:  # a defect of ours: still one line, and how to tell us more
        if args.debug:
            raise
        shown = ToolkitError(
            f"unexpected {type(error).__name__}: {error}",
            hint="a defect of std-toolkit; `std-curate --debug ...` shows where",
        )
        print(f"error: {shown}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; run the same command again to go on", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
