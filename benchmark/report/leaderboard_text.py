"""The leaderboard as text: terminal, CSV, Markdown, LaTeX."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from benchmark.evaluation.results import aligned
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.report.leaderboard import BOARD, PUBLISHED, SIGNIFICANT, Board, Column, one_of_each

# Of the subsets that were measured, those that the short tables show.
MAIN_SUBSETS = ("all", "specular+transparent")
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "δ": r"$\delta$",
}  # fmt: skip


def board_csv(board: Board) -> str:
    """Every row and column, in the units of the results: metres and shares."""
    return board.rows.to_csv(index=False, lineterminator="\n")


def terminal(board: Board) -> str:
    """The main tables for a terminal; published rows have a star."""
    blocks = []
    for title, rows, columns in _tables(board):
        cells = [["method", "objects", *(c.title for c in columns)], *_cells(rows, columns, "* ")]
        blocks.append(f"{title}\n{aligned(cells)}")
    if (board.rows["kind"] == PUBLISHED).any():
        blocks.append(f"* as printed by the paper. {caution(board)}".rstrip())
    return "\n\n".join(blocks)


def markdown(board: Board) -> str:
    """The main tables as GitHub's Markdown; published rows in italics."""
    blocks = []
    for title, rows, columns in _tables(board):
        best = best_figures(rows, columns)
        lines = [
            "| " + " | ".join(["method", "objects", *(c.title for c in columns)]) + " |",
            "|---|---|" + "---:|" * len(columns),
        ]
        for row in rows.itertuples():
            printed = row.kind == PUBLISHED
            name = row.method.replace("|", r"\|")
            cells = [f"*{name}* (published)" if printed else name, row.subset]
            for column in columns:
                text = column.text(getattr(row, column.name), printed=printed)
                if text and printed:
                    text = f"*{text}*"
                elif text and (row.Index, column.name) in best:
                    text = f"**{text}**"
                cells.append(text)
            lines.append("| " + " | ".join(cells) + " |")
        blocks.append("\n".join([f"### {title}", "", *lines]))
    if (board.rows["kind"] == PUBLISHED).any():
        blocks.append(f"Bold: best measured. Italics: as printed by the paper. {caution(board)}")
    return "\n\n".join(blocks).rstrip() + "\n"


def latex(board: Board) -> str:
    """The main tables as LaTeX with booktabs; published rows in italics."""
    blocks = []
    for title, rows, columns in _tables(board):
        best = best_figures(rows, columns)
        heading = " & ".join(escape_latex(t) for t in ("method", "objects", *_titles(columns)))
        lines = [
            r"\begin{table}[t]",
            r"\centering",
            rf"\caption{{{escape_latex(title)}}}",
            rf"\begin{{tabular}}{{ll{'r' * len(columns)}}}",
            r"\toprule",
            rf"{heading} \\",
            r"\midrule",
        ]
        for row in rows.itertuples():
            printed = row.kind == PUBLISHED
            name = escape_latex(row.method)
            cells = [rf"\textit{{{name}}}" if printed else name, escape_latex(row.subset)]
            for column in columns:
                text = column.text(getattr(row, column.name), printed=printed)
                if text and printed:
                    text = rf"\textit{{{text}}}"
                elif text and (row.Index, column.name) in best:
                    text = rf"\textbf{{{text}}}"
                cells.append(text)
            lines.append(" & ".join(cells) + r" \\")
        lines += [r"\bottomrule", r"\end{tabular}", r"\end{table}"]
        blocks.append("\n".join(lines))
    head = "% needs \\usepackage{booktabs}; italics: as printed by the paper; bold: best measured\n"
    return head + "\n\n".join(blocks) + "\n"


def escape_latex(text: str) -> str:
    """Text with the characters that mean something to LaTeX made plain."""
    return "".join(_LATEX.get(c, c) for c in text)


def board_title(split: str, protocol: str) -> str:
    """What a table is of."""
    return f"{split}, protocol {protocol}, {get_protocol(protocol).main[0]}"


def printed_where(row: object) -> str:
    """Where a published row is printed, and what was trained on: papers print a method several
    times, by another training or once more."""
    training = getattr(row, "training_data", "")
    table = str(getattr(row, "table", ""))
    return f"{table}; trained on {training}" if isinstance(training, str) and training else table


def not_worse(row: object) -> bool:
    """Whether the best method may be better than this one by chance alone."""
    p = getattr(row, "p_best", float("nan"))
    return bool(p >= SIGNIFICANT)


def _tables(board: Board) -> list[tuple[str, pd.DataFrame, Sequence[Column]]]:
    found: list[tuple[str, pd.DataFrame, Sequence[Column]]] = []
    for split, protocol in board.boards:
        grid, first = get_protocol(protocol).main
        subsets = dict.fromkeys((first, *MAIN_SUBSETS))
        rows = pd.concat(
            [one_of_each(board.part(split, protocol, grid, subset)) for subset in subsets],
            ignore_index=True,
        )
        found.append((board_title(split, protocol), rows, BOARD))
    return found


def _cells(rows: pd.DataFrame, columns: Sequence[Column], mark: str) -> list[list[str]]:
    return [
        [
            (mark if row.kind == PUBLISHED else "") + row.method,
            row.subset,
            *(c.text(getattr(row, c.name), printed=row.kind == PUBLISHED) for c in columns),
        ]
        for row in rows.itertuples()
    ]


def _titles(columns: Sequence[Column]) -> list[str]:
    return [column.title for column in columns]


def best_figures(rows: pd.DataFrame, columns: Sequence[Column]) -> set[tuple[int, str]]:
    """Index and column of the best measured figures of each subset."""
    found = set()
    measured = rows[rows["kind"] != PUBLISHED]
    for _, block in measured.groupby("subset", sort=False):
        for column in columns:
            if column.less_is_better is None or block[column.name].isna().all():
                continue
            values = block[column.name]
            top = values.min() if column.less_is_better else values.max()
            found |= {(int(i), column.name) for i in block.index[values == top]}
    return found


def caution(board: Board) -> str:
    """What to keep in mind where published figures stand beside measured ones; maybe nothing."""
    others = [p for _, p in board.boards if p != "paper"]
    if not others:
        return ""
    return (
        "The paper's figures were made by its own evaluation (protocol paper), "
        "in which a hole costs less: beside other protocols they tell the order of magnitude."
    )
