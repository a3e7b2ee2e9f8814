"""`std-report`: leaderboards and a page of what `std-bench` measured."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from std_toolkit import __version__
from std_toolkit.cli.command import exit_status
from std_toolkit.log import log_to_stderr

PAGE = "report.html"


def build_parser() -> argparse.ArgumentParser:
    """The parser; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-report",
        description="Tables and a page of one or several folders of results: in the terminal, and "
        f"as {PAGE} with CSV, Markdown and LaTeX beside it.",
    )
    add = parser.add_argument
    add("--version", action="version", version=f"std-toolkit {__version__}")
    add("--debug", action="store_true", help="show the traceback of an error")
    add("results", nargs="+", type=Path, metavar="RESULTS", help="folders that std-bench wrote")
    add("--out", type=Path, metavar="DIR", help="where to write (the first folder of results)")
    add("--no-published", action="store_true", help="leave out the figures that papers print")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = build_parser().parse_args(arguments)
    log_to_stderr(logging.INFO)
    return exit_status(lambda: _run(args), program="std-report", debug=args.debug)


def _run(args: argparse.Namespace) -> int:
    from benchmark.report.page import make_parts, render_page
    from std_toolkit.io.atomic import write_bytes_atomic

    parts = make_parts(args.results, published=not args.no_published)
    out = args.out or args.results[0]
    texts = {name: text for part in parts for name, text in part.files.items()}
    for name, text in {**texts, PAGE: render_page(parts)}.items():
        write_bytes_atomic(out / name, text.encode())
    print("\n\n".join(part.terminal for part in parts))
    print(f"\n{out / PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
