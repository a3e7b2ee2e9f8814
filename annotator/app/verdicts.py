"""Verdict on the pose of an object: residuals in the shown frames, rank, and texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from annotator.app.controller import Controller
from std_toolkit.scene.judgement import Grade
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
    rows, texture = c.residuals.get(name, ()), c.textures.get(name)
    if not rows and (texture is None or texture.verdict != "turned"):
        return Verdict("unknown", f"Not measured since {name} moved.")
    return measured_verdict(rows, c.ranks.get(name), texture)


def measured_verdict(
    rows: Sequence[FrameResidual], rank: PoseRank | None, texture: TextureComparison | None = None
) -> Verdict:
    """Return the verdict on a pose by its residuals, rank and texture; None: not known yet.

    It is good only if the pose beats the nearby ones, if a majority of the frames in which the
    contour is visible says so, if no frame is clearly off, and if its texture, where it has one,
    is confirmed. A turn that neither texture nor silhouette can tell is named.
    """
    if texture is not None and texture.verdict == "turned":
        text = f"Wrong turn: {texture.sentence()}. Press Y to take it."
        return Verdict("wrong", text, turned=True)
    visible = [r for r in rows if not r.problem]
    if not visible:
        return Verdict("unknown", "It is visible in none of these frames.")
    worst = [r.frame for r in visible if grade_row(r) == "wrong"]
    if worst:
        return Verdict("wrong", f"Off in frame {', '.join(map(str, worst))}: check there.")
    informative = [r.frame for r in visible if edge_grade(r) is not None]
    if rank is None or not rank.good:
        if not informative and any(depth_grade(r) is not None for r in visible):
            return Verdict(
                "unknown",
                "The depth agrees, but edges are not informative here: check the contour by eye.",
            )
        if not informative and rank is None:
            return Verdict(
                "unknown", "The residuals in these frames are at chance level: check by eye."
            )
    if rank is None:
        return Verdict("unknown", "It is being compared with nearby poses.")
    said = f"{rank.sentence()[:1].upper()}{rank.sentence()[1:]}."
    if not rank.frames or not rank.nearby:
        return Verdict("unknown", f"{said[:-1]}; check by eye.")
    if not rank.good:
        return Verdict("wrong", f"Not confirmed: other poses fit as well. {said}")
    # The distance to the nearest edge is at chance level in clutter; the rank in a frame is not.
    shown = {r.frame for r in visible}
    telling, total = {*informative, *rank.telling}, len(shown.union(rank.frames))
    if 2 * len(telling) <= total:
        text = f"{total - len(telling)} of {total} frames are at chance level: check by eye. {said}"
        return Verdict("unknown", text)
    if texture is None:
        return Verdict("unknown", f"Its texture is being compared with the images. {said}")
    seen = f"{texture.sentence()[:1].upper()}{texture.sentence()[1:]}."
    if texture.verdict == "other":
        return Verdict("wrong", f"{seen} {said}")
    if texture.rival_leads:
        seen += " Press Y to turn it there."
    if any(grade_row(r) == "doubtful" for r in visible):
        unsure = f" {seen}" if texture.verdict == "undecided" and texture.textured else ""
        return Verdict("doubtful", f"Close, but not exact.{unsure} {said}")
    if texture.verdict == "undecided" and texture.textured:
        return Verdict("unknown", f"{seen} {said}")
    also = f" {seen}" if texture.textured else ""
    if texture.verdict == "ambiguous":
        also = f" The turn{_axis(texture.text)} is not determined: geometry cannot tell it."
    return Verdict("fits", f"It fits. {said}{also}")


def _axis(turn: str) -> str:
    """Words such as " about z" of "turned by 180 deg about z"; "" of a turn about two axes."""
    axis = turn.partition(" about ")[2]
    return f" about {axis}" if axis and ", then " not in turn else ""


def doubtful_objects(c: Controller, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return name and reason of those objects whose verdict is not good."""
    verdicts = [(name, object_verdict(c, name)) for name in names]
    return [(name, v.text) for name, v in verdicts if v.grade != "fits"]
