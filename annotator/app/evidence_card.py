"""The evidence on the selected object: a word, and for each source a number and what to do next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from annotator.app.controller import Controller
from annotator.app.object_summary import penetration
from annotator.app.verdicts import (
    Grade,
    VerdictSettings,
    can_turn,
    edge_grade,
    grade_row,
    graded,
    object_verdict,
    sentence,
)
from std_toolkit.scene.judgement import GRADES

if TYPE_CHECKING:
    from annotator.session.residuals import FrameResidual
    from std_toolkit.scene.judgement import Evidence


@dataclass(frozen=True)
class EvidenceRow:
    """What one source says, and what resolves a doubt about it.

    Attributes:
        source: "contour", "nearby poses", "texture" or "turn", "depth", "table" or "frames".
        text: the finding with its number.
        grade: of this source alone; "unknown": it says nothing.
        tip: the finding in a sentence, "" if `text` says all.
        action: id of the action that resolves it, "show_frame", or "" for none.
        label: its name on the card.
        frame: the frame that "show_frame" shows in the main view.
    """

    source: str
    text: str
    grade: Grade
    tip: str = ""
    action: str = ""
    label: str = ""
    frame: int | None = None


@dataclass(frozen=True)
class EvidenceCard:
    """The verdict on one object with its evidence.

    Attributes:
        name: of the object.
        word: "fits", "doubtful", "wrong" or "unknown".
        reason: the verdict in a sentence.
        rows: by source, in a fixed order; a source that cannot say anything is left out.
    """

    name: str
    word: Grade
    reason: str
    rows: tuple[EvidenceRow, ...] = ()


def evidence_card(c: Controller) -> EvidenceCard | None:
    """Return the card of the selected object; None without one, or without a pose."""
    name = c.selected
    if name is None or c.session.pose(name, c.active_frame) is None:
        return None
    verdict = object_verdict(c, name)
    judged = c.findings.judgements.get(name)
    reason = verdict.text
    if judged is not None and not verdict.turned:
        reason = sentence(judged.judgement.reason)
    return EvidenceCard(name, verdict.grade, reason, tuple(_rows(c, name)))


def _rows(c: Controller, name: str) -> Iterator[EvidenceRow]:
    judged = c.findings.judgements.get(name)
    found: dict[str, Evidence] = {}
    for one in [] if judged is None else judged.judgement.evidence:
        if one.motion_mm is not None or one.source not in found:
            found[one.source] = one
    residuals = c.residuals.get(name, ())
    yield _contour(c, residuals, found.get("contour"))
    yield from _nearby(c, name)
    yield from _texture(c, name)
    yield from _depth(c, residuals, found.get("depth"))
    yield from _table(c, name, found.get("support"))
    yield from _frames(residuals, [e.frames for e in found.values()])


def _contour(
    c: Controller, residuals: Sequence[FrameResidual], evidence: Evidence | None
) -> EvidenceRow:
    seen = [r.edge_px for r in residuals if r.edge_px is not None and edge_grade(r) is not None]
    parts: list[str] = []
    grades: list[Grade] = []
    if seen:
        parts.append(f"{median(seen):.1f} px")
        grades.append(graded(median(seen), VerdictSettings.current().edge_px))
    if evidence is not None and evidence.motion_mm is not None:
        parts.append(_off(evidence))
        grades.append(_motion_grade(c, evidence))
    if not parts:
        said = "not measured yet" if not residuals else "nothing above chance"
        return EvidenceRow("contour", said, "unknown", "Check the contour by eye in every view.")
    return _with_refine("contour", ", ".join(parts), max(grades, key=GRADES.index))


def _nearby(c: Controller, name: str) -> Iterator[EvidenceRow]:
    rank = c.ranks.get(name)
    if rank is None:
        return
    tip = sentence(rank.sentence())
    if not rank.frames or not rank.nearby:
        yield EvidenceRow("nearby poses", "not ranked", "unknown", tip)
        return
    text = f"beats {rank.beaten} of {rank.nearby}"
    silent = [f for f in rank.frames if f not in rank.telling]
    if rank.good:
        yield EvidenceRow("nearby poses", text, "fits", tip)
    elif rank.beaten == rank.nearby and silent:
        yield _look("nearby poses", text, "doubtful", tip, silent[0])
    else:
        yield _with_refine("nearby poses", text, "doubtful", tip)


def _texture(c: Controller, name: str) -> Iterator[EvidenceRow]:
    found = c.textures.get(name)
    if found is None:
        return
    tip = sentence(found.sentence())
    if not found.compared:
        if found.verdict == "ambiguous":
            yield EvidenceRow("texture", "none: turns look the same", "unknown", tip)
        return
    text = found.text if found.by_contour else "not measured"
    if np.isfinite(found.score):
        text = f"{found.score:.2f}"
        if np.isfinite(found.rival_score):
            text += f", other turns {found.rival_score:.2f}"
    source = "turn" if found.by_contour else "texture"
    grades: dict[str, Grade] = {"fits": "fits", "turned": "wrong", "other": "wrong"}
    grade = grades.get(found.verdict, "unknown")
    if can_turn(found):
        yield EvidenceRow(source, text, grade, tip, "take_turn", "Turn it")
    elif grade == "unknown" and found.telling:
        yield _look(source, text, grade, tip, found.telling[0])
    else:
        yield EvidenceRow(source, text, grade, tip)


def _depth(
    c: Controller, residuals: Sequence[FrameResidual], evidence: Evidence | None
) -> Iterator[EvidenceRow]:
    if evidence is not None and evidence.motion_mm is not None:
        yield _with_refine("depth", _off(evidence), _motion_grade(c, evidence))
        return
    seen = [r.depth_mm for r in residuals if r.depth_mm is not None]
    if seen:
        value = median(seen)
        grade = graded(abs(value), VerdictSettings.current().depth_mm)
        side = "behind" if value > 0 else "before"
        tip = f"Its surface lies {side} the one that the sensor measures."
        yield _with_refine("depth", f"{abs(value):.0f} mm {side}", grade, tip)


def _table(c: Controller, name: str, evidence: Evidence | None) -> Iterator[EvidenceRow]:
    alarm, into_table = penetration(c, name)
    if alarm:
        action = ("drop", "Drop it") if into_table else ("", "")
        yield EvidenceRow("table", alarm, "doubtful", "Red in the views.", *action)
    elif evidence is not None and evidence.motion_mm is not None:
        grade = _motion_grade(c, evidence)
        action = ("", "") if grade == "fits" else ("drop", "Drop it")
        tip = f"It should stand {evidence.text}." if evidence.text else ""
        yield EvidenceRow("table", _off(evidence), grade, tip, *action)


def _frames(residuals: Sequence[FrameResidual], used: Sequence[int]) -> Iterator[EvidenceRow]:
    off = [r.frame for r in residuals if not r.problem and grade_row(r) == "wrong"]
    count = max(used, default=0)
    text = f"{count} measured" if count else f"{len(residuals)} shown"
    if off:
        tip = f"Its contour or depth is off in frame {', '.join(map(str, off))}."
        yield _look("frames", f"{text}, off in {len(off)}", "doubtful", tip, off[0])
    elif count or residuals:
        yield EvidenceRow("frames", text, "fits" if count > 1 else "unknown")


def _with_refine(source: str, text: str, grade: Grade, tip: str = "") -> EvidenceRow:
    if grade in ("wrong", "doubtful"):
        return EvidenceRow(source, text, grade, tip, "refine", "Refine")
    return EvidenceRow(source, text, grade, tip)


def _look(source: str, text: str, grade: Grade, tip: str, frame: int) -> EvidenceRow:
    label = f"Look at frame {frame}"
    return EvidenceRow(source, text, grade, tip, "show_frame", label, frame)


def _off(evidence: Evidence) -> str:
    """How far off a source puts the object, such as "0.4 mm, 0.3°"."""
    mm, deg = _size(evidence.motion_mm), _size(evidence.turn_deg)
    return f"{mm:.1f} mm, {deg:.1f}°"


def _motion_grade(c: Controller, evidence: Evidence) -> Grade:
    """Whether a motion lies within the limits of the judge."""
    C = np.zeros((6, 6)) if evidence.covariance is None else np.reshape(evidence.covariance, (6, 6))
    grades: list[Grade] = []
    options = c.judge.options
    limits = (options.max_motion_mm, options.max_motion_deg)
    for part, limit, motion in zip(
        (slice(0, 3), slice(3, 6)), limits, (evidence.motion_mm, evidence.turn_deg), strict=True
    ):
        value = _size(motion)
        if value <= limit:
            grades.append("fits")
            continue
        along = np.asarray(motion, dtype=np.float64) / value
        std = float(np.sqrt(max(float(along @ C[part, part] @ along), 0.0)))
        far = VerdictSettings.current().motion_deviations * std
        grades.append("wrong" if value > limit + far else "doubtful")
    return max(grades, key=GRADES.index)


def _size(vector: Sequence[float] | None) -> float:
    return 0.0 if vector is None else float(np.linalg.norm(vector))
