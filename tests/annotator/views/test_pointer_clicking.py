"""Clicks that set correspondences of the mesh and the image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from views_desk import LENS, Desk, edits, pixel_middle

from annotator.session import AddClick, Click


class TestClicking:
    @pytest.fixture
    def clicking(self, open_desk: Callable[..., Desk]) -> Desk:
        desk = open_desk({"camera": LENS})
        desk.controller.select("ring_1")
        desk.controller.set_tool(clicking=True)
        desk.settle()
        return desk

    def test_a_click_on_the_mesh_takes_that_very_point(self, clicking: Desk) -> None:
        at = pixel_middle(clicking.on("ring_1"))
        clicking.click(at)
        point = clicking.controller.pending_point
        assert point is not None
        seen = clicking.main.screen.project(clicking.pose() @ np.array(point))
        assert seen == pytest.approx(at, abs=1e-6)
        x, y, z = point
        # On the surface of the torus.
        off = np.hypot(np.hypot(x, y) - 0.05, z) - 0.018
        assert abs(off) < 2e-4
        assert edits(clicking) == []

    def test_the_next_click_sets_the_pixel_of_the_recorded_image(self, clicking: Desk) -> None:
        clicking.click(clicking.on("ring_1"))
        point = clicking.controller.pending_point
        for _ in range(12):
            clicking.event("MouseWheelForward", (200, 100))
        at = np.array([231.5, 87.5])
        expected = clicking.main.recorded_pixel(at)
        clicking.click(at)
        clicks = clicking.session.object("ring_1").clicks[0]
        assert [(c.u, c.v) for c in clicks] == [pytest.approx(expected)]
        assert tuple(clicks[0].point) == point
        assert clicking.controller.pending_point is None
        # Zoomed in, half a screen pixel is a small part of a pixel of the image.
        assert clicking.main.window.scale > 10
        assert clicks[0].u != pytest.approx(round(clicks[0].u), abs=1e-3)

    def test_a_click_beside_the_mesh_says_what_to_do(self, clicking: Desk) -> None:
        clicking.click((8, 470))
        assert clicking.controller.pending_point is None
        assert "mesh of ring_1" in clicking.messages()[-1]

    def test_a_pixel_outside_the_image_is_refused(self, open_desk: Callable[..., Desk]) -> None:
        desk = open_desk(sizes=((640, 600),))
        desk.controller.select("ring_1")
        desk.controller.set_tool(clicking=True)
        desk.click(desk.on("ring_1"))
        desk.click((320, 590))  # below the image
        assert "inside the image" in desk.messages()[-1]
        assert desk.controller.pending_point is not None

    def test_dragging_pans_instead_of_clicking(self, clicking: Desk) -> None:
        for _ in range(4):
            clicking.event("MouseWheelForward", (320, 240))
        before = clicking.main.window
        clicking.drag(clicking.on("ring_1"), (30, 0))
        assert clicking.controller.pending_point is None
        assert clicking.main.window.x == pytest.approx(before.x + 30)

    def test_a_marker_is_dragged_to_its_place(self, clicking: Desk) -> None:
        click = Click(u=100.0, v=80.0, point=[0.05, 0.0, 0.018])
        clicking.controller.apply(AddClick(object="ring_1", frame=0, click=click))
        clicking.settle()
        at = pixel_middle(clicking.main.screen_of_recorded(np.array([[100.0, 80.0]]))[0])
        clicking.drag(at, (3, 4), (24, -16))
        moved = clicking.session.object("ring_1").clicks[0][0]
        assert (moved.u, moved.v) == pytest.approx(
            clicking.main.recorded_pixel(at + np.array([24, -16]))
        )
        assert moved.point == click.point

    def test_escape_gives_up_the_point(self, clicking: Desk) -> None:
        clicking.click(clicking.on("ring_1"))
        clicking.press("Escape")
        assert clicking.controller.pending_point is None
