"""Content of the panels: residuals, clicked points, marks on the frame slider."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from annotator.app.controller import Controller
from annotator.app.verdicts import Grade, depth_grade, edge_grade, sentence
from std_toolkit.settings import Settings, limit

if TYPE_CHECKING:
    from annotator.session.residuals import FrameResidual


@dataclass(frozen=True, kw_only=True)
class ClickSettings(Settings):
    """Residuals at which a click is good or bad."""

    good_px: float = limit(2.0, unit="px", source="careful clicks have an error of about a pixel")
    """a residual below is good"""
    bad_px: float = limit(5.0, unit="px", source="a much larger residual is a wrong click")
    """a residual above is bad"""


@dataclass(frozen=True)
class ResidualRow:
    """Residuals of the selected object in one frame, as text.

    Attributes:
        edges, chance, depth: number with unit, "" if not measured.
        edge_grade, depth_grade: their grades; "unknown" for edges at chance level.
        problem: reason why nothing was measured, or "".
    """

    frame: int
    edges: str
    chance: str
    depth: str
    edge_grade: Grade
    depth_grade: Grade
    problem: str


def residual_rows(c: Controller) -> list[ResidualRow]:
    """Return the residuals of the selected object in the shown frames."""
    return [_residual_row(row) for row in _residuals(c)]


def _residuals(c: Controller) -> Sequence[FrameResidual]:
    return () if c.selected is None else c.residuals.get(c.selected, ())


def _residual_row(row: FrameResidual) -> ResidualRow:
    depth = row.depth_mm
    return ResidualRow(
        row.frame,
        edges="none" if row.edge_px is None else f"{row.edge_px:.1f} px",
        chance="" if row.edge_chance_px is None else f"{row.edge_chance_px:.1f} px",
        depth="" if depth is None else f"{depth:+.{0 if abs(depth) > 99 else 1}f} mm",
        edge_grade=edge_grade(row) or "unknown",
        depth_grade=depth_grade(row) or "unknown",
        problem=row.problem,
    )


def weak_direction(c: Controller) -> str:
    """Return a sentence on the direction least determined by the last refinement, or ""."""
    from std_toolkit.labels.refine.directions import weak_direction_upright

    weak = c.weak_directions.get(c.selected or "", "")
    if c.table is not None and c.selected is not None:
        plane = c.table.plane
        T = c.session.T_world_obj(c.selected)
        if plane.frame != "world":
            T = c.pose(c.selected, int(plane.frame.split()[-1]))
        if T is not None:
            weak = weak_direction_upright(weak, T.R.T @ plane.normal)
    return sentence(weak) if weak else ""


@dataclass(frozen=True)
class ClickRow:
    """Clicked point with its residual.

    Attributes:
        frame: frame in which it was clicked.
        number: index among the points of the object in this frame, from 0.
        u, v: pixel in the recorded image.
        residual_px: distance to the projection of its mesh point at the current pose; None
            without a pose, or behind the camera.
    """

    frame: int
    number: int
    u: float
    v: float
    residual_px: float | None


def click_rows(c: Controller, name: str) -> list[ClickRow]:
    """Return all clicked points of an object, those of the active view first."""
    obj = c.session.object(name)
    scene = c.session.scene
    rows = []
    for frame in sorted(obj.clicks, key=lambda f: (f != c.active_frame, f)):
        T = c.pose(name, frame)
        camera = scene.camera(scene.frame(frame))
        for number, click in enumerate(obj.clicks[frame]):
            residual = None
            if T is not None:
                seen = camera.project(T @ np.asarray(click.point))
                distance = float(np.hypot(*(seen - [click.u, click.v])))
                residual = distance if np.isfinite(distance) else None
            rows.append(ClickRow(frame, number, click.u, click.v, residual))
    return rows


@dataclass(frozen=True)
class FrameMarks:
    """Marked positions on the frame slider, as indices into the recording from 0.

    Attributes:
        runs: first and last frame of each run with camera poses.
        sides: frames of the side views.
        placed: frames in which objects were placed.
    """

    runs: tuple[tuple[int, int], ...]
    sides: tuple[int, ...]
    placed: tuple[int, ...]


def frame_marks(c: Controller) -> FrameMarks:
    """Return the marks of the frame slider."""
    session = c.session
    place = {frame.id: i for i, frame in enumerate(session.scene.frames)}
    known = sorted(place[f] for f in session.frames) if session.posed else []
    return FrameMarks(
        runs=_runs(known),
        sides=tuple(place[f] for f in c.view_frames[1:]),
        placed=tuple(
            sorted({place[f] for o in session.state.objects for f in o.placements if f in place})
        ),
    )


def _runs(places: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Return first and last of each run of consecutive numbers."""
    runs: list[tuple[int, int]] = []
    for i in places:
        if runs and runs[-1][1] == i - 1:
            runs[-1] = (runs[-1][0], i)
        else:
            runs.append((i, i))
    return tuple(runs)
