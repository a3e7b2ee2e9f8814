"""The leaderboard of poses as text: terminal, CSV, Markdown, LaTeX."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from benchmark.report.board import MEASURED, PUBLISHED
from benchmark.report.pose_board import FIGURES, PROTOCOLS, TABLES, PoseBoard
from benchmark.report.text import escape_latex
from benchmark.running.aligned import aligned

_HEADS = ("method", "depth", "fit", "objects")


def pose_csv(board: PoseBoard) -> str:
    """Every row and column; figures are shares."""
    return board.rows.to_csv(index=False, lineterminator="\n")


def pose_terminal(board: PoseBoard) -> str:
    """The tables for a terminal; published rows have a star."""
    blocks = []
    for title, rows in _tables(board):
        lines = [[*_HEADS, *(c.heading for c in FIGURES)], *_cells(rows)]
        blocks.append(f"{title}, poses right in %\n{aligned(lines, texts=len(_HEADS))}")
    if (board.rows["kind"] == PUBLISHED).any():
        blocks.append("* as printed by the paper, by its own evaluation (protocol paper).")
    return "\n\n".join(blocks)


def pose_markdown(board: PoseBoard) -> str:
    """The tables as GitHub's Markdown; published rows in italics."""
    blocks = []
    for title, rows in _tables(board):
        lines = [
            "| " + " | ".join([*_HEADS, *(f"{c.heading} [%]" for c in FIGURES)]) + " |",
            "|---|---|---|---|" + "---:|" * len(FIGURES),
        ]
        for cells in _cells(rows, star=False):
            printed = not cells[1]
            shown = [cell.replace("|", r"\|") for cell in cells]
            if printed:
                shown = [f"*{cell}*" if cell else "" for cell in shown]
            lines.append("| " + " | ".join(shown) + " |")
        blocks.append("\n".join([f"### {title}", "", *lines]))
    if (board.rows["kind"] == PUBLISHED).any():
        blocks.append("Italics: as printed by the paper, by its own evaluation (protocol paper).")
    return "\n\n".join(blocks) + "\n"


def pose_latex(board: PoseBoard) -> str:
    """The tables as LaTeX with booktabs; published rows in italics."""
    blocks = []
    for title, rows in _tables(board):
        heads = " & ".join(escape_latex(t) for t in (*_HEADS, *(c.heading for c in FIGURES)))
        heads = heads.replace("°", r"$^\circ$")
        lines = [
            r"\begin{table}[t]",
            r"\centering",
            rf"\caption{{{escape_latex(title)}, poses right in \%}}",
            rf"\begin{{tabular}}{{llll{'r' * len(FIGURES)}}}",
            r"\toprule",
            rf"{heads} \\",
            r"\midrule",
        ]
        for cells in _cells(rows, star=False):
            shown = [escape_latex(cell) for cell in cells]
            if not cells[1]:
                shown = [rf"\textit{{{cell}}}" if cell else "" for cell in shown]
            lines.append(" & ".join(shown) + r" \\")
        lines += [r"\bottomrule", r"\end{tabular}", r"\end{table}"]
        blocks.append("\n".join(lines))
    return (
        "% needs \\usepackage{booktabs}; italics: as printed by the paper\n"
        + "\n\n".join(blocks)
        + "\n"
    )


def _tables(board: PoseBoard) -> Iterator[tuple[str, pd.DataFrame]]:
    for split in board.splits:
        for protocol in PROTOCOLS:
            parts = [board.part(split, protocol, subset) for subset in TABLES]
            rows = pd.concat(parts, ignore_index=True)
            if (rows["kind"] == MEASURED).any():
                yield f"{split}, protocol {protocol}", rows


def _cells(rows: pd.DataFrame, *, star: bool = True) -> list[list[str]]:
    found = []
    for row in rows.to_dict("records"):
        printed = row["kind"] == PUBLISHED
        mark = "* " if printed and star else ""
        figures = [c.text(row[c.name], printed=printed) for c in FIGURES]
        found.append([f"{mark}{row['method']}", row["depth"], row["fit"], row["subset"], *figures])
    return found
