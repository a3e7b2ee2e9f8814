"""The report: one self-contained HTML page with a part for each task."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from benchmark.evaluation.manifest import (
    BOP_FILE,
    DUMP_MANIFEST,
    GRASP_MANIFEST,
    MANIFEST,
    ORDER_MANIFEST,
    POSE_MANIFEST,
)
from benchmark.evaluation.query_options import AUDIT_FILE
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.html.page import Block, Heading, Page, Paragraph, Section, Verdict
from std_toolkit.html.table import Table

# Heading of the last column of leaderboards: sources of published rows, and what is not different.
NOTES = "notes"

# Runs of a task whose pictures are on the page: pictures of more would exceed 20 MB.
MOST_PICTURED = 30


@dataclass(frozen=True, kw_only=True)
class Layout:
    """What authors choose of a report.

    Attributes:
        paper: one table of all data sets by a protocol, each figure of all objects and of specular
            and transparent ones, in place of the leaderboards in terminal, Markdown and LaTeX.
        paired: over what the pairs of methods are compared.
        gallery: SCENE/FRAME of the common pictures; empty for all that the runs have.
    """

    paper: bool = False
    paired: Literal["scenes", "frames"] = "scenes"
    gallery: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ReportPart:
    """Part of one task.

    Attributes:
        title: name of the task, such as "Depth restoration".
        summary: a sentence for the head of the page.
        sections: sections of the page, in order.
        answer: whether restored depth helps in this task, with the uncertainty; empty if the task
            does not measure it.
        terminal: tables as text.
        files: further files by name, written next to the page.
        latex: name of the LaTeX file among them, if there is one.
        tables: the tables in it.
    """

    title: str
    summary: str
    sections: Sequence[Section]
    answer: Sequence[Block] = ()
    terminal: str = ""
    files: Mapping[str, str] = field(default_factory=dict)
    latex: str = ""
    tables: Sequence[Table] = ()


@dataclass(frozen=True)
class ReportTask:
    """A task with a report part.

    Attributes:
        manifest: name of a file in the folder of every run of this task, and of no other task.
        make: `module:function` that creates the part. It is called with the result folders that
            have such a file, and with `published`: whether to include figures of papers.
        laid_out: whether it is also called with `layout`.
    """

    manifest: str
    make: str
    laid_out: bool = False

    def part(self, folders: Sequence[Path], *, published: bool, layout: Layout) -> ReportPart:
        """Create the part for these folders of results.

        Raises:
            ToolkitError: results are damaged or empty.
        """
        module, _, name = self.make.partition(":")
        make: Callable[..., ReportPart] = getattr(importlib.import_module(module), name)
        chosen: dict[str, Any] = {"layout": layout} if self.laid_out else {}
        return make(folders, published=published, **chosen)


TASKS = (
    ReportTask(MANIFEST, "benchmark.report.parts.depth:depth_part", laid_out=True),
    ReportTask(POSE_MANIFEST, "benchmark.report.parts.pose:pose_part", laid_out=True),
    ReportTask(BOP_FILE, "benchmark.report.parts.pose:bop_part"),
    ReportTask(GRASP_MANIFEST, "benchmark.report.parts.grasp:grasp_part"),
    ReportTask(DUMP_MANIFEST, "benchmark.report.parts.grasp_dump:dump_part"),
    ReportTask(ORDER_MANIFEST, "benchmark.report.parts.order:order_part"),
    ReportTask(AUDIT_FILE, "benchmark.report.parts.audit:audit_part"),
)


def make_parts(
    folders: Sequence[Path], *, published: bool = True, layout: Layout | None = None
) -> list[ReportPart]:
    """Create the parts of all tasks that have results in these folders.

    Args:
        folders: of results.
        published: include the figures that papers print.
        layout: what authors choose; None for the defaults.

    Raises:
        ToolkitError: a folder has no results, or results that cannot be used.
    """
    holds = {
        task: [folder for folder in folders if next(folder.rglob(task.manifest), None) is not None]
        for task in TASKS
    }
    for folder in folders:
        if not any(folder in found for found in holds.values()):
            raise ToolkitError("no results of std-bench here", path=folder)
    layout = layout or Layout()
    return [
        task.part(found, published=published, layout=layout)
        for task, found in holds.items()
        if found
    ]


def markdown_tables(folders: Sequence[Path]) -> str:
    """Return the Markdown tables of all tasks that have results in these folders; may be none.

    Raises:
        ToolkitError: as `make_parts`.
    """
    files = [item for part in make_parts(folders) for item in part.files.items()]
    return "\n\n".join(text for name, text in files if name.endswith(".md"))


def render_page(parts: Sequence[ReportPart]) -> str:
    """Render the parts as HTML; the same results give the same bytes."""
    titles = [part.title for part in parts]
    title = ", ".join([titles[0], *(t[:1].lower() + t[1:] for t in titles[1:])])
    answers = [block for p in parts if p.answer for block in (Heading(p.title), *p.answer)]
    question = "Does restoring depth help, and how certain is it?"
    files = ", ".join(f"`{name}`" for part in parts for name in part.files)
    return Page(
        kind="Benchmark",
        title=title,
        tab_title=f"Benchmark: {title}",
        verdicts=[Verdict(part.summary) for part in parts],
        sections=[
            Section("does-it-help", question, answers),
            *(section for part in parts for section in part.sections),
        ],
        footer=f"std-toolkit {__version__}, `std-report`. The same figures: {files}.",
    ).html()


def left_out(runs: int, folder: str) -> list[Paragraph]:
    """Return a note on the runs whose pictures are not on the page.

    Args:
        runs: number of runs with pictures.
        folder: name of the folder of pictures in each run.
    """
    if runs <= MOST_PICTURED:
        return []
    text = (
        f"Pictures of {MOST_PICTURED} of {runs} runs; the others are in the folder `{folder}` of "
    )
    return [Paragraph(f"{text}each run.")]


def terminal_text(tables: Sequence[Table]) -> str:
    """Format tables for a terminal, without intervals and notes; published rows have a star."""
    texts = [replace(table, notes=()).without(NOTES).terminal(notes=False) for table in tables]
    if any(row.kind == "published" for table in tables for row in table.rows):
        texts.append("* as printed, by this protocol; sources: std-bench list published")
    return "\n\n".join(texts)


def table_files(
    names: tuple[str, str, str], tables: Sequence[Table], rows: pd.DataFrame
) -> dict[str, str]:
    """Return the contents of the CSV, Markdown and LaTeX files by name.

    The CSV file has all rows in SI units and fractions; the others have the tables.
    """
    csv, markdown, latex = names
    return {
        csv: rows.to_csv(index=False, lineterminator="\n"),
        markdown: "\n\n".join(
            [*(table.markdown() for table in tables), f"{_LEGEND.capitalize()}.\n"]
        ),
        latex: latex_text(tables),
    }


_LEGEND = "italics: as printed by the paper"


def latex_text(tables: Sequence[Table]) -> str:
    """Return tables as a LaTeX file."""
    head = f"% needs \\usepackage{{booktabs}}; {_LEGEND}"
    return "\n\n".join([head, *(table.latex() for table in tables)]) + "\n"


def choose_latex(
    parts: Sequence[ReportPart], *, rows: Sequence[str], columns: Sequence[str]
) -> dict[str, str]:
    """Return the LaTeX files with the named rows and columns alone, by file name.

    Args:
        parts: of the report.
        rows: texts of a cell that is no figure, such as the method; empty for all.
        columns: headings or names of figures; empty for all. Columns of text stay.

    Returns:
        The files; tables without any of the rows or columns are left out.

    Raises:
        ToolkitError: no table has such a row or column.
    """
    tables = [t for part in parts for t in part.tables]
    for what, wanted, known in (
        ("--latex-rows", rows, [name for t in tables for name in t.row_names]),
        ("--latex-columns", columns, [name for t in tables for name in t.figure_names]),
    ):
        for name in wanted:
            if name not in known:
                raise ToolkitError(
                    "no table has it",
                    field=what,
                    value=name,
                    hint=f"known: {', '.join(dict.fromkeys(known))}",
                )
    return {
        part.latex: latex_text([t for t in (t.chosen(rows, columns) for t in part.tables) if t])
        for part in parts
        if part.latex
    }
