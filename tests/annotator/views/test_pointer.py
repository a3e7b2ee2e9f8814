"""Mouse and keys: presses, drags and wheels of VTK's interactor become edits and looks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from views_desk import Desk, edits, pixel_middle

from annotator.app.view_options import Gizmo, Mode
from annotator.views.gizmo import Handle, Part
from std_toolkit.geometry import SE3, rotation_angle


class TestObjects:
    def test_a_click_selects_and_changes_nothing(self, desk: Desk) -> None:
        desk.click(desk.on("box_1"))
        assert desk.controller.selected == "box_1"
        desk.click(desk.on("ring_1"))
        assert desk.controller.selected == "ring_1"
        assert edits(desk) == []

    def test_a_hand_that_trembles_moves_nothing(self, desk: Desk) -> None:
        desk.drag(desk.on("box_1"), (2, -1))
        assert edits(desk) == []

    def test_dragging_keeps_the_grabbed_point_under_the_pointer(self, desk: Desk) -> None:
        desk.controller.set_tool(gizmo=Gizmo.OFF)
        start = pixel_middle(desk.on("ring_1"))
        hit = desk.main.objects.pick(desk.main, start)
        assert hit is not None
        point = desk.pose().inverse() @ (desk.main.screen.ray(start) * hit[1])
        desk.drag(start, (20, 5), (57, -31))
        here = desk.pose() @ point
        assert desk.main.screen.project(here) == pytest.approx(
            start + np.array([57, -31]), abs=1e-6
        )
        assert here[2] == pytest.approx(hit[1])  # parallel to the image
        assert len(edits(desk)) == 1
        assert desk.session.object("ring_1").placements[0].method == "drag"

    def test_all_views_follow_before_the_button_is_let_go(self, desk: Desk) -> None:
        before = desk.views.views[1].T_eye_obj("ring_1")
        desk.drag(desk.on("ring_1"), (40, 0), release=False)
        after = desk.views.views[1].T_eye_obj("ring_1")
        assert before is not None and after is not None
        assert np.linalg.norm(after.t - before.t) > 0.01
        assert edits(desk) == []

    def test_undo_brings_the_pose_back_bit_for_bit(self, desk: Desk) -> None:
        before = desk.pose().matrix()
        desk.drag(desk.on("ring_1"), (40, 20))
        assert (desk.pose().matrix() != before).any()
        desk.controller.undo()
        assert (desk.pose().matrix() == before).all()

    def test_escape_puts_it_back(self, desk: Desk) -> None:
        before = desk.pose().matrix()
        desk.drag(desk.on("ring_1"), (40, 20), release=False)
        desk.press("Escape")
        assert (desk.pose().matrix() == before).all()
        pose = desk.main.T_eye_obj("ring_1")
        assert pose is not None and (pose.matrix() == before).all()
        desk.event("LeftButtonRelease", (100, 100))
        assert edits(desk) == []

    def test_a_drag_given_up_by_the_window_s_key_does_not_come_back(self, desk: Desk) -> None:
        before = desk.pose().matrix()
        start = desk.on("ring_1")
        desk.drag(start, (40, 20), release=False)
        desk.controller.cancel()  # Esc is a key of the window
        desk.event("MouseMove", start + np.array([60, 30]))
        assert desk.controller.dragging is None
        desk.event("LeftButtonRelease", start + np.array([60, 30]))
        assert (desk.pose().matrix() == before).all()
        assert edits(desk) == []

    def test_a_key_during_a_drag_goes_on_from_where_the_object_is_seen(self, desk: Desk) -> None:
        desk.controller.set_tool(gizmo=Gizmo.OFF)
        start = desk.on("ring_1")
        desk.drag(start, (40, 0), release=False)
        seen = desk.main.T_eye_obj("ring_1")
        assert seen is not None
        desk.controller.nudge(shift=(0, 1, 0))
        assert desk.pose().t - seen.t == pytest.approx([0, 0.001, 0], abs=1e-12)
        desk.event("MouseMove", start + np.array([80, 0]))
        desk.event("LeftButtonRelease", start + np.array([80, 0]))
        assert len(edits(desk)) == 2

    def test_in_a_side_view_it_is_moved_in_that_view_s_frame(self, desk: Desk) -> None:
        start = pixel_middle(desk.on("ring_1", view=1))
        before = desk.pose(frame=1)
        desk.drag(start, (20, 10), view=1)
        shift = desk.pose(frame=1).t - before.t
        assert shift[2] == pytest.approx(0.0, abs=1e-9)
        assert shift[0] > 0.005 and shift[1] > 0.002
        assert desk.controller.active_view == 1

    def test_the_foremost_object_is_taken(self, desk: Desk) -> None:
        pose = desk.pose("ring_1")
        ahead = SE3(pose.R, pose.t * 0.7)
        desk.controller.drag_to("box_1", 0, ahead)
        desk.controller.end_drag()
        desk.settle()
        desk.click(desk.on("box_1"))
        assert desk.controller.selected == "box_1"

    def test_shift_turns_about_the_centre(self, desk: Desk) -> None:
        before = desk.pose()
        desk.drag(desk.on("ring_1"), (30, 0), shift=True)
        after = desk.pose()
        assert 0.05 < rotation_angle(after.R @ before.R.T) < 1.5
        assert after.t == pytest.approx(before.t, abs=1e-9)  # the ring's centre is its origin

    def test_a_scene_open_for_looking_is_not_moved(self, open_desk: Callable[..., Desk]) -> None:
        desk = open_desk(read_only=True)
        before = desk.pose().matrix()
        desk.drag(desk.on("ring_1"), (40, 0))
        assert (desk.pose().matrix() == before).all()
        assert desk.controller.selected == "ring_1"


class TestHandles:
    def test_an_arrow_moves_along_the_camera_s_axis(self, desk: Desk) -> None:
        desk.controller.select("ring_1")
        desk.settle()
        frame = desk.main.gizmo_frame()
        assert frame is not None
        start = frame.line(Handle(Part.ARROW, 0)).mean(axis=0)
        before = desk.pose()
        desk.drag(start, (30, 9))
        shift = desk.pose().t - before.t
        assert shift[0] == pytest.approx(30 * frame.camera.pixel_m(before.t[2]), rel=0.02)
        assert shift[1:] == pytest.approx([0, 0], abs=1e-12)
        assert desk.session.object("ring_1").placements[0].method == "gizmo"

    def test_a_ring_turns_about_the_object_s_axis(self, desk: Desk) -> None:
        desk.controller.select("box_1")
        desk.controller.set_tool(gizmo=Gizmo.TURN, axes="object")
        desk.settle()
        frame = desk.main.gizmo_frame()
        assert frame is not None
        handle = Handle(Part.RING, 1)
        line = frame.line(handle)[frame.in_front(handle)]
        start = next(p for p in line if frame.hit(Gizmo.TURN, pixel_middle(p)) == handle)
        before = desk.pose("box_1")
        desk.drag(start, (18, 12))
        turn = before.R.T @ desk.pose("box_1").R
        axis = turn @ np.array([0.0, 1.0, 0.0])
        assert axis == pytest.approx([0, 1, 0], abs=1e-9)
        assert rotation_angle(turn) > 0.05

    def test_the_handle_under_the_pointer_lights_up(self, desk: Desk) -> None:
        desk.controller.select("ring_1")
        desk.settle()
        dark = desk.main.screenshot()
        frame = desk.main.gizmo_frame()
        assert frame is not None
        desk.event("MouseMove", frame.line(Handle(Part.ARROW, 0)).mean(axis=0))
        assert desk.main.hovered == Handle(Part.ARROW, 0)
        assert (desk.main.screenshot() != dark).any()
        desk.event("MouseMove", (5, 400))
        assert desk.main.hovered is None
        assert (desk.main.screenshot() == dark).all()

    def test_while_one_is_held_the_others_are_gone(self, desk: Desk) -> None:
        desk.controller.select("ring_1")
        desk.settle()
        frame = desk.main.gizmo_frame()
        assert frame is not None
        desk.drag(frame.line(Handle(Part.ARROW, 0)).mean(axis=0), (20, 0), release=False)
        assert desk.main.held == Handle(Part.ARROW, 0)
        desk.event("LeftButtonRelease", (0, 0))
        assert desk.main.held is None


class TestLooking:
    def test_the_wheel_zooms_about_the_pointer(self, desk: Desk) -> None:
        at = np.array([420.5, 130.5])
        before = desk.main.window.to_image(at)
        for _ in range(5):
            desk.event("MouseWheelForward", at)
        assert desk.main.window.scale > 3.5
        assert desk.main.window.to_image(at) == pytest.approx(before, abs=1e-9)
        for _ in range(8):
            desk.event("MouseWheelBackward", at)
        assert desk.main.eye.window is None  # all of the image again

    def test_a_drag_beside_the_objects_pans(self, desk: Desk) -> None:
        for _ in range(4):
            desk.event("MouseWheelForward", (320, 240))
        point = desk.main.window.to_image((10.5, 470.5))
        desk.controller.select(None)
        desk.drag((10.5, 470.5), (15, -40), (33, -21))
        assert desk.main.window.to_image((43.5, 449.5)) == pytest.approx(point)
        assert edits(desk) == []

    @pytest.mark.parametrize("button", ["Middle", "Right"])
    def test_the_other_buttons_pan_even_on_an_object(self, desk: Desk, button: str) -> None:
        for _ in range(3):
            desk.event("MouseWheelForward", (320, 240))
        before = desk.main.window
        desk.drag(desk.on("ring_1"), (25, 10), button=button)
        assert desk.main.window.x == pytest.approx(before.x + 25)
        assert desk.main.window.y == pytest.approx(before.y + 10)
        assert edits(desk) == []

    def test_the_whole_image_comes_back_with_the_key(self, desk: Desk) -> None:
        from annotator.app import operations

        desk.event("MouseWheelForward", (320, 240))
        desk.event("MouseWheelForward", (100, 80), view=1)
        operations.fit_view(desk.controller)
        assert desk.main.eye.window is None
        assert desk.views.views[1].eye.window is not None
        desk.controller.activate_view(1)
        operations.fit_view(desk.controller)  # the view in hand, too
        assert desk.views.views[1].eye.window is None

    def test_zooming_to_the_object_brings_it_to_the_middle_of_every_view(self, desk: Desk) -> None:
        from annotator.app import operations

        desk.controller.select("box_1")
        operations.zoom_to_object(desk.controller)
        for view in desk.views.views:
            pose = view.T_eye_obj("box_1")
            assert pose is not None
            middle = np.array(view.size) / 2
            assert view.screen.project(pose.t) == pytest.approx(middle, abs=1e-6)
            assert view.window.scale > 1.5 * min(view.size[0] / 320, view.size[1] / 240)

    def test_a_double_click_swaps_a_side_view_into_the_main_one(self, desk: Desk) -> None:
        desk.event("LeftButtonPress", (100, 80), view=1, repeat=1)
        assert desk.controller.view_frames == [1, 0]


class TestCloud:
    @pytest.fixture
    def cloud(self, desk: Desk) -> Desk:
        desk.controller.set_mode(Mode.CLOUD)
        desk.settle()
        return desk

    def test_a_drag_beside_the_objects_goes_around_the_selected_one(self, cloud: Desk) -> None:
        cloud.controller.select("ring_1")
        cloud.controller.set_tool(gizmo=Gizmo.OFF)
        before = cloud.main.T_eye_obj("ring_1")
        cloud.drag((8, 470), (80, 0))
        after = cloud.main.T_eye_obj("ring_1")
        assert before is not None and after is not None
        assert after.t == pytest.approx(before.t, abs=1e-9)
        assert rotation_angle(after.R @ before.R.T) == pytest.approx(80 * np.pi / 640)
        assert edits(cloud) == []

    def test_the_wheel_comes_closer_to_what_is_under_the_pointer(self, cloud: Desk) -> None:
        at = pixel_middle(cloud.on("ring_1"))
        point = cloud.main.point_under(at)
        pose = cloud.main.T_eye_obj("ring_1")
        assert pose is not None
        on_mesh = pose.inverse() @ point
        cloud.event("MouseWheelForward", at)
        pose = cloud.main.T_eye_obj("ring_1")
        assert pose is not None
        here = pose @ on_mesh
        assert here[2] < 0.9 * point[2]
        assert cloud.main.screen.project(here) == pytest.approx(at, abs=1e-6)

    def test_the_wheel_finds_the_points_where_there_is_no_object(self, cloud: Desk) -> None:
        assert cloud.main.point_under(np.array([60.0, 400.0]))[2] == pytest.approx(0.8, abs=1e-3)

    def test_panning_keeps_the_point_under_the_pointer(self, cloud: Desk) -> None:
        start = pixel_middle(np.array([60.0, 300.0]))
        point = cloud.main.T_eye_cam.inverse() @ cloud.main.point_under(start)
        cloud.drag(start, (50, -20), button="Middle")
        seen = cloud.main.screen.project(cloud.main.T_eye_cam @ point)
        assert seen == pytest.approx(start + np.array([50, -20]), abs=1e-6)

    def test_an_object_is_moved_across_the_eye_s_view(self, cloud: Desk) -> None:
        cloud.controller.set_tool(gizmo=Gizmo.OFF)
        cloud.controller.select("ring_1")
        cloud.drag((8, 470), (200, 0))
        cloud.settle()
        before = cloud.main.T_eye_obj("ring_1")
        cloud.drag(cloud.on("ring_1"), (30, 0))
        cloud.settle()
        after = cloud.main.T_eye_obj("ring_1")
        assert before is not None and after is not None
        shift = after.t - before.t
        assert shift[0] > 0.01
        assert shift[1:] == pytest.approx([0, 0], abs=1e-9)
        assert len(edits(cloud)) == 1

    def test_home_goes_back_to_the_camera_of_the_frame(self, cloud: Desk) -> None:
        from annotator.app import operations

        cloud.drag((8, 470), (80, 30))
        assert cloud.main.eye.T_eye_ref is not None
        operations.fit_view(cloud.controller)
        assert cloud.main.T_eye_cam.matrix() == pytest.approx(np.eye(4))


def test_keys_of_vtk_do_nothing(desk: Desk) -> None:
    """VTK's own styles draw wireframes at "w", close at "q", and reset the camera at "r"."""
    before = desk.main.screenshot()
    interactor = desk.plotters[0].iren.interactor
    for key in "wsrqepj3":
        interactor.SetKeyEventInformation(0, 0, key, 0, key)
        interactor.InvokeEvent("KeyPressEvent")
        interactor.InvokeEvent("CharEvent")
    assert (desk.main.screenshot() == before).all()
