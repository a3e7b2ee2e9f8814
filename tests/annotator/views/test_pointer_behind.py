"""Objects behind each other: what a drag takes, and what a click selects."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from views_desk import Desk, edits, pixel_middle

from annotator.app.view_options import Gizmo
from std_toolkit.geometry import SE3

# In the middle of the ring's body, mesh frame.
ON_RING = np.array([0.05, 0.0, 0.0])


def over_both(desk: Desk) -> NDArray[np.float64]:
    """Where the ring is behind the box."""
    at = desk.main.screen.project(desk.pose("ring_1") @ ON_RING)
    picked = desk.main.objects.pick(desk.main, at)
    assert picked is not None and picked[0] == "box_1"
    assert desk.main.objects.pick_on(desk.main, "ring_1", at) is not None
    return np.asarray(at)


@pytest.fixture
def hidden(desk: Desk) -> Desk:
    """The ring is selected, and the box stands right before it."""
    desk.controller.set_tool(gizmo=Gizmo.OFF)
    pose = desk.pose("ring_1")
    desk.controller.drag_to("box_1", 0, SE3(pose.R, 0.7 * (pose @ ON_RING)))
    desk.controller.end_drag()
    desk.controller.select("ring_1")
    desk.settle()
    return desk


@pytest.mark.parametrize("keys", [{}, {"shift": True}, {"ctrl": True}])
def test_the_selected_one_is_taken_even_behind_another(hidden: Desk, keys: dict[str, bool]) -> None:
    at = over_both(hidden)
    ring, box = hidden.pose("ring_1").matrix(), hidden.pose("box_1").matrix()
    hidden.drag(at, (20, 10), (40, 20), **keys)
    assert hidden.controller.selected == "ring_1"
    assert (hidden.pose("ring_1").matrix() != ring).any()
    assert (hidden.pose("box_1").matrix() == box).all()


def test_the_point_of_the_hidden_one_stays_under_the_pointer(hidden: Desk) -> None:
    at = pixel_middle(over_both(hidden))
    point = hidden.main.objects.pick_on(hidden.main, "ring_1", at)
    assert point is not None
    hidden.drag(at, (30, -12))
    seen = hidden.main.screen.project(hidden.pose("ring_1") @ point)
    assert seen == pytest.approx(at + np.array([30, -12]), abs=1e-6)


def test_a_click_selects_what_lies_in_front_of_the_selected_one(hidden: Desk) -> None:
    hidden.click(over_both(hidden))
    assert hidden.controller.selected == "box_1"
    assert len(edits(hidden)) == 1  # of the fixture


def test_a_click_that_escape_ends_selects_nothing(hidden: Desk) -> None:
    at = over_both(hidden)
    hidden.event("LeftButtonPress", at)
    hidden.press("Escape")
    hidden.event("LeftButtonRelease", at)
    hidden.click((8, 470), button="Right")
    assert hidden.controller.selected == "ring_1"
