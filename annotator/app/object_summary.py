"""Annotation progress of each object in one line, and a hint for the next step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Literal

from annotator.app.controller import Controller
from annotator.app.verdicts import Grade, VerdictSettings, edge_grade, graded, object_verdict
from annotator.session.state import ObjectState, Placement

if TYPE_CHECKING:
    from annotator.session.residuals import FrameResidual

State = Literal["not placed", "placed", "refined", "done"]

# A pose from points needs four that do not lie in one line.
POINTS_FOR_A_POSE = 4


@dataclass(frozen=True)
class ObjectSummary:
    """Progress of one object of the list.

    Attributes:
        state: progress of the annotation.
        badge: short residual, such as "0.8 px"; "" if not measured.
        grade: of the residual.
        alarm: penetration, such as "3 mm into mug"; "" if there is none.
        noted: whether the object has a note.
        locked: whether its pose cannot be changed.
        explanation: residual and penetration in sentences.
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
    locked: bool
    explanation: str


def summarize(c: Controller) -> list[ObjectSummary]:
    """Return a summary of every object in the order of the list."""
    return [_summary(c, obj) for obj in c.session.state.objects]


def matching(rows: Sequence[ObjectSummary], sought: str) -> list[ObjectSummary]:
    """Return the rows in which every word occurs: in name, mesh, material, state or verdict."""
    words = sought.casefold().split()
    return [r for r in rows if all(w in searched(r) for w in words)]


def searched(row: ObjectSummary) -> str:
    """Return the words of a row among which `matching` looks, in lower case."""
    parts = (row.name, row.model, row.material, row.state, row.badge, row.grade, row.alarm)
    return " ".join((*parts, "locked" if row.locked else "")).casefold()


def progress(c: Controller) -> str:
    """Return the number of finished objects, such as "2 of 5 done"; "" without objects."""
    objects = c.session.state.objects
    done = sum(o.status == "done" for o in objects)
    return f"{done} of {len(objects)} done" if objects else ""


def work_state(obj: ObjectState) -> State:
    """Return the progress of an object."""
    if obj.status == "done":
        return "done"
    if not obj.placements:
        return "not placed"
    return "refined" if any(is_refined(p) for p in obj.placements.values()) else "placed"


def is_refined(placement: Placement) -> bool:
    """Whether the pose was fitted to the images or depth of this scene.

    Snapping to the table does not count, nor does a pose carried over from another scene.
    """
    elsewhere = placement.method == "snap" or placement.method.startswith("carry:")
    return bool(placement.refinement) and not elsewhere


def _summary(c: Controller, obj: ObjectState) -> ObjectSummary:
    state = work_state(obj)
    badge, grade, sentence = _residual(c.residuals.get(obj.name, ()))
    verdict = object_verdict(c, obj.name)
    if verdict.turned:
        badge = "turned"
    # A small residual alone is no proof: in clutter every contour is near an edge.
    if verdict.grade in ("wrong", "doubtful"):
        grade = verdict.grade
    elif grade == "fits" and verdict.grade == "unknown":
        grade = "doubtful"
    elif verdict.grade == "fits":
        badge, grade = badge if grade != "unknown" else "fits", "fits"
    if not badge and obj.name in c.findings.judgements:
        badge = verdict.grade
    parts = [f"{obj.name}: {obj.material} {obj.model}, {state}."]
    if state == "placed":
        parts.append(
            "Not refined yet: bring it close (Ctrl + drag: along the table), then press R."
        )
    elif state == "not placed":
        parts.append("Drag it onto the image.")
    if obj.locked:
        parts.append("Locked: L allows changes of its pose.")
    if obj.note:
        parts.append(f"Note: {obj.note}")
    alarm, _ = penetration(c, obj.name)
    if alarm:
        parts.append(f"It runs {alarm}: red in the views.")
    parts.append(sentence)
    if badge:
        parts.append(verdict.text)
    explanation = "\n".join(p for p in parts if p)
    return ObjectSummary(
        obj.id,
        obj.name,
        obj.model,
        obj.material,
        state,
        badge,
        grade,
        alarm,
        bool(obj.note),
        obj.locked,
        explanation,
    )


def penetration(c: Controller, name: str) -> tuple[str, bool]:
    """Return the deepest penetration of an object as text, and whether it is into the table."""
    for found in c.penetrations_in(c.frame):
        if name in (found.first, found.second):
            other = found.second if name == found.first else found.first
            table = other == "table"
            into = "the table" if table else other
            return f"{1000 * found.depth_m:.1f} mm into {into}", table
    return "", False


