"""Verdict on the pose of an object: that of the judge, with residuals, rank and texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from annotator.app.controller import Controller
from std_toolkit.scene.judgement import Grade, Judgement
from std_toolkit.settings import NOT_RECORDED, Settings, limit

if TYPE_CHECKING:
    from annotator.session.residuals import FrameResidual
    from std_toolkit.checks.measure.ranking import PoseRank
    from std_toolkit.labels.texture.comparison import TextureComparison


@dataclass(frozen=True, kw_only=True)
class VerdictSettings(Settings):
    """Residuals at which a pose is good, doubtful or bad."""

    edge_px: tuple[float, float] = limit(
        (1.5, 3.0),
        unit="px",
        source="as good as annotation and refinement get; visibly wrong",
    )
    """contour to image edges: good below the first, bad above the second"""
    depth_mm: tuple[float, float] = limit(
        (15.0, 30.0),
        unit="mm",
        source="sensors have errors up to 2 %, which is 14 mm at 0.7 m",
    )
    """the same for the depth of a diffuse object"""
    chance_share: float = limit(0.6, source=NOT_RECORDED)
    """an edge distance is informative below this part of the distance by chance"""
    motion_deviations: float = limit(2.0, unit="deviations", source="chance of one in twenty")
    """a motion that exceeds a limit of the judge by more is wrong, by less doubtful"""


@dataclass(frozen=True)
class Verdict:
    """Whether a pose fits.

    Attributes:
        grade: "fits": it fits; "unknown": not measured or not measurable.
        text: reason in sentences.
        turned: whether another turn fits the texture better.
    """

    grade: Grade
    text: str
    turned: bool = False


def grade_row(row: FrameResidual) -> Grade:
    """Return the grade of an object's residuals in one frame."""
    grades = [g for g in (edge_grade(row), depth_grade(row)) if g is not None]
    order: list[Grade] = ["wrong", "doubtful", "fits"]
    return min(grades, key=order.index) if grades else "unknown"


def edge_grade(row: FrameResidual) -> Grade | None:
    """Return the grade of the edge residual; None if not measured or at chance level."""
    limits = VerdictSettings.current()
    if row.edge_px is None:
        return None
    if row.edge_chance_px is not None and row.edge_px > limits.chance_share * row.edge_chance_px:
        return None
    return graded(row.edge_px, limits.edge_px)


def depth_grade(row: FrameResidual) -> Grade | None:
    """Return the grade of the depth residual; None if not measured or not trusted."""
    limits = VerdictSettings.current()
    return None if row.depth_mm is None else graded(abs(row.depth_mm), limits.depth_mm)


def graded(value: float, limits: tuple[float, float]) -> Grade:
    return "fits" if value <= limits[0] else "doubtful" if value <= limits[1] else "wrong"


def object_verdict(c: Controller, name: str) -> Verdict:
    """Return the verdict on an object from what is known of its current pose."""
    if c.session.pose(name, c.active_frame) is None:
        return Verdict("unknown", f"{name} has no pose yet.")
    judged = c.findings.judgements.get(name)
    return measured_verdict(
        c.residuals.get(name, ()),
        c.ranks.get(name),
        c.textures.get(name),
        None if judged is None else judged.judgement,
    )


def measured_verdict(
    rows: Sequence[FrameResidual],
    rank: PoseRank | None,
    texture: TextureComparison | None = None,
    judgement: Judgement | None = None,
) -> Verdict:
    """Return the verdict on a pose: that of the judge, with what else is known; None: not yet.

    A turn that fits the texture better is wrong in any case. Residuals and rank explain a verdict
    and never give one: in clutter any contour lies near an edge, and the pose that beats its
    neighbours may still be the wrong turn.
    """
    if texture is not None and texture.verdict == "turned":
        text = f"Wrong turn: {texture.sentence()}. Press Y to take it."
        return Verdict("wrong", text, turned=True)
    grade: Grade = "unknown" if judgement is None else judgement.grade
    said = [_HEADS[grade].format(judgement.reason) if judgement is not None else "Not judged yet."]
    if texture is not None and texture.compared and texture.verdict in ("undecided", "other"):
        seen = texture.sentence()
        said += [] if seen in said[0] else [sentence(seen)]
        said += ["Press Y to turn it there."] if texture.rival_leads and can_turn(texture) else []
    elif texture is not None and texture.verdict == "ambiguous":
        said.append(f"The turn{_axis(texture.text)} is not determined: geometry cannot tell it.")
    if grade != "fits":
        off = [str(r.frame) for r in rows if not r.problem and grade_row(r) == "wrong"]
        said += [f"Its contour is off in frame {', '.join(off)}: look there."] if off else []
    # That a wrong pose beats its neighbours helps nobody.
    if rank is not None and (grade in ("fits", "unknown") or not rank.good):
        said.append(sentence(rank.sentence()))
    return Verdict(grade, " ".join(said))


_HEADS: dict[Grade, str] = {
    "fits": "It fits: {}.",
    "doubtful": "Doubtful: {}.",
    "wrong": "Wrong: {}.",
    "unknown": "Unknown: {}.",
}


def can_turn(texture: TextureComparison) -> bool:
    """Whether a turn is offered: its texture fits better, or scores higher."""
    leads = texture.verdict == "undecided" and texture.rival_leads
    return texture.turn is not None and (texture.verdict == "turned" or leads)


def sentence(text: str) -> str:
    """Return words as a sentence: with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def _axis(turn: str) -> str:
    """Words such as " about z" of "turned by 180 deg about z"; "" of a turn about two axes."""
    axis = turn.partition(" about ")[2]
    return f" about {axis}" if axis and ", then " not in turn else ""


def doubtful_objects(c: Controller, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return name and reason of those objects whose verdict is not good."""
    verdicts = [(name, object_verdict(c, name)) for name in names]
    return [(name, v.text) for name, v in verdicts if v.grade != "fits"]
