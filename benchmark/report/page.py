"""The report: one self-contained HTML page with a part for each task."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

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

# Runs of a task whose pictures are on the page: pictures of more would exceed 20 MB.
MOST_PICTURED = 30


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
    """

    title: str
    summary: str
    sections: Sequence[Section]
    answer: Sequence[Block] = ()
    terminal: str = ""
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ReportTask:
    """A task with a report part.

    Attributes:
        manifest: name of a file in the folder of every run of this task, and of no other task.
        make: `module:function` that creates the part. It is called with the result folders that
            have such a file, and with `published`: whether to include figures of papers.
    """

    manifest: str
    make: str

    def part(self, folders: Sequence[Path], *, published: bool) -> ReportPart:
        """Create the part for these folders of results.

        Raises:
            ToolkitError: results are damaged or empty.
        """
        module, _, name = self.make.partition(":")
        make: Callable[..., ReportPart] = getattr(importlib.import_module(module), name)
        return make(folders, published=published)


TASKS = (
    ReportTask(MANIFEST, "benchmark.report.parts.depth:depth_part"),
    ReportTask(POSE_MANIFEST, "benchmark.report.parts.pose:pose_part"),
    ReportTask(BOP_FILE, "benchmark.report.parts.pose:bop_part"),
    ReportTask(GRASP_MANIFEST, "benchmark.report.parts.grasp:grasp_part"),
    ReportTask(DUMP_MANIFEST, "benchmark.report.parts.grasp_dump:dump_part"),
    ReportTask(ORDER_MANIFEST, "benchmark.report.parts.order:order_part"),
    ReportTask(AUDIT_FILE, "benchmark.report.parts.audit:audit_part"),
)


def make_parts(folders: Sequence[Path], *, published: bool = True) -> list[ReportPart]:
    """Create the parts of all tasks that have results in these folders.

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
    return [task.part(found, published=published) for task, found in holds.items() if found]


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
    texts = [replace(table, notes=()).terminal(notes=False) for table in tables]
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
    legend = "italics: as printed by the paper"
    return {
        csv: rows.to_csv(index=False, lineterminator="\n"),
        markdown: "\n\n".join(
            [*(table.markdown() for table in tables), f"{legend.capitalize()}.\n"]
        ),
        latex: "\n\n".join(
            [f"% needs \\usepackage{{booktabs}}; {legend}", *(table.latex() for table in tables)]
        )
        + "\n",
    }