def _residual(rows: Sequence[FrameResidual]) -> tuple[str, Grade, str]:
    """Return badge, grade and a sentence; the median over frames is robust to an occluded view."""
    limits = VerdictSettings.current()
    if not rows:
        return "", "unknown", ""
    edges = [r.edge_px for r in rows if edge_grade(r) is not None and r.edge_px is not None]
    depths = [abs(r.depth_mm) for r in rows if r.depth_mm is not None]
    if edges:
        value = median(edges)
        sentence = f"Contour {value:.1f} px from the image edges, median of {len(edges)} frames."
        return f"{value:.1f} px", graded(value, limits.edge_px), sentence
    if depths:
        value = median(depths)
        sentence = (
            f"Surface {value:.0f} mm from the sensor depth, median of {len(depths)} frames; edges "
            "are not informative here, so check the contour by eye."
        )
        return f"{value:.0f} mm", graded(value, limits.depth_mm), sentence
    return "?", "unknown", "Neither edges nor depth are above chance level: check by eye."


def next_hint(c: Controller) -> str:
    """Return a hint for the user's next step in the current state."""
    state = c.session.state
    if c.dragging is not None:
        return f"Moving {c.dragging}: release to keep the pose, Esc to restore it."
    if c.task is not None and c.task.alone:
        return f"{c.task.title} is running: views can be moved; edits are blocked until it is done."
    if c.task is not None and not c.clicking:
        return f"{c.task.title} is running: you can continue, or press Esc to cancel it."
    if not c.session.writable:
        return "This scene is open read-only: nothing can be changed."
    if not state.models:
        return "Add the CAD mesh of an object with File > Add mesh (Ctrl+M)."
    if not state.objects:
        return "Drag a mesh from the library onto the image, or double-click it."
    if c.selected is None:
        return "Click an object in the list or in a view to select it."
    obj = state.object(c.selected)
    if obj.locked:
        return f"{obj.name} is locked, so its pose stays: L unlocks it."
    if c.clicking:
        return _clicking_hint(c)
    if c.session.pose(obj.name, c.active_frame) is None:
        if c.active_frame not in c.session.frames:
            return "This frame has no camera pose: choose one that has, below the image."
        return f"Drag {obj.name} onto the image, or press C and click points."
    if obj.status == "done":
        left = [o.name for o in state.objects if o.status != "done"]
        if left:
            return f"{obj.name} is done. Next: {left[0]} (N)."
        if c.session.posed:
            return "All objects are done: save and propagate with Ctrl+P."
        return "All objects are done: save with Ctrl+S." if c.session.unsaved else "All is done."
    placement = obj.placements.get(c.active_frame) or next(iter(obj.placements.values()))
    if not is_refined(placement):
        return (
            f"Move {obj.name} close to its image (Ctrl + drag: along the table), then press R "
            "to refine."
        )
    row = next(r for r in summarize(c) if r.name == obj.name)
    if object_verdict(c, obj.name).turned:
        return f"Another turn of {obj.name} fits the texture better: press Y to take it."
    texture = c.textures.get(obj.name)
    if texture is not None and texture.verdict == "undecided" and texture.rival_leads:
        decides = texture.decides()
        return f"Another turn of {obj.name} scores higher: {decides}; Y turns it, D keeps it."
    if row.grade == "wrong" and _residual(c.residuals.get(obj.name, ()))[1] != "wrong":
        return f"{obj.name} is not confirmed: check it in every view, or place it again."
    if row.grade == "wrong":
        return f"{obj.name} is {row.badge} off: bring it closer, then press R again."
    if row.alarm:
        return f"{obj.name} is {row.alarm}: check it in every view."
    return f"Check {obj.name} in every view; press D if it fits."


def _clicking_hint(c: Controller) -> str:
    name = str(c.selected)
    if c.pending_point is not None:
        return f"Now click the same point of {name} in the image. Esc: take another point."
    count = len(c.session.object(name).clicks.get(c.active_frame, []))
    if count < POINTS_FOR_A_POSE:
        left = POINTS_FOR_A_POSE - count
        more = f"{left} more point{'s' if left > 1 else ''}" if count else "Four points"
        return f"{more} to go: click a point on the mesh of {name}, then in the image."
    return f"{count} points: press Return for the pose of {name}, or click more."
