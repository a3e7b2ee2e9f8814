"""Ctrl + drag: an object slides along the table instead of across the image."""

from __future__ import annotations

import numpy as np
import pytest
from views_desk import Desk

from annotator.app.view_options import Gizmo
from annotator.views.drags import PlaneDrag
from annotator.views.projection import ScreenCamera
from std_toolkit.geometry import SE3
from std_toolkit.labels.support.plane import Plane, TablePlane

NORMAL = np.array([0.1, -0.8, -0.55]) / np.linalg.norm([0.1, -0.8, -0.55])


def lay_table(desk: Desk) -> None:
    desk.controller.table = TablePlane(
        Plane(NORMAL, 0.4),
        "depth",
        rms_m=0.001,
        points=100,
        frames=1,
        centre=np.array([0.0, 0.05, 0.5]),
        radius_m=0.4,
        uncertainty_m=0.002,
    )


@pytest.mark.parametrize("gizmo", [Gizmo.MOVE, Gizmo.TURN, Gizmo.OFF])
@pytest.mark.parametrize("view", [0, 1])
def test_it_keeps_its_height_above_the_table(desk: Desk, gizmo: Gizmo, view: int) -> None:
    desk.controller.select("ring_1")
    desk.controller.set_tool(gizmo=gizmo)
    lay_table(desk)
    before = desk.session.T_world_obj("ring_1")
    desk.drag(desk.on("ring_1", view), (10, 4), (18, 9), view=view, ctrl=True)
    after = desk.session.T_world_obj("ring_1")
    assert before is not None and after is not None
    shift = after.t - before.t
    assert np.linalg.norm(shift) > 0.005
    assert shift @ NORMAL == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(after.R, before.R, atol=1e-12)
    assert len(desk.session.steps) == 1


def test_the_grabbed_point_stays_under_the_pointer(desk: Desk) -> None:
    desk.controller.set_tool(gizmo=Gizmo.OFF)
    lay_table(desk)
    start = np.floor(desk.on("ring_1")) + 0.5
    hit = desk.main.objects.pick(desk.main, start)
    assert hit is not None
    point = desk.pose().inverse() @ (desk.main.screen.ray(start) * hit[1])
    desk.drag(start, (30, 12), ctrl=True)
    seen = desk.main.screen.project(desk.pose() @ point)
    assert seen == pytest.approx(start + np.array([30, 12]), abs=1e-6)


def test_without_a_table_it_moves_across_the_image_and_it_is_told_why(desk: Desk) -> None:
    desk.controller.table_problem = "no depth"
    before = desk.pose()
    desk.drag(desk.on("ring_1"), (30, 12), ctrl=True)
    assert desk.pose().t[2] == pytest.approx(before.t[2], abs=1e-9)
    assert desk.messages()[0] == "The table is not known: no depth."


@pytest.mark.parametrize("up", [40.0, 400.0, 4000.0])
def test_beyond_the_horizon_it_stays_within_reach(up: float) -> None:
    camera = ScreenCamera(640, 480, 600.0, 600.0, 320.0, 240.0)
    start = SE3.exp([0.0, 0.1, 0.7, 0.3, 0.2, 0.1])
    drag = PlaneDrag(camera, start.t, start, NORMAL)
    at = camera.project(start.t)
    end = drag.to(at - np.array([0.0, up]))
    assert (end.t - start.t) @ NORMAL == pytest.approx(0, abs=1e-9)
    assert np.linalg.norm(end.t) < 10
