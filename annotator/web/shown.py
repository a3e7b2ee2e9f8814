"""What the page shows of a controller, as plain values that go to the browser."""

from __future__ import annotations

from typing import Any

from annotator.actions import ACTIONS
from annotator.desk.click_residuals import click_rows
from annotator.desk.controller import Controller
from annotator.desk.hints import next_hint
from annotator.desk.object_summary import progress, summarize
from annotator.desk.wording import symmetry_summary
from annotator.pose_text import RotationForm, rotation_numbers
from std_toolkit.checks.palette import object_color

ICONS = {
    "save": "mdi-content-save-outline",
    "undo": "mdi-undo",
    "redo": "mdi-redo",
    "toggle_mode": "mdi-cube-scan",
    "style_solid": "mdi-circle",
    "style_wireframe": "mdi-web",
    "style_contour": "mdi-circle-outline",
    "gizmo_move": "mdi-arrow-all",
    "gizmo_turn": "mdi-rotate-orbit",
    "fit_view": "mdi-fit-to-screen-outline",
    "zoom_object": "mdi-magnify-scan",
    "clicking": "mdi-target",
    "refine": "mdi-auto-fix",
    "drop": "mdi-arrow-collapse-down",
    "residuals": "mdi-ruler",
    "done": "mdi-check-bold",
}
_STATE_ICONS = {
    "not placed": "mdi-checkbox-blank-circle-outline",
    "placed": "mdi-circle-half-full",
    "refined": "mdi-circle-slice-7",
    "done": "mdi-check-circle",
}


def shown_state(c: Controller) -> dict[str, Any]:
    """Everything beside the pictures."""
    frames = [f.id for f in c.session.scene.frames]
    return {
        "objects": _objects(c),
        "selected": c.selected or "",
        "models": [_model(m) for m in c.session.state.models],
        "progress": progress(c),
        "unsaved": c.session.unsaved,
        "writable": c.session.writable,
        "actions": {a.id: _action(c, a) for a in ACTIONS},
        "frame_index": frames.index(c.frame),
        "frame_ids": list(c.view_frames),
        "active_view": c.active_view,
        "clicking": c.clicking,
        "frame_problem": _frame_problem(c),
        "busy": "" if c.task is None else c.task.title,
        "busy_alone": c.task is not None and c.task.alone,
        "step": c.step,
        "axes": c.axes,
        "points": _points(c),
        "residuals": _residuals(c),
        **shown_pose(c),
    }


def shown_pose(c: Controller) -> dict[str, Any]:
    """The part of it that changes as an object is dragged."""
    return {"pose": _pose(c), "hint": next_hint(c)}


def _frame_problem(c: Controller) -> str:
    return "no camera pose" if c.session.posed and c.frame not in c.session.frames else ""


def _action(c: Controller, action: Any) -> dict[str, Any]:
    return {
        "enabled": bool(action.enabled(c)),
        "on": bool(action.checked(c)) if action.checked is not None else False,
        "title": action.label(c) if action.label is not None else action.title,
    }


def _objects(c: Controller) -> list[dict[str, Any]]:
    ids = [o.id for o in c.session.state.objects]
    return [
        {
            "id": s.id,
            "name": s.name,
            "color": object_color(ids, s.id),
            "icon": _STATE_ICONS[s.state],
            "told": f"{s.material} {s.model}, {s.state}",
            "badge": s.badge,
            "grade": s.grade,
            "alarm": s.alarm,
            "explanation": s.explanation,
        }
        for s in summarize(c)
    ]


def _model(model: Any) -> dict[str, Any]:
    size = " × ".join(f"{1000 * x:.0f}" for x in model.size_m)
    turns = symmetry_summary(model.symmetry)
    told = f"{size} mm · {model.category}"
    return {"id": model.id, "told": told, "explanation": f"{size} mm, {model.category}, {turns}"}


def _pose(c: Controller) -> dict[str, Any] | None:
    """Position of the selected object in the camera of the view in hand, mm and degrees."""
    T = None if c.selected is None else c.pose(c.selected, c.active_frame)
    if T is None:
        return None
    return {
        "frame": c.active_frame,
        "position": [f"{1000 * x:.2f}" for x in T.t],
        "rotation": [f"{x:.3f}" for x in rotation_numbers(T.R, RotationForm.VECTOR)],
    }


def _points(c: Controller) -> list[dict[str, Any]]:
    if c.selected is None:
        return []
    return [
        {
            "frame": row.frame,
            "number": row.number,
            "pixel": f"{row.u:.1f}, {row.v:.1f}",
            "residual": "" if row.residual_px is None else f"{row.residual_px:.1f} px",
        }
        for row in click_rows(c, c.selected)
    ]


def _residuals(c: Controller) -> list[dict[str, Any]]:
    def number(value: float | None, unit: str) -> str:
        return "–" if value is None else f"{value:.1f} {unit}"

    return [
        {
            "frame": row.frame,
            "edge": number(row.edge_px, "px"),
            "chance": number(row.edge_chance_px, "px"),
            "depth": number(row.depth_mm, "mm"),
            "problem": row.problem,
        }
        for row in c.residuals.get(c.selected or "", ())
    ]
