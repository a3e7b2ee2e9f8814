"""Poses in a report: of categories, and of known objects.

The leaderboard of poses as text: terminal, CSV, Markdown, LaTeX.

Does restoring depth help pose, and how sure is that?
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import pandas as pd

from benchmark.evaluation.results import aligned
from benchmark.evaluation.tasks.bop import BopResult, bop_table, read_bop_figures
from benchmark.evaluation.tasks.pose_inputs import TRUE
from benchmark.evaluation.tasks.pose_results import ALL, HARD, heading, read_pose_results
from benchmark.metrics.significance import holm
from benchmark.report.leaderboard import MEASURED, PUBLISHED, SIGNIFICANT
from benchmark.report.leaderboard_text import escape_latex
from benchmark.report.page import PageSection, ReportPart
from benchmark.report.parts import pose_sections as sections
from benchmark.report.parts.pose_board import (
    FIGURES,
    MAIN,
    PROTOCOLS,
    TABLES,
    Compared,
    PoseBoard,
    make_pose_board,
)
from std_toolkit.html.markup import Cell, amount, number, paragraph, percent, table, words

# Columns that the table of differences shows.
SHOWN = ("iou50", "iou75", "5deg2cm", "5deg5cm", "10deg5cm")

_OBJECTS = {ALL: "all objects", HARD: "specular and transparent objects"}

_HEADS = ("method", "depth", "fit", "objects")

CSV, MARKDOWN, LATEX = "poses.csv", "poses.md", "poses.tex"


@dataclass(frozen=True)
class Finding:
    """What the comparison of one restored depth with raw depth says.

    Attributes:
        split, subset, method, depth, fit: what was compared.
        after: percent of poses that are right on the restored depth.
        gain, low, high: over raw depth, in points of percent, with the 95 % interval over scenes.
        p: of the swap test, corrected for all restored depths and methods of the split.
        scenes: that were compared.
    """

    split: str
    subset: str
    method: str
    depth: str
    fit: str
    after: float
    gain: float
    low: float
    high: float
    p: float
    scenes: int

    @property
    def verdict(self) -> str:
        """`helps`, `hurts` or `cannot be told`."""
        if math.isnan(self.p) or self.p >= SIGNIFICANT:
            return "cannot be told"
        return "helps" if self.gain > 0 else "hurts"


def findings(board: PoseBoard, subset: str) -> list[Finding]:
    """What is found of every restored depth, split by split."""
    found = []
    for split in board.splits:
        restored = [c for c in board.compared.get((split, subset), ()) if not _is_true(c)]
        made = [c for c in restored if c.difference is not None]
        values = [c.difference.of(MAIN) for c in made if c.difference is not None]
        p_values = holm([p for *_, p in values])
        for compared, (gain, low, high, _), p in zip(made, values, p_values, strict=True):
            method, depth, fit = compared.scored.result.name
            after = 100 * compared.scored.scores.mean[MAIN]
            points = after, 100 * gain, 100 * low, 100 * high
            scenes = compared.scored.scene_count
            found.append(Finding(split, subset, method, depth, fit, *points, float(p), scenes))
    return found


def answer(board: PoseBoard) -> str:
    """HTML: a sentence for each restored depth, and the table of all differences."""
    said = [finding for subset in (HARD, ALL) for finding in findings(board, subset)]
    lines = "".join(f"<li>{_sentence(finding)}</li>" for finding in said)
    tables = "".join(
        f"<h4>{escape(split)}, {_OBJECTS[subset]}</h4>{_table(compared)}"
        for subset in (HARD, ALL)
        for split in board.splits
        if (compared := board.compared.get((split, subset)))
    )
    if not tables:
        return paragraph(
            "Only raw depth was measured: `--depth raw swindrnet gt` compares it with others."
        )
    about = paragraph(
        "The same method, fitted to another depth, against raw depth: points of percent, protocol "
        "strict, mean over classes. In brackets the 95 % interval over scenes. The test asks how "
        "often a difference would be as large if in each scene the two were swapped by chance; "
        f"in the sentences, which are about {heading(MAIN)}, it is corrected for all restored "
        "depths and methods of a split (Holm). With five scenes or fewer it can show nothing."
    )
    return (f'<ul class="findings">{lines}</ul>' if lines else "") + about + tables


def _sentence(finding: Finding) -> str:
    about = f"{finding.method}, fit {finding.fit}, {finding.split}"
    interval = ""
    if not math.isnan(finding.low):
        low, high = (number(x, sign=True) for x in (finding.low, finding.high))
        interval = f"; 95 % interval of the change {low} to {high}"
    p = f", {_p(finding.p)}" if not math.isnan(finding.p) else ""
    verdict = {
        "helps": '<b class="good">It helps.</b>',
        "hurts": '<b class="over">It hurts.</b>',
        "cannot be told": "<b>Whether it helps cannot be told</b> from "
        f"{finding.scenes} scene{'' if finding.scenes == 1 else 's'}.",
    }[finding.verdict]
    before = finding.after - finding.gain
    return (
        f"{verdict} Of {_OBJECTS[finding.subset]}, {number(before)} % of the poses are within "
        f"{heading(MAIN)} on raw depth and {number(finding.after)} % on depth restored by "
        f"{words(f'`{finding.depth}`')} ({escape(about)}{interval}{p})."
    )


def _table(compared: Sequence[Compared]) -> str:
    rows = []
    for each in compared:
        method, depth, fit = each.scored.result.name
        name = Cell(
            escape(depth) + ("<small>the most there is to gain</small>" if _is_true(each) else "")
        )
        cells = [Cell(escape(method)), name, Cell(escape(fit))]
        if each.difference is None:
            why = Cell(f'<span class="none">{escape(each.why_not)}</span>')
            rows.append([*cells, why, *[Cell("") for _ in SHOWN[1:]]])
            continue
        cells += [_difference(*each.difference.of(column)) for column in SHOWN]
        rows.append(cells)
    heads = [("method", ""), ("depth", ""), ("fit", ""), *((heading(c), "points") for c in SHOWN)]
    return table(heads, rows)


def _difference(gain: float, low: float, high: float, p: float) -> Cell:
    if math.isnan(gain):
        return Cell("–", numeric=True)
    text = number(100 * gain, sign=True)
    sure = not math.isnan(p) and p < SIGNIFICANT
    notes = []
    if not math.isnan(low):
        notes.append(f"[{number(100 * low, sign=True)}, {number(100 * high, sign=True)}]")
    if not math.isnan(p):
        notes.append(_p(p))
    small = f"<small>{' '.join(notes)}</small>" if notes else ""
    return Cell((f"<b>{text}</b>" if sure else text) + small, numeric=True)


def _p(p: float) -> str:
    return "p&nbsp;&lt;&nbsp;0.001" if p < 0.001 else f"p&nbsp;=&nbsp;{p:.3f}"


def _is_true(compared: Compared) -> bool:
    return compared.scored.result.manifest.setup.depth == TRUE


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
