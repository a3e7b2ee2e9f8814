"""`std-report`: leaderboards and a page of what `std-bench` measured."""

import sys
from dataclasses import dataclass
from pathlib import Path

from benchmark.cli import commands
from std_toolkit.cli.command import Program, print_json
from std_toolkit.errors import ToolkitError

PAGE = "report.html"


@dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """Write tables and a page of one or several folders of results.

    The tables are printed, and written as CSV, Markdown and LaTeX beside report.html.
    citations.bib has the sources of the methods, data sets and protocols.
    """

    results: tuple[Path, ...]
    """folders that std-bench wrote"""
    out: Path | None = None
    """folder of the page (the first folder of results)"""
    published: bool = True
    """the figures that papers print"""
    json: bool = False
    """print the tables as JSON"""

    def __post_init__(self) -> None:
        if not self.results:
            raise ToolkitError("needed", field="results")


def report(options: ReportOptions) -> int:
    """Write the page; returns the exit status."""
    import pandas as pd

    from benchmark.published.citations import names_of_runs, write_citations
    from benchmark.report.page import TASKS, make_parts, render_page
    from std_toolkit.io.atomic import write_bytes_atomic

    parts = make_parts(options.results, published=options.published)
    out = options.out or options.results[0]
    texts = {name: text for part in parts for name, text in part.files.items()}
    for name, text in {**texts, PAGE: render_page(parts)}.items():
        write_bytes_atomic(out / name, text.encode())
    write_citations(out, names_of_runs(options.results, [task.manifest for task in TASKS]))
    if options.json:
        tables = {Path(name).stem: out / name for name in texts if name.endswith(".csv")}
        print_json({name: pd.read_csv(path).to_dict("records") for name, path in tables.items()})
    else:
        print("\n\n".join(part.terminal for part in parts))
        print(f"\n{out / PAGE}")
    return 0


PROGRAM = Program(
    name="std-report",
    about="Tables and a page of what std-bench measured.",
    commands=commands(
        "benchmark.cli.report",
        "benchmark.cli.report",
        ("report", "write tables and a page", "ReportOptions", "report"),
    ),
)
main = PROGRAM.main

if __name__ == "__main__":
    sys.exit(main())
