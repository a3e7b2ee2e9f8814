"""The report: a part for each task, on one self-contained HTML page.

The page: one HTML file that needs nothing but itself.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import pandas as pd

from benchmark.evaluation.manifest import BOP_FILE, GRASP_MANIFEST, MANIFEST, POSE_MANIFEST
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.html.page import Block, Heading, Page, Section, Verdict
from std_toolkit.html.table import Table


@dataclass(frozen=True, kw_only=True)
class ReportPart:
    """All that one task adds.

    Attributes:
        title: what was measured, such as "Depth restoration".
        summary: a sentence for the head of the page.
        sections: of the page, in their order.
        answer: what the task says to whether restoring depth helps, and how sure that is; empty if
            it has nothing to say.
        terminal: tables as text.
        files: further files by name, written beside the page.
    """

    title: str
    summary: str
    sections: Sequence[Section]
    answer: Sequence[Block] = ()
    terminal: str = ""
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ReportTask:
    """A task that reports know.

    Attributes:
        manifest: name of a file that the folder of every run of this task holds, and no other.
        make: `module:function` that makes the part of some folders of results. It is called with
            those that hold such a file, and with `published`: whether figures of papers stand
            beside the measured ones.
    """

    manifest: str
    make: str

    def part(self, folders: Sequence[Path], *, published: bool) -> ReportPart:
        """The part of these folders of results.

        Raises:
            ToolkitError: results that are damaged, or hold nothing.
        """
        module, _, name = self.make.partition(":")
        make: Callable[..., ReportPart] = getattr(importlib.import_module(module), name)
        return make(folders, published=published)


TASKS = (
    ReportTask(MANIFEST, "benchmark.report.parts.depth:depth_part"),
    ReportTask(POSE_MANIFEST, "benchmark.report.parts.pose:pose_part"),
    ReportTask(BOP_FILE, "benchmark.report.parts.pose:bop_part"),
    ReportTask(GRASP_MANIFEST, "benchmark.report.parts.grasp:grasp_part"),
)


def make_parts(folders: Sequence[Path], *, published: bool = True) -> list[ReportPart]:
    """The parts of all tasks that have results in these folders.

    Raises:
        ToolkitError: a folder has none, or what it has cannot be used.
    """
    holds = {
        task: [folder for folder in folders if next(folder.rglob(task.manifest), None) is not None]
        for task in TASKS
    }
    for folder in folders:
        if not any(folder in found for found in holds.values()):
            raise ToolkitError("no results of std-bench here", path=folder)
    return [task.part(found, published=published) for task, found in holds.items() if found]


def render_page(parts: Sequence[ReportPart]) -> str:
    """The parts as HTML; the same results give the same bytes."""
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


def terminal_text(tables: Sequence[Table]) -> str:
    """Tables for a terminal, without intervals and notes; published rows have a star."""
    texts = [replace(table, notes=()).terminal(notes=False) for table in tables]
    if any(row.kind == "published" for table in tables for row in table.rows):
        texts.append("* as printed by the paper, by its own evaluation (protocol paper)")
    return "\n\n".join(texts)


def table_files(
    names: tuple[str, str, str], tables: Sequence[Table], rows: pd.DataFrame
) -> dict[str, str]:
    """Files of names CSV, Markdown and LaTeX: all rows in SI units and shares, and the tables."""
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
