"""How far clicked points lie from where the pose puts them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from annotator.desk.controller import Controller


@dataclass(frozen=True)
class ClickRow:
    """One clicked point.

    Attributes:
        frame: in which it was clicked.
        number: its place among the points of the object in this frame, from 0.
        u, v: pixel in the recorded image.
        residual_px: distance to its point on the mesh at the object's pose now; None without a
            pose, or behind the camera.
    """

    frame: int
    number: int
    u: float
    v: float
    residual_px: float | None


def click_rows(c: Controller, name: str) -> list[ClickRow]:
    """All clicked points of an object, those of the view in hand first."""
    thing = c.session.object(name)
    scene = c.session.scene
    rows = []
    for frame in sorted(thing.clicks, key=lambda f: (f != c.active_frame, f)):
        T = c.pose(name, frame)
        camera = scene.camera(scene.frame(frame))
        for number, click in enumerate(thing.clicks[frame]):
            residual = None
            if T is not None:
                seen = camera.project(T @ np.asarray(click.point))
                distance = float(np.hypot(*(seen - [click.u, click.v])))
                residual = distance if np.isfinite(distance) else None
            rows.append(ClickRow(frame, number, click.u, click.v, residual))
    return rows
