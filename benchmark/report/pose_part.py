"""Poses in a report: of categories, and of known objects."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from benchmark.pose_running.bop_results import BopResult, bop_table, read_bop_figures
from benchmark.pose_running.results import read_pose_results
from benchmark.report import pose_sections as sections
from benchmark.report.part import PageSection, ReportPart
from benchmark.report.pose_answer import answer
from benchmark.report.pose_board import PROTOCOLS, PoseBoard, make_pose_board
from benchmark.report.pose_text import pose_csv, pose_latex, pose_markdown, pose_terminal
from std_toolkit.checks.markup import Cell, amount, paragraph, percent, table, words

CSV, MARKDOWN, LATEX = "poses.csv", "poses.md", "poses.tex"


def pose_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:
    """Poses of categories; see `ReportTask`.

    Raises:
        ToolkitError: a run is damaged, or no frame has a true object.
    """
    board = make_pose_board(read_pose_results(folders), published=published)
    return ReportPart(
        title="Category-level pose",
        summary=sections.pose_summary(board),
        sections=_sections(board),
        answer=answer(board),
        terminal=pose_terminal(board),
        files={CSV: pose_csv(board), MARKDOWN: pose_markdown(board), LATEX: pose_latex(board)},
    )


def bop_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:  # noqa: ARG001
    """Poses of known objects; see `ReportTask`. Papers print none of the data sets here.

    Raises:
        ToolkitError: a file is damaged.
    """
    results = read_bop_figures(folders)
    best = max(results, key=lambda r: r.ar)
    return ReportPart(
        title="Pose of known objects",
        summary=words(f"Highest AR: {best.results}, {100 * best.ar:.1f} % on {_data(best)}."),
        sections=[PageSection("bop", "Poses of known objects (BOP)", _bop_table(results))],
        terminal=bop_table(results),
    )


def _sections(board: PoseBoard) -> list[PageSection]:
    found = []
    for i, split in enumerate(board.splits):
        for protocol in PROTOCOLS:
            html = sections.pose_tables(board, split, protocol)
            title = f"Poses: {split}, protocol {protocol}"
            found.append(PageSection(f"pose-{i}-{protocol}", title, html))
    for i, split in enumerate(board.splits):
        html = sections.breakdown(board, split)
        found.append(PageSection(f"pose-detail-{i}", f"Poses in detail: {split}", html))
    return [
        *found,
        PageSection("pose-gallery", "Boxes", sections.pose_gallery(board)),
        PageSection("pose-runs", "What ran: poses", sections.pose_runs(board.results)),
    ]


def _bop_table(results: Sequence[BopResult]) -> str:
    heads = ("results", "data", "targets", "estimates", "AR", "VSD", "MSSD", "MSPD", "s/image")
    rows = [
        [
            Cell(escape(r.results)),
            Cell(escape(_data(r))),
            Cell(str(r.targets), numeric=True),
            Cell(str(r.estimates), numeric=True),
            *(percent(x, 1) for x in (r.ar, r.ar_vsd, r.ar_mssd, r.ar_mspd)),
            amount(r.seconds_per_image, 2),
        ]
        for r in sorted(results, key=lambda r: -r.ar)
    ]
    about = "Average recalls as the BOP Challenge defines them; AR is the mean of the three."
    return paragraph(about) + table([(head, "") for head in heads], rows)


def _data(result: BopResult) -> str:
    return f"{Path(result.data).resolve().name}, {result.split}"
