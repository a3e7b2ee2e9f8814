"""Mouse and keyboard input of one view: handles, objects, clicks, zoom, pan and orbit.

Events come from the plotter's VTK interactor, so that a Qt widget, an off-screen plotter and a
browser share the code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from annotator.app.controller import Controller
from annotator.app.view_options import Mode
from annotator.views import drags, gizmo, interaction, scene_view
from std_toolkit.geometry import SE3, so3_exp

# Numbers of VTK's pointer shapes (vtkRenderWindow.h).
VTK_CURSOR_DEFAULT, VTK_CURSOR_HAND, VTK_CURSOR_CROSSHAIR = 0, 9, 10

# Pointer motion at which a press becomes a drag.
DRAG_PX = 3.0

ZOOM_STEP = 1.18

# Wheel notches within this time are one edit.
WHEEL_PAUSE_S = 0.4

# A trackball of the size of a small object rotates it too fast.
SMALLEST_TRACKBALL_PX = 60.0

Later = Callable[[float, Callable[[], None]], None]


class Motion(Protocol):
    """Redraws a view whose eye moves, and knows the other pointers."""

    def moved(self, view: scene_view.SceneView) -> None: ...
    def end_wheels(self) -> None: ...


class Pointer:
    """Turns the events of a view's interactor into calls of the controller.

    Args:
        motion: notified when the eye of the view or the highlight changes.
        later: calls a function after a delay in seconds.
    """

    def __init__(
        self, view: scene_view.SceneView, controller: Controller, *, motion: Motion, later: Later
    ) -> None:
        self.view, self.controller = view, controller
        self._motion, self._later = motion, later
        self._gesture: interaction.Gesture | None = None
        self._pressed_at: NDArray[np.float64] | None = None
        self._pressing = self._dragging = False
        self._in_front: str | None = None
        self._wheel_turn = 0
        self._events = interaction.Events(
            view.plotter,
            {
                "LeftButtonPressEvent": self._left_pressed,
                "LeftButtonReleaseEvent": self._released,
                "MiddleButtonPressEvent": self._other_pressed,
                "MiddleButtonReleaseEvent": self._released,
                "RightButtonPressEvent": self._other_pressed,
                "RightButtonReleaseEvent": self._released,
                "MouseMoveEvent": self._moved,
                "MouseWheelForwardEvent": lambda *_: self._wheel(1),
                "MouseWheelBackwardEvent": lambda *_: self._wheel(-1),
                "LeaveEvent": lambda *_: self._hover(None),
                "KeyPressEvent": self._key,
            },
        )
        self._interactor = self._events.interactor

    @property
    def busy(self) -> bool:
        """Whether a button is held."""
        return self._pressing or self._gesture is not None

    def close(self) -> None:
        self._events.close()

    def at(self) -> NDArray[np.float64]:
        """Screen position (2,) of the pointer: the centre of its pixel."""
        x, y = self._interactor.GetEventPosition()
        return np.array([x + 0.5, self.view.size[1] - y - 0.5])

    # --- buttons --------------------------------------------------------------------------------

    def _left_pressed(self, *_: object) -> None:
        self._pressing = True
        try:
            self._press_left()
        finally:
            self._pressing = False

    def _press_left(self) -> None:
        self._motion.end_wheels()
        self.controller.activate_view(self.view.slot)
        at = self.at()
        if self._interactor.GetRepeatCount() and self.view.slot:
            self.controller.swap_into_main(self.view.slot)
            return
        self._begin(self._left_gesture(at), at)

    def _left_gesture(self, at: NDArray[np.float64]) -> interaction.Gesture:
        if self.controller.clicking:
            index = interaction.marker_at(self.view, at)
            if index is not None and self.controller.session.writable:
                return interaction.MarkerGesture(self.view, index)
            return self._background()
        frame = self.view.gizmo_frame()
        handle = frame.hit(self.controller.gizmo, at) if frame is not None else None
        shift = bool(self._interactor.GetShiftKey())
        control = bool(self._interactor.GetControlKey())
        selected = self.controller.selected
        if shift or control:
            handle = None  # these modifiers drag the object itself
        if frame is not None and handle is not None and selected is not None:
            pose = self.view.T_eye_obj(selected)
            assert pose is not None
            return self._pose_gesture(selected, frame.grab(handle, at, pose), "gizmo", handle)
        picked = self._grabbed(at)
        if shift and (name := picked[0] if picked else selected) is not None:
            return self._trackball(name, at)
        if picked is None:
            return self._background()
        name, depth = picked
        self.controller.select(name)
        pose = self.view.T_eye_obj(name)
        assert pose is not None
        grabbed = self.view.screen.ray(at) * depth
        normal = self._table_normal() if control else None
        return self._pose_gesture(
            name, drags.PlaneDrag(self.view.screen, grabbed, pose, normal), "drag"
        )

    def _grabbed(self, at: NDArray[np.float64]) -> tuple[str, float] | None:
        """Return the object that a drag moves, and the depth of the point under the pointer.

        The selected object has priority, even if it is occluded at the pointer, because its contour
        is visible. A click without a drag selects the foremost object.
        """
        objects, selected = self.view.objects, self.controller.selected
        foremost = objects.pick(self.view, at)
        depth = None if selected is None else objects.depth_on(self.view, selected, at)
        if foremost is None or selected is None or depth is None:
            return foremost
        self._in_front = foremost[0]
        return selected, depth

    def _table_normal(self) -> NDArray[np.float64] | None:
        """Return (3,) in eye coordinates; None, and a message, if the table is unknown."""
        controller = self.controller
        if controller.table is None:
            problem = controller.table_problem or "the search is still running"
            controller.tell(f"The table is not known: {problem}.", "warning")
            return None
        return self.view.up()

    def _trackball(self, name: str, at: NDArray[np.float64]) -> interaction.Gesture:
        self.controller.select(name)
        pose, solid = self.view.T_eye_obj(name), self.view.solid(name)
        if pose is None or solid is None:
            return self._background()
        centre = pose @ solid.shape.centre
        radius = solid.shape.radius / self.view.screen.pixel_m(float(centre[2]))
        radius = max(radius, SMALLEST_TRACKBALL_PX * self.view.pixel_ratio)
        return self._pose_gesture(name, drags.TrackballDrag(centre, radius, at, pose), "drag")

    def _pose_gesture(
        self, name: str, drag: drags.Drag, method: str, handle: gizmo.Handle | None = None
    ) -> interaction.Gesture:
        if not self.controller.session.writable:
            return self._background()
        self.view.held = handle
        return interaction.PoseGesture(self.view, name, drag, method)

    def _background(self) -> interaction.Gesture:
        return (
            interaction.OrbitGesture(self.view)
            if self.view.mode is Mode.CLOUD
            else interaction.PanGesture(self.view)
        )

    def _other_pressed(self, *_: object) -> None:
        self._motion.end_wheels()
        if self._gesture is None:
            self._begin(interaction.PanGesture(self.view), self.at())

    def _begin(self, gesture: interaction.Gesture, at: NDArray[np.float64]) -> None:
        self._gesture, self._pressed_at, self._dragging = gesture, at, False

    def _moved(self, *_: object) -> None:
        at = self.at()
        if self._gesture is None or self._pressed_at is None:
            self._hover(at)
            return
        if not self._dragging:
            if np.abs(at - self._pressed_at).max() < DRAG_PX * self.view.pixel_ratio:
                return
            self._dragging = True
            self._gesture.start(self._pressed_at)
        self._gesture.to(at)
        if self._gesture.moves_view:
            self._motion.moved(self.view)

    def _released(self, *_: object) -> None:
        gesture, self._gesture = self._gesture, None
        in_front, self._in_front = self._in_front, None
        if gesture is None:
            return
        self.view.held = None
        if self._dragging:
            gesture.finish()
        elif self.controller.clicking and not isinstance(gesture, interaction.MarkerGesture):
            self._click(self.at())
        elif in_front is not None:
            self.controller.select(in_front)
        self._motion.moved(self.view)

    def _click(self, at: NDArray[np.float64]) -> None:
        if self.controller.pending_point is None:
            interaction.pick_point(self.view, at)
        else:
            interaction.add_pixel(self.view, at)

    # --- keys, wheel, hovering ------------------------------------------------------------------

    def _key(self, *_: object) -> None:
        if self._interactor.GetKeySym() == "Escape":
            self.cancel()

    def cancel(self) -> None:
        """Cancel the gesture; without a button held, cancel the controller's operation."""
        gesture, self._gesture = self._gesture, None
        self.view.held = None
        if gesture is not None and self._dragging:
            gesture.cancel()
        elif gesture is None:
            self.controller.cancel()
        self._motion.moved(self.view)

    def give_up_drag(self) -> None:
        """Ignore the rest of a gesture whose drag was ended elsewhere."""
        self._wheel_turn = 0
        if self._dragging and isinstance(self._gesture, interaction.PoseGesture):
            self._gesture = None
            self.view.held = None

    def _wheel(self, notches: int) -> None:
        if self._gesture is not None:
            return
        if self._interactor.GetControlKey() or self._interactor.GetShiftKey():
            self._wheel_object(notches)
            return
        at = self.at()
        view = self.view
        if view.mode is Mode.CLOUD:
            point = view.point_under(at)
            view.eye.approach(view.T_ref_cam, point, ZOOM_STEP**notches)
        else:
            view.eye.zoom(ZOOM_STEP**notches, at, view.camera, view.size)
        self._motion.moved(view)

    def _wheel_object(self, notches: int) -> None:
        """Move the selected object by one step: with Shift about the table's normal, else in depth.

        Up turns its near side to the right, or moves it away along the viewing ray of its centre.
        """
        controller, view, name = self.controller, self.view, self.controller.selected
        pose = view.T_eye_obj(name) if name is not None else None
        solid = view.solid(name) if name is not None else None
        if name is None or pose is None or solid is None or not controller.session.writable:
            return
        controller.activate_view(view.slot)
        if not controller.may_move(name):
            return
        centre = pose @ solid.shape.centre
        if self._interactor.GetShiftKey():
            R = so3_exp(notches * np.deg2rad(controller.step) * view.up())
            change = SE3(R, centre - R @ centre)
        else:
            sight = centre / np.linalg.norm(centre)
            change = SE3(np.eye(3), notches * controller.step / 1000 * sight)
        controller.drag_to(name, view.frame, view.T_eye_cam.inverse() @ change @ pose)
        self._wheel_turn += 1
        turn = self._wheel_turn
        self._later(WHEEL_PAUSE_S, lambda: self.end_wheel(turn))

    def end_wheel(self, turn: int | None = None) -> None:
        """Commit the wheel motion as one edit.

        Args:
            turn: number of a wheel event; does nothing if a later one occurred.
        """
        if self._wheel_turn and turn in (None, self._wheel_turn):
            self._wheel_turn = 0
            self.controller.end_drag("drag")

    def _hover(self, at: NDArray[np.float64] | None) -> None:
        frame = self.view.gizmo_frame() if at is not None else None
        if frame is not None and at is not None:
            handle = frame.hit(self.controller.gizmo, at)
        else:
            handle = None
        cursor = VTK_CURSOR_DEFAULT
        if self.controller.clicking:
            cursor = VTK_CURSOR_CROSSHAIR
        elif handle is not None:
            cursor = VTK_CURSOR_HAND
        self.view.layers.window.SetCurrentCursor(cursor)
        if handle != self.view.hovered:
            self.view.hovered = handle
            self.view.draw()
