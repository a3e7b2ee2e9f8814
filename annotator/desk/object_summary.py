"""One line on each object, for the list of every front end: where the work on it stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Literal

from annotator.desk.controller import Controller
from annotator.session.state import ObjectState, Placement

if TYPE_CHECKING:
    from annotator.session.residuals import FrameResidual

State = Literal["not placed", "placed", "refined", "done"]
Grade = Literal["good", "fair", "poor", "unknown"]

# A contour closer to the image edges than this, in pixels, is as good as hands and refinement
# make it; one farther off than the second is visibly off.
EDGE_PX = (1.5, 3.0)
# The same for the depth of a diffuse object, mm: sensors of this kind read up to 2 % wrong, which
# is 14 mm at 0.7 m, so that edges tell more where there are any.
DEPTH_MM = (15.0, 30.0)
# An edge distance says something only when it is clearly below what chance gives.
CHANCE_SHARE = 0.6


@dataclass(frozen=True)
class ObjectSummary:
    """One object of the list.

    Attributes:
        state: how far the work is.
        badge: residual in a word, such as "0.8 px"; "" if not measured.
        grade: of the residual.
        alarm: what it runs into, such as "3 mm into mug"; "" if it is free.
        noted: somebody wrote down what is to be looked at again.
        explanation: both in sentences.
    """

    id: int
    name: str
    model: str
    material: str
    state: State
    badge: str
    grade: Grade
    alarm: str
    noted: bool
    explanation: str


def summarize(c: Controller) -> list[ObjectSummary]:
    """Every object in the order of the list."""
    return [_summary(c, thing) for thing in c.session.state.objects]


def progress(c: Controller) -> str:
    """How many objects are done, such as "2 of 5 done"; "" if there are none."""
    objects = c.session.state.objects
    done = sum(o.status == "done" for o in objects)
    return f"{done} of {len(objects)} done" if objects else ""


def work_state(thing: ObjectState) -> State:
    """How far the work on an object is."""
    if thing.status == "done":
        return "done"
    if not thing.placements:
        return "not placed"
    return "refined" if any(is_refined(p) for p in thing.placements.values()) else "placed"


def is_refined(placement: Placement) -> bool:
    """The pose was fitted to images or depth; being put onto the table is not that."""
    return bool(placement.refinement) and placement.method != "snap"


def grade_row(row: FrameResidual) -> Grade:
    """How good one object is in one frame, by what was measured there."""
    grades = [g for g in (edge_grade(row), depth_grade(row)) if g is not None]
    order: list[Grade] = ["poor", "fair", "good"]
    return min(grades, key=order.index) if grades else "unknown"


def edge_grade(row: FrameResidual) -> Grade | None:
    """None where the edges tell nothing: not measured, or no nearer than chance."""
    if row.edge_px is None:
        return None
    if row.edge_chance_px is not None and row.edge_px > CHANCE_SHARE * row.edge_chance_px:
        return None
    return _graded(row.edge_px, EDGE_PX)


def depth_grade(row: FrameResidual) -> Grade | None:
    """None where the depth was not measured or is not trusted."""
    return None if row.depth_mm is None else _graded(abs(row.depth_mm), DEPTH_MM)


def _graded(value: float, limits: tuple[float, float]) -> Grade:
    return "good" if value <= limits[0] else "fair" if value <= limits[1] else "poor"


def _summary(c: Controller, thing: ObjectState) -> ObjectSummary:
    state = work_state(thing)
    badge, grade, told = _residual(c.residuals.get(thing.name, ()))
    parts = [f"{thing.name}: {thing.material} {thing.model}, {state}."]
    if state == "placed":
        parts.append(
            "Not refined yet: bring it close (Ctrl + drag: along the table), then press R."
        )
    elif state == "not placed":
        parts.append("Drag it onto the image.")
    if thing.note:
        parts.append(f"Note: {thing.note}")
    alarm = _alarm(c, thing.name)
    if alarm:
        parts.append(f"It runs {alarm}: red in the views.")
    parts.append(told)
    explanation = "\n".join(p for p in parts if p)
    return ObjectSummary(
        thing.id,
        thing.name,
        thing.model,
        thing.material,
        state,
        badge,
        grade,
        alarm,
        bool(thing.note),
        explanation,
    )


def _alarm(c: Controller, name: str) -> str:
    """The deepest penetration of an object."""
    for found in c.penetrations_in(c.frame):
        if name in (found.first, found.second):
            other = found.second if name == found.first else found.first
            other = "the table" if other == "table" else other
            return f"{1000 * found.depth_m:.1f} mm into {other}"
    return ""


def _residual(rows: Sequence[FrameResidual]) -> tuple[str, Grade, str]:
    """Badge, grade and a sentence; the middle frame decides, so that one hidden view does not."""
    if not rows:
        return "", "unknown", ""
    edges = [r.edge_px for r in rows if edge_grade(r) is not None and r.edge_px is not None]
    depths = [abs(r.depth_mm) for r in rows if r.depth_mm is not None]
    if edges:
        value = median(edges)
        told = f"Contour {value:.1f} px from the image edges, median of {len(edges)} frames."
        return f"{value:.1f} px", _graded(value, EDGE_PX), told
    if depths:
        value = median(depths)
        told = (
            f"Surface {value:.0f} mm from the sensor depth, median of {len(depths)} frames; edges "
            "tell nothing here, so judge the contour by eye."
        )
        return f"{value:.0f} mm", _graded(value, DEPTH_MM), told
    return "?", "unknown", "No edge and no depth told its place apart from chance: judge by eye."
