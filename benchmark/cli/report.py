"""`std-report`: leaderboards, a page and a site of what `std-bench` measured."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from benchmark.cli import commands
from std_toolkit.cli.command import Program, print_json
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.door import Writes, has_record, output, own_files

PAGE = "report.html"
NAME = "citations.bib"
_LARGEST_PAGE = 256 * 2**20
_OUT = Writes("files")


@dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """Write tables and a page of one or several folders of results.

    The tables are printed, and written as CSV, Markdown and LaTeX beside report.html.
    citations.bib has the sources of the methods, data sets and protocols.
    """

    results: tuple[Path, ...]
    """folders that std-bench wrote"""
    out: Path | None = field(default=None, metadata={"writes": _OUT})
    """folder of the page (the first folder of results)"""
    published: bool = True
    """the figures that papers print"""
    layout: Literal["boards", "paper"] = "boards"
    """paper: one table of all data sets, each figure of all objects / of specular and transparent
    ones"""
    paired: Literal["scenes", "frames"] = "scenes"
    """over what all pairs of methods are compared"""
    gallery: tuple[str, ...] = ()
    """SCENE/FRAME of the pictures of all methods, in this order (all that the runs have)"""
    latex_rows: tuple[str, ...] = ()
    """methods, depths or data sets whose rows the LaTeX file has (all)"""
    latex_columns: tuple[str, ...] = ()
    """figures that the LaTeX file has, such as rmse (all)"""
    json: bool = False
    """print the tables as JSON"""

    def __post_init__(self) -> None:
        if not self.results:
            raise ToolkitError("needed", field="results")


@dataclass(frozen=True, kw_only=True)
class SiteOptions:
    """Build a leaderboard of static pages, which a browser opens from disk or any server.

    Results are ranked together only if task, content of the data, scored frames, protocol, class
    and series of the toolkit are the same.
    """

    results: tuple[Path, ...]
    """folders that std-bench wrote, of one or several people"""
    out: Path = field(metadata={"option": "out", "writes": Writes("results")})
    """folder of the site"""
    verified: tuple[Path, ...] = ()
    """records of `std-bench verify` that you trust (all figures count as reported)"""
    title: str = "Benchmark"
    """heading of the first page"""
    pictures: bool = True
    """pictures of a few frames of each run"""
    published: bool = True
    """the figures that papers print"""

    def __post_init__(self) -> None:
        if not self.results:
            raise ToolkitError("needed", field="results")


def site(options: SiteOptions) -> int:
    """Build the site; returns the exit status."""
    from benchmark.report.site.build import build_site

    made = build_site(
        options.results, options.out, verified=options.verified, title=options.title,
        pictures=options.pictures, published=options.published,
    )  # fmt: skip
    print(f"{made.index}: {made.runs} results of {made.methods} methods on {made.boards} boards")
    return 0


def _with_command(words: list[str]) -> list[str]:
    """Name the command where folders follow the program, as before there were two."""
    first = next((w for w in words if w not in ("--quiet", "--debug")), None)
    if first is None or first[0] == "-" or first in ("report", "site"):
        return words
    return ["report", *words]


def report(options: ReportOptions) -> int:
    """Write the page; returns the exit status."""
    import pandas as pd

    from benchmark.evaluation.submission import SUBMISSION, read_submission
    from benchmark.published.citations import names_of_runs, write_citations
    from benchmark.report.page import TASKS, Layout, choose_latex, make_parts, render_page
    from std_toolkit.io.atomic import write_bytes_atomic

    layout = Layout(paper=options.layout == "paper", paired=options.paired, gallery=options.gallery)
    parts = make_parts(options.results, published=options.published, layout=layout)
    out = options.out or options.results[0]
    texts = {name: text for part in parts for name, text in part.files.items()}
    texts |= choose_latex(parts, rows=options.latex_rows, columns=options.latex_columns)
    texts[PAGE] = render_page(parts)
    used = names_of_runs(options.results, [task.manifest for task in TASKS])
    of_authors = [
        read_submission(p.parent) for f in options.results for p in sorted(f.rglob(SUBMISSION))
    ]
    said = [found.citation for found in of_authors if found is not None and found.citation]
    names = [*texts, NAME]
    with output(out, _OUT, "std-report"), own_files(out, names, known=_earlier(out, names)):
        for name, text in texts.items():
            write_bytes_atomic(out / name, text.encode())
        write_citations(out, used, said)
    if options.json:
        tables = {Path(name).stem: out / name for name in texts if name.endswith(".csv")}
        print_json({name: pd.read_csv(path).to_dict("records") for name, path in tables.items()})
    else:
        print("\n\n".join(part.terminal for part in parts))
        print(f"\n{out / PAGE}")
    return 0


def _earlier(out: Path, names: list[str]) -> list[str]:
    """The names if an earlier version wrote the files, which kept no record of them."""
    page = out / PAGE
    if has_record(out) or not page.is_file() or page.stat().st_size > _LARGEST_PAGE:
        return [NAME]  # std-bench and std-restore write the same
    return names if b"std-report" in page.read_bytes() else [NAME]


PROGRAM = Program(
    name="std-report",
    about="Tables, a page and a site of what std-bench measured. `std-report RESULTS` writes\n"
    "a page.",
    commands=commands(
        "benchmark.cli.report",
        "benchmark.cli.report",
        ("report", "write tables and a page", "ReportOptions", "report"),
        ("site", "build a leaderboard of static pages", "SiteOptions", "site"),
    ),
    default="report",
    rewrite=_with_command,
)
main = PROGRAM.main

if __name__ == "__main__":
    sys.exit(main())
