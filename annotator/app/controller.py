"""What every front end shares: a session with a selection, views, tools and work under way.

No Qt and no VTK here: the window and the browser call the same methods, and tests call them
without a display.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from annotator.app import events, tasks, view_options
from annotator.session import (
    ChangeObject,
    Move,
    Session,
    SetPoses,
)
from annotator.session.edits import AnyEdit, Axes
from annotator.session.session import Change
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3

if TYPE_CHECKING:
    from annotator.app.image_cache import ImageCache
    from annotator.session.residuals import FrameResidual
    from std_toolkit.labels.support.penetration import Penetration
    from std_toolkit.labels.support.plane import TablePlane

# Steps of the keyboard: millimetres of a shift and degrees of a turn, coarse to fine.
STEPS = (10.0, 1.0, 0.1)


class Controller:
    """State of the front end, and the calls that change it; owned by the front end's thread.

    Attributes:
        session: the annotations.
        images: undistorted images of the frames.
        selected: name of the selected object, or None.
        view_frames: frame of each view; the first is the main view.
        active_view: index of the view in hand: keyboard steps are along its camera's axes.
        mode: what the main view shows.
        options: how the views draw.
        step: size of a keyboard step, mm and degrees.
        axes: what keyboard steps and the gizmo are along.
        gizmo: the handles shown on the selected object.
        clicking: clicks set 2D-3D correspondences instead of moving the object.
        pending_point: (x, y, z) on the mesh, clicked and waiting for its pixel; metres.
        residuals: of each object as last measured; gone when its pose changes.
        dialogs: names of the dialogs that the front end has; see `Action.asks`.
        conflict: what others changed too when saving was last tried, for people.
        weak_directions: sentence on what the last refinement of an object could tell least.
        table: the plane on which the objects stand, as far as it was found.
        table_problem: why there is none, for people.
        penetrations: where objects run into each other or into the table, the deepest first.
        penetrations_frame: the frame in which they do; None if it is so in all frames.
        unmeasured: names of objects whose residuals went with their last edit.
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
        self.residuals: dict[str, list[FrameResidual]] = {}
        self.dialogs: frozenset[str] = frozenset()
        self.conflict = ""
        self.weak_directions: dict[str, str] = {}
        self.table: TablePlane | None = None
        self.table_problem = ""
        self.penetrations: tuple[Penetration, ...] = ()
        self.penetrations_frame: int | None = None
        self.unmeasured: set[str] = set()
        self._work = tasks.Work(runner, self.emit)
        self._listeners: list[Callable[[events.Event], None]] = []
        self._drag: tuple[str, int, SE3] | None = None
        session.subscribe(self._on_change)

    # --- listening ---------------------------------------------------------------------------

    def subscribe(self, listener: Callable[[events.Event], None]) -> Callable[[], None]:
        """Have `listener` called with every event; returns what ends it."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def emit(self, event: events.Event) -> None:
        for listener in list(self._listeners):
            listener(event)

    def tell(self, text: str, level: events.Level = "info") -> None:
        """A sentence for the person."""
        self.emit(events.Event("message", text=text, level=level))

    def ask(self, dialog: str) -> None:
        """Have the front end open a dialog, such as "add_mesh"."""
        self.emit(events.Event("ask", text=dialog))

    def attempt(self, action: Callable[[], Any]) -> bool:
        """Run something a person asked for; an error becomes a message. True if it went well."""
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
        # A mesh that is added moves no object; a scene that was read again may move all.
        moved = change.objects
        if not moved and change.kind == "reread":
            moved = (*self.residuals, *self.weak_directions)
        for name in moved:
            self.residuals.pop(name, None)
            self.weak_directions.pop(name, None)
        self.unmeasured = (self.unmeasured | set(moved)) & names
        self.emit(events.Event("edited", objects=change.objects, text=change.title))

    # --- looking ------------------------------------------------------------------------------

    @property
    def frame(self) -> int:
        """Frame of the main view."""
        return self.view_frames[0]

    @property
    def active_frame(self) -> int:
        """Frame of the view in hand."""
        return self.view_frames[self.active_view]

    def pose(self, name: str, frame: int) -> SE3 | None:
        """T_cam_obj as it is to be drawn: that of a drag under way, else the session's."""
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
        """Name of the object under the mouse, if one is being dragged."""
        return None if self._drag is None else self._drag[0]

    def select(self, name: str | None) -> None:
        """Raises ToolkitError for an object that is not there."""
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
        """Main view to the next or an earlier frame; stops at the ends."""
        ids = [f.id for f in self.session.scene.frames]
        at = min(max(ids.index(self.frame) + by, 0), len(ids) - 1)
        self.show_frame(ids[at])

    def swap_into_main(self, view: int) -> None:
        """The frame of a side view becomes the main one and the other way round."""
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
        """The view in hand: the one last clicked in."""
        if view != self.active_view:
            self.active_view = view
            self.emit(events.Event("tool"))

    # --- editing ------------------------------------------------------------------------------

    def apply(self, edit: AnyEdit) -> bool:
        """Make an edit; False and a message if it cannot be made.

        What is being dragged stays where it is first: the edit builds upon what is seen.
        """
        self.end_drag()
        return self._edit(lambda: self.session.apply(edit))

    def undo(self) -> None:
        """Take the last edit back; what is being dragged, or was by the wheel just now, is it."""
        if self.end_drag():
            self._edit(self.session.undo)

    def redo(self) -> None:
        """Make an edit again that was taken back; after something was moved there is none."""
        if self._drag is not None:
            self.end_drag()
        else:
            self._edit(self.session.redo)

    @property
    def can_undo(self) -> bool:
        return self._drag is not None or self.session.undoable is not None

    def penetrations_in(self, frame: int) -> tuple[Penetration, ...]:
        """Those that are known of a frame."""
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
        """Move the selected object by steps along the chosen axes; units are steps."""
        if self.selected is None:
            self.tell("Select an object first.", "warning")
            return
        self.apply(
            Move(
                object=self.selected,
                frame=self.active_frame,
                axes=self.axes,
                shift_mm=[self.step * s for s in shift],
                turn_deg=[self.step * s for s in turn],
            )
        )

    def flip(self, axis: int, degrees: float = 180.0) -> None:
        """Turn the selected object about one of its own axes through its centre."""
        if self.selected is None:
            self.tell("Select an object first.", "warning")
            return
        turn = [0.0, 0.0, 0.0]
        turn[axis] = degrees
        self.apply(
            Move(object=self.selected, frame=self.active_frame, axes="object", turn_deg=turn)
        )

    def mark(self, status: str) -> None:
        """Set the status of the selected object."""
        if self.selected is not None:
            self.apply(ChangeObject(object=self.selected, status=status))  # type: ignore[arg-type]

    def drag_to(self, name: str, frame: int, T_cam_obj: SE3) -> None:
        """The object under the mouse is here now; nothing is decided until `end_drag`."""
        self._drag = (name, frame, T_cam_obj)
        self.emit(events.Event("preview", objects=(name,)))

    def end_drag(self, method: str = "drag") -> bool:
        """What was dragged stays where it is: one edit. False if that cannot be made."""
        if self._drag is None:
            return True
        name, frame, T = self._drag
        self._drag = None
        if self.apply(SetPoses.one(name, frame, T, method=method)):
            return True
        self.emit(events.Event("preview", objects=(name,)))
        return False

    def cancel(self) -> None:
        """Give up the drag, the half-clicked point or the computation under way."""
        if self._drag is not None:
            self.cancel_drag()
        elif self.pending_point is not None:
            self.pending_point = None
            self.emit(events.Event("tool"))
        elif self.task is not None and not self.task.alone:
            self.task.cancel()
            self.emit(events.Event("busy"))

    def cancel_drag(self) -> None:
        """What was dragged goes back to where it was."""
        if self._drag is not None:
            name = self._drag[0]
            self._drag = None
            self.emit(events.Event("preview", objects=(name,)))

    # --- work that takes a while -----------------------------------------------------------------

    @property
    def task(self) -> tasks.Task | None:
        """The computation that a person started and that is under way."""
        return self._work.task

    def start(
        self,
        title: str,
        work: Callable[[tasks.Task], Any],
        finish: Callable[[Any], None],
        *,
        alone: bool = False,
    ) -> tasks.Task | None:
        """Run `work(task)` aside, then `finish(result)` here; one computation at a time.

        Args:
            alone: nothing may be edited meanwhile, and it cannot be cancelled.
        """
        return self._work.start(title, work, finish, alone=alone)

    def start_aside(
        self,
        key: str,
        work: Callable[[tasks.Task], Any],
        finish: Callable[[Any], None],
        *,
        delay: float = 0.0,
    ) -> None:
        """Run `work(task)` beside everything else, then `finish(result)` here; see `Work`."""
        self._work.start_aside(key, work, finish, delay=delay)

    def cancel_aside(self, *keys: str) -> None:
        """What runs beside under these keys is not wanted any more."""
        self._work.cancel_aside(*keys)
