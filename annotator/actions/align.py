"""Letting the computer align: refine, table, points."""

from __future__ import annotations

from typing import TYPE_CHECKING

from annotator.actions.action import Action, can_compute, has_selected, is_idle
from annotator.desk import alignment

if TYPE_CHECKING:
    from annotator.desk.controller import Controller


def _has_points(c: Controller) -> bool:
    """Points of the selected object are clicked in the view in hand."""
    return bool(c.session.object(str(c.selected)).clicks.get(c.active_frame))


ALIGN_ACTIONS: tuple[Action, ...] = (
    Action(
        "refine",
        "Align",
        "Refine",
        ("R",),
        "Fit the selected object: to the sensor depth and the image edges where it is opaque, to "
        "the edges in several frames where the sensor cannot see it.",
        alignment.refine,
        enabled=can_compute,
    ),
    Action(
        "refine_all",
        "Align",
        "Refine all objects",
        ("Ctrl+R",),
        "Fit all placed objects together.",
        lambda c: alignment.refine(c, all_objects=True),
        enabled=lambda c: c.session.writable and is_idle(c) and bool(c.session.state.objects),
    ),
    Action(
        "drop",
        "Align",
        "Drop onto the table",
        ("S",),
        "Move the object along the table's normal until it touches the table.",
        lambda c: alignment.snap(c, "drop"),
        enabled=can_compute,
    ),
    Action(
        "rest",
        "Align",
        "Lay onto the table",
        ("Shift+S",),
        "Turn the object so that it rests on its nearest side, and drop it onto the table.",
        lambda c: alignment.snap(c, "rest"),
        enabled=can_compute,
    ),
    Action(
        "clicking",
        "Align",
        "Click points",
        ("C",),
        "Click a point on the mesh, then the same point in the image; four or more give a pose.",
        lambda c: c.set_tool(clicking=not c.clicking),
        lambda c: c.clicking,
        has_selected,
    ),
    Action(
        "solve_points",
        "Align",
        "Pose from the points",
        ("Return",),
        "Compute the pose from the clicked points (PnP) and show each point's residual.",
        alignment.solve_points,
        enabled=lambda c: has_selected(c) and is_idle(c) and (c.clicking or _has_points(c)),
    ),
    Action(
        "residuals",
        "Align",
        "Measure residuals",
        ("M",),
        "Compare the selected object with the image edges and the depth in the shown frames.",
        alignment.measure_residuals,
        enabled=can_compute,
    ),
)
