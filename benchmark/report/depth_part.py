"""Depth restoration in a report: leaderboards, breakdowns, speed, pictures, what ran."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmark.report import sections
from benchmark.report.board import Board, make_board
from benchmark.report.part import PageSection, ReportPart
from benchmark.report.plots import method_colors
from benchmark.report.text import board_csv, board_title, latex, markdown, terminal
from benchmark.running.results import read_results

CSV, MARKDOWN, LATEX = "leaderboard.csv", "leaderboard.md", "leaderboard.tex"


def depth_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:
    """See `ReportTask`.

    Raises:
        ToolkitError: a run is damaged, or no frame could be scored.
    """
    board = make_board(read_results(folders), published=published)
    return ReportPart(
        title="Depth restoration",
        summary=sections.summary_line(board),
        sections=board_sections(board),
        terminal=terminal(board),
        files={CSV: board_csv(board), MARKDOWN: markdown(board), LATEX: latex(board)},
    )


def board_sections(board: Board) -> list[PageSection]:
    """The sections of a leaderboard."""
    colors = method_colors(board)
    found = []
    for i, (split, protocol) in enumerate(board.boards):
        html = sections.leaderboard(board, split, protocol, colors)
        found.append(PageSection(f"board-{i}", board_title(split, protocol), html))
    for i, (split, protocol) in enumerate(board.boards):
        html = sections.breakdown(board, split, protocol, colors)
        found.append(PageSection(f"detail-{i}", f"In detail: {split}, {protocol}", html))
    return [
        *found,
        PageSection("speed", "Speed", sections.speed(board, colors)),
        PageSection("gallery", "Gallery", sections.gallery(board.results)),
        PageSection("runs", "What ran", sections.runs(board.results)),
    ]
