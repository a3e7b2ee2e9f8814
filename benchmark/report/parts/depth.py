"""Depth restoration in a report: leaderboards, breakdowns, speed, pictures, what ran."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmark.evaluation.tasks.depth_results import read_results
from benchmark.report.leaderboard import Board, make_board
from benchmark.report.leaderboard_text import board_csv, board_title, latex, markdown, terminal
from benchmark.report.page import PageSection, ReportPart
from benchmark.report.parts import depth_sections
from benchmark.report.parts.depth_plots import method_colors

CSV, MARKDOWN, LATEX = "leaderboard.csv", "leaderboard.md", "leaderboard.tex"


def depth_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:
    """See `ReportTask`.

    Raises:
        ToolkitError: a run is damaged, or no frame could be scored.
    """
    board = make_board(read_results(folders), published=published)
    return ReportPart(
        title="Depth restoration",
        summary=depth_sections.summary_line(board),
        sections=board_sections(board),
        terminal=terminal(board),
        files={CSV: board_csv(board), MARKDOWN: markdown(board), LATEX: latex(board)},
    )


def board_sections(board: Board) -> list[PageSection]:
    """The sections of a leaderboard."""
    colors = method_colors(board)
    found = []
    for i, (split, protocol) in enumerate(board.boards):
        html = depth_sections.leaderboard(board, split, protocol, colors)
        found.append(PageSection(f"board-{i}", board_title(split, protocol), html))
    for i, (split, protocol) in enumerate(board.boards):
        html = depth_sections.breakdown(board, split, protocol, colors)
        found.append(PageSection(f"detail-{i}", f"In detail: {split}, {protocol}", html))
    return [
        *found,
        PageSection("speed", "Speed", depth_sections.speed(board, colors)),
        PageSection("gallery", "Gallery", depth_sections.gallery(board.results)),
        PageSection("runs", "What ran", depth_sections.runs(board.results)),
    ]
