"""Does restoring depth help pose, and how sure is that?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from benchmark.metrics.paired import holm
from benchmark.pose_running.depths import TRUE
from benchmark.pose_running.scoring import ALL, HARD
from benchmark.pose_running.show import heading
from benchmark.report.board import SIGNIFICANT
from benchmark.report.pose_board import MAIN, Compared, PoseBoard
from std_toolkit.checks.markup import Cell, number, paragraph, table, words

# Columns that the table of differences shows.
SHOWN = ("iou50", "iou75", "5deg2cm", "5deg5cm", "10deg5cm")
_OBJECTS = {ALL: "all objects", HARD: "specular and transparent objects"}


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
