"""Controller shared by all front ends: session, selection, views, tools and computations.

It imports neither Qt nor VTK: the window and the browser call the same methods, and tests call
them without a display.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from annotator.app import events, tasks, view_options
from annotator.app.findings import Findings
from annotator.session import ChangeObject, Move, Session, SetPoses
from annotator.session.edits import AnyEdit, Axes
from annotator.session.edits.object_edits import refuse_locked
from annotator.session.session import Change
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3

if TYPE_CHECKING:
    from annotator.app.image_cache import ImageCache
    from annotator.app.mesh_folder import MeshFolder, MeshToPlace
    from annotator.session.state import Status
    from std_toolkit.checks.label_check import LabelCheck
    from std_toolkit.labels.support.penetration import Penetration
    from std_toolkit.labels.support.plane import TablePlane

# Steps of the keyboard: millimetres of a shift and degrees of a turn, coarse to fine.
STEPS = (10.0, 1.0, 0.1)


class Controller:
    """State of the front end and the methods that change it; belongs to the front end's thread.

    Attributes:
        session: the annotations.
        images: undistorted images of the frames.
        selected: name of the selected object, or None.
        view_frames: frame of each view; the first is the main view.
        active_view: index of the active view; keyboard steps are along its camera's axes.
        mode: content of the main view.
        options: drawing options of the views.
        step: size of a keyboard step, mm and degrees.
        axes: axes of keyboard steps and of the gizmo.
        gizmo: handles shown on the selected object.
        clicking: whether clicks set 2D-3D correspondences instead of moving the object.
        pending_point: (x, y, z) clicked on the mesh whose pixel is not clicked yet; metres.
        findings: what is known of the objects' poses; `residuals`, `ranks`, `textures`,
            `weak_directions` and `unmeasured` are its own.
        light: whether the window has its light theme; each browser has its own.
        dialogs: names of the dialogs of the front end; see `Action.asks`.
        mesh_folder: folder whose meshes are in the library, or None.
        mesh_to_place: mesh of the folder that the dialog "place_mesh" adds to the scene.
        conflict: text on the concurrent changes that the last attempt to save found.
        table: the plane on which the objects stand, if found.
        table_problem: text on why there is no table.
        penetrations: penetrations between objects or with the table, deepest first.
        penetrations_frame: the frame for which they hold; None for all frames.
        start, start_in_turn, start_aside, cancel_aside: computations in the background; see
            `tasks.Work`.
    """

    def __init__(
        self, session: Session, images: ImageCache, *, runner: tasks.Runner, view_frames: list[int]
    ) -> None:
        self.session = session
        self.images = images
        self.selected: str | None = None
        self.view_frames = list(view_frames)
        self.active_view = 0
        self.mode = view_options.Mode.IMAGE
        self.options = view_options.ViewOptions()
        self.step = STEPS[1]
        self.axes: Axes = "camera"
        self.gizmo = view_options.Gizmo.MOVE
        self.clicking = False
        self.pending_point: tuple[float, float, float] | None = None
        self.findings = Findings(session)
        self.residuals, self.ranks = self.findings.residuals, self.findings.ranks
        self.textures = self.findings.textures
        self.weak_directions = self.findings.weak_directions
        self.unmeasured = self.findings.unmeasured
        self.light = False
        self.dialogs: frozenset[str] = frozenset()
        self.mesh_folder: MeshFolder | None = None
        self.mesh_to_place: MeshToPlace | None = None
        self.conflict = ""
        self.table: TablePlane | None = None
        self.table_problem = ""
        self.penetrations: tuple[Penetration, ...] = ()
        self.penetrations_frame: int | None = None
        self._work = tasks.Work(runner, self.emit)
        self.start, self.start_aside = self._work.start, self._work.start_aside
        self.start_in_turn, self.cancel_aside = self._work.start_in_turn, self._work.cancel_aside
        self._listeners: list[Callable[[events.Event], None]] = []
        self._drag: tuple[str, int, SE3] | None = None
        session.subscribe(self._on_change)

    # --- listening ---------------------------------------------------------------------------

    def subscribe(self, listener: Callable[[events.Event], None]) -> Callable[[], None]:
        """Call `listener` with every event; returns a function that unsubscribes it."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def emit(self, event: events.Event) -> None:
        for listener in list(self._listeners):
            listener(event)

    def tell(self, text: str, level: events.Level = "info") -> None:
        """Show a message to the user."""
        self.emit(events.Event("message", text=text, level=level))

    def ask(self, dialog: str) -> None:
        """Request a dialog of the front end, such as "add_mesh"."""
        self.emit(events.Event("ask", text=dialog))

    def attempt(self, action: Callable[[], Any]) -> bool:
        """Run an action of the user and show an error as a message. Returns True on success."""
        try:
            action()
        except ToolkitError as error:
            self.tell(str(error), "error")
            return False
        return True

    def _on_change(self, change: Change) -> None:
        if change.kind == "saved":
            self.emit(events.Event("saved"))
            return
        names = {o.name for o in self.session.state.objects}
        if self.selected not in names:
            self.selected = next((n for n in change.objects if n in names), None)
            self.emit(events.Event("selected"))
        if self._drag is not None and self._drag[0] not in names:
            self._drag = None
        if change.kind == "reread":
            self.__dict__.pop("judge", None)  # meshes and images may be others
        self.findings.follow(reread=change.kind == "reread")
        self.emit(events.Event("edited", objects=change.objects, text=change.title))

    # --- looking ------------------------------------------------------------------------------

    @property
    def frame(self) -> int:
        """Frame of the main view."""
        return self.view_frames[0]

    @property
    def active_frame(self) -> int:
        """Frame of the active view."""
        return self.view_frames[self.active_view]

    def pose(self, name: str, frame: int) -> SE3 | None:
        """Return T_cam_obj to draw: that of the current drag, otherwise that of the session."""
        if self._drag is None or self._drag[0] != name:
            return self.session.pose(name, frame)
        _, dragged_in, T = self._drag
        if frame == dragged_in:
            return T
        T_world_here, T_world_there = (
            self.session.T_world_cam(frame),
            self.session.T_world_cam(dragged_in),
        )
        if T_world_here is None or T_world_there is None:
            return self.session.pose(name, frame)
        return T_world_here.inverse() @ T_world_there @ T

    @property
    def dragging(self) -> str | None:
        """Name of the object that is being dragged, or None."""
        return None if self._drag is None else self._drag[0]

    def select(self, name: str | None) -> None:
        """Select an object; raises ToolkitError if it does not exist."""
        if name is not None:
            self.session.object(name)
        if name != self.selected:
            self.selected = name
            self.pending_point = None
            self.emit(events.Event("selected"))

    def select_next(self, by: int = 1) -> None:
        names = [o.name for o in self.session.state.objects]
        if names:
            at = names.index(self.selected) if self.selected in names else -1 if by > 0 else 0
            self.select(names[(at + by) % len(names)])

    def show_frame(self, frame: int, view: int = 0) -> None:
        """Show a frame in a view; raises ToolkitError if the scene has no such frame."""
        self.session.scene.frame(frame)
        if self.view_frames[view] != frame:
            self.view_frames[view] = frame
            self.emit(events.Event("frames"))

    def step_frame(self, by: int) -> None:
        """Move the main view by a number of frames; stops at the ends."""
        ids = [f.id for f in self.session.scene.frames]
        at = min(max(ids.index(self.frame) + by, 0), len(ids) - 1)
        self.show_frame(ids[at])

    def swap_into_main(self, view: int) -> None:
        """Swap the frames of a side view and the main view."""
        frames = self.view_frames
        frames[0], frames[view] = frames[view], frames[0]
        self.emit(events.Event("frames"))

    def set_mode(self, mode: view_options.Mode) -> None:
        if mode != self.mode:
            self.mode = mode
            self.emit(events.Event("view"))

    def set_options(self, **changes: Any) -> None:
        """Change fields of `options`."""
        self.options = replace(self.options, **changes)
        self.emit(events.Event("view"))

    def set_tool(self, **changes: Any) -> None:
        """Change `step`, `axes`, `gizmo` or `clicking`."""
        for field, value in changes.items():
            if field not in ("step", "axes", "gizmo", "clicking"):
                raise AttributeError(field)
            setattr(self, field, value)
        if "clicking" in changes:
            self.pending_point = None
        self.emit(events.Event("tool"))

    def activate_view(self, view: int) -> None:
        """Set the active view: the one last clicked in."""
        if view != self.active_view:
            self.active_view = view
            self.emit(events.Event("tool"))

    # --- editing ------------------------------------------------------------------------------

    def apply(self, edit: AnyEdit) -> bool:
        """Apply an edit; shows a message and returns False if it fails.

        A current drag is committed first, so that the edit starts from the displayed state.
        """
        self.end_drag()
        return self._edit(lambda: self.session.apply(edit))

    def undo(self) -> None:
        """Undo the last edit, which may be a current drag or wheel motion."""
        if self.end_drag():
            self._edit(self.session.undo)

    def redo(self) -> None:
        """Redo the last undone edit; a current drag clears the edits to redo."""
        if self._drag is not None:
            self.end_drag()
        else:
            self._edit(self.session.redo)

    @property
    def can_undo(self) -> bool:
        return self._drag is not None or self.session.undoable is not None

    def penetrations_in(self, frame: int) -> tuple[Penetration, ...]:
        """Return the known penetrations of a frame."""
        return self.penetrations if self.penetrations_frame in (None, frame) else ()

    def _edit(self, action: Callable[[], None]) -> bool:
        if self.task is not None and self.task.alone:
            self.tell(f"{self.task.title}: wait until it is done.", "warning")
            return False
        return self.attempt(action)

    def nudge(
        self,
        *,
        shift: tuple[float, float, float] = (0, 0, 0),
        turn: tuple[float, float, float] = (0, 0, 0),
    ) -> None:
        """Move the selected object along the selected axes; values are in steps."""
        self._move(self.axes, self.step * np.array(turn), shift_mm=self.step * np.array(shift))

    def yaw(self, steps: float) -> None:
        """Turn the selected object about the table's normal; positive: its near side to the right.

        The axes of the mesh do not matter.
        """
        self._move("camera", steps * self.step * self.up(self.active_frame))

    def flip(self, axis: int, degrees: float = 180.0) -> None:
        """Rotate the selected object about one of its own axes through its centre."""
        self._move("object", degrees * np.eye(3)[axis])

    def _move(
        self,
        axes: Axes,
        turn_deg: NDArray[np.float64],
        *,
        shift_mm: NDArray[np.float64] | None = None,
    ) -> None:
        if self.selected is None:
            self.tell("Select an object first.", "warning")
            return
        shift = np.zeros(3) if shift_mm is None else shift_mm
        self.apply(
            Move(
                object=self.selected,
                frame=self.active_frame,
                axes=axes,
                shift_mm=shift.tolist(),
                turn_deg=turn_deg.tolist(),
            )
        )

    def up(self, frame: int) -> NDArray[np.float64]:
        """Up direction (3,) in the camera of a frame: the table's normal, or up in its image."""
        T_cam_plane = (
            None if self.table is None else self.session.T_cam_of(frame, self.table.plane.frame)
        )
        if self.table is None or T_cam_plane is None:
            return np.array([0.0, -1.0, 0.0])
        return np.asarray(T_cam_plane.R @ self.table.plane.normal)

    def mark(self, status: Status, *, anyway: bool = False) -> None:
        """Set the status of the selected object.

        Args:
            anyway: whether it is not known to fit; see `ChangeObject`.
        """
        if self.selected is not None:
            self.apply(ChangeObject(object=self.selected, status=status, anyway=anyway))

    def may_move(self, name: str) -> bool:
        """Return whether the pose of an object may be changed; say why not."""
        return self.attempt(lambda: refuse_locked(self.session.object(name)))

    def drag_to(self, name: str, frame: int, T_cam_obj: SE3) -> None:
        """Set the preview pose of a dragged object; `end_drag` commits it."""
        if self.session.object(name).locked:
            return
        self._drag = (name, frame, T_cam_obj)
        self.emit(events.Event("preview", objects=(name,)))

    def end_drag(self, method: str = "drag") -> bool:
        """Commit the drag as one edit; False if it fails."""
        if self._drag is None:
            return True
        name, frame, T = self._drag
        self._drag = None
        if self.apply(SetPoses.one(name, frame, T, method=method)):
            return True
        self.emit(events.Event("preview", objects=(name,)))
        return False

    def cancel(self) -> None:
        """Cancel the drag, the half-clicked point or the running computation."""
        if self._drag is not None:
            self.cancel_drag()
        elif self.pending_point is not None:
            self.pending_point = None
            self.emit(events.Event("tool"))
        elif self.task is not None and not self.task.alone:
            self.task.cancel()
            self.emit(events.Event("busy"))

    def cancel_drag(self) -> None:
        """Discard the drag; the object returns to its previous pose."""
        if self._drag is not None:
            name = self._drag[0]
            self._drag = None
            self.emit(events.Event("preview", objects=(name,)))

    # --- work that takes a while -----------------------------------------------------------------

    @cached_property
    def judge(self) -> LabelCheck:
        """The judge with what it has measured; made in the thread that needs it first."""
        from std_toolkit.checks.label_check import LabelCheck
        from std_toolkit.scene.label_verdicts import options_of_last_check

        return LabelCheck(options_of_last_check(self.session.scene))

    @property
    def task(self) -> tasks.Task | None:
        """The running computation that the user started, or None."""
        return self._work.task
