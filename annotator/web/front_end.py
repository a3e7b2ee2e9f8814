"""Browser front end of one session, shared by all connected browsers."""

from __future__ import annotations

import asyncio
import base64
import os
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from annotator.app import (
    action_table,
    background_updates,
    command_palette,
    controller,
    dialogs,
    events,
    image_cache,
    mesh_folder,
    operations,
    placing,
    pose_text,
    questions,
    tasks,
    view_options,
)
from annotator.app.palette import USUAL_TEXT
from annotator.session import ChangeClick, Session
from annotator.views import ViewSet
from annotator.views.mesh_picker import MeshPicker
from annotator.views.thumbnails import Thumbnails
from annotator.web.channel import Drop, Key, Pointer, ViewChannel
from annotator.web.page import LOCAL, build_page, page_constants, page_pose, page_state
from annotator.web.stream import StreamedPlotter
from std_toolkit.log import logger

# Shortest interval between updates of the panels, and of the progress, seconds.
REFRESH_S, BUSY_S = 0.05, 0.25
# Time for the pages to hear that they go elsewhere, seconds.
LEAVE_S = 0.5


class FrontEnd:
    """Draws a session's views for browsers and executes their input.

    Attributes:
        channel: sends images of the views and receives pointer and key events.
    """

    def __init__(
        self,
        server: Any,
        session: Session,
        meshes: mesh_folder.MeshFolder | None = None,
        *,
        home: str = "",
    ) -> None:
        self._home = home
        self._state = server.state
        self._loop = asyncio.get_running_loop()
        self._refresh_planned = False
        self._wanted_frame: int | None = None
        self._notices = events.Notices(self._show_notices, self._later)
        self._runner = tasks.ThreadRunner(self._call_soon)
        self._images = image_cache.ImageCache(session.scene)
        c = self.controller = controller.Controller(
            session,
            self._images,
            runner=self._runner,
            view_frames=view_options.choose_view_frames(session.scene, session),
        )
        c.mesh_folder = meshes
        if session.state.objects:
            c.select(session.state.objects[0].name)
        own = dict.fromkeys(LOCAL, lambda: None)  # see there
        if home:
            own["close"] = self._leave
        self.dialogs = dialogs.Dialogs(c, self._show_question, own=own)
        self._fields = pose_text.PoseFields(c)
        self._action_of = {
            k: a.id
            for a in action_table.available_actions(c.dialogs)
            if a.id not in LOCAL
            for k in a.keys
        }
        views = len(c.view_frames)
        self._build_page(server, views)
        self.channel = ViewChannel(self, views=views + 1, keys=sorted(self._action_of))
        self._streams = [self._stream(i) for i in range(views + 1)]
        repaint = {id(s.plotter): s.repaint for s in self._streams}
        self._views = ViewSet(
            c,
            [s.plotter for s in self._streams[:-1]],
            later=self._later,
            repaint=lambda plotter: repaint[id(plotter)](),
        )
        for stream, view in zip(self._streams, self._views.views, strict=False):
            stream.view = view
        last = self._streams[-1]
        self._picker = MeshPicker(
            c,
            last.plotter,
            self._views.shapes,
            self._later,
            is_seen=lambda: c.clicking,
            repaint=last.repaint,
        )
        last.view = self._picker.view
        c.subscribe(self._on_event)
        self._upkeep = background_updates.BackgroundUpdates(c)
        self._thumbnails = Thumbnails(c, self._show_thumbnails)
        operations.tell_opening(c)

    def _build_page(self, server: Any, views: int) -> None:
        session = self.controller.session
        self._state.update(page_constants(session, dialogs=self.controller.dialogs))
        self._state.update({"dialog": None, "answers": {}, "thumbnails": {}, "notices": []})
        self._state.update({"busy_share": None, "sliding": None, "fading": None, "mistyped": 0})
        self._state.update({"home": self._home, "left": False})
        self._state.update({"sought": "", "sought_object": ""})
        self._state.update({"palette": None, "light": False, "text_size": USUAL_TEXT})
        self._state.client_only(
            "sliding", "fading", "sought", "sought_object", "palette", "light", "text_size"
        )
        self._refresh()
        for name in ("act", "select", "show_frame", "answer", "close_notice", "add_object",
                     "set_number", "set_form", "copied", "paste", "set_opacity",
                     "remove_point", "commands", "run_command"):  # fmt: skip
            server.trigger(name)(getattr(self, name))
        server.controller.on_client_connected.add(self._connected)
        build_page(server, views=views)

    def _stream(self, view: int) -> StreamedPlotter:
        return StreamedPlotter(
            can_take=lambda: self.channel.can_take(view),
            send=lambda jpeg: self.channel.send(view, jpeg),
            later=self._later,
        )

    def close(self) -> None:
        """Stop all computations; the caller closes the session.

        Waits for tasks that write to the scene, because closing the session releases its lock.
        """
        task = self.controller.task
        if task is not None:
            task.cancel()
        self._thumbnails.close()
        self._upkeep.close()
        self._picker.close()
        self._views.close()
        if task is not None and task.alone:
            logger.info("waiting for: %s", task.title)
            self._runner.close(timeout=threading.TIMEOUT_MAX)
        else:
            self._runner.close()
        self._images.close()
        for stream in self._streams:
            stream.close()

    def _leave(self) -> None:
        """Save or keep the edits, and lead all pages to the board; then this process ends."""
        c = self.controller
        if c.task is not None and c.task.alone:
            c.tell(f"{c.task.title}: wait until it is done.", "warning")
            return
        c.cancel_drag()

        def react(pressed: str, _: questions.Answers = {}) -> None:  # noqa: B006 - never changed
            if pressed == "save" and not operations.save(c):
                return
            self._set(left=True)
            self._later(LEAVE_S, lambda: os.kill(os.getpid(), signal.SIGTERM))

        if c.session.writable and c.session.unsaved:
            self.dialogs.put(replace(questions.closing_question(len(c.session.steps)), react=react))
        else:
            react("")

    # --- out -------------------------------------------------------------------------------------

    def _call_soon(self, call: Callable[[], None]) -> None:
        self._loop.call_soon_threadsafe(call)

    def _later(self, seconds: float, action: Callable[[], None]) -> None:
        self._loop.call_later(seconds, action)

    def _set(self, **values: Any) -> None:
        self._state.update(values)
        self._state.flush()

    def _refresh(self) -> None:
        self._refresh_planned = False
        self._set(**page_state(self.controller, self._fields))

    def _refresh_pose(self) -> None:
        self._refresh_planned = False
        self._set(**page_pose(self.controller, self._fields))

    def _show_notices(self, notices: list[events.Notice]) -> None:
        self._set(notices=[asdict(notice) for notice in notices])

    def _show_thumbnails(self, pictures: dict[str, NDArray[np.uint8] | None]) -> None:
        self._set(thumbnails={i: _as_png(p) for i, p in pictures.items() if p is not None})

    def _show_question(self, question: questions.Question | None) -> None:
        if question is None:
            self._set(dialog=None)
        else:
            self._set(dialog=question.as_dict(), answers=question.first_answers(), sought="")

    def _on_event(self, event: events.Event) -> None:
        if event.kind == "message":
            self._notices.tell(event.text, event.level)
        elif event.kind == "ask":
            self.dialogs.ask(event.text)
        elif event.kind == "busy" and self.controller.task is not None:
            self._tell_share()
        if event.kind in ("message", "look") or self._refresh_planned:
            return
        self._refresh_planned = True
        dragging = event.kind == "preview" and self.controller.dragging is not None
        self._later(REFRESH_S, self._refresh_pose if dragging else self._refresh)

    def _tell_share(self) -> None:
        """Show the progress of the running computation until it ends."""
        task = self.controller.task
        share = None if task is None or task.fraction is None else round(100 * task.fraction)
        self._set(busy_share=share)
        if task is not None:
            self._later(BUSY_S, self._tell_share)

    def _connected(self, *_: Any, **__: Any) -> None:
        self.dialogs.recovery()

    def failed(self, error: Exception) -> None:
        """Report an unexpected error and continue."""
        self._notices.tell(f"This should not happen: {type(error).__name__}: {error}", "error")

    # --- in: the views ---------------------------------------------------------------------------

    def wanted(self, view: int) -> None:
        self._streams[view].wanted()

    def resize(self, sizes: Sequence[tuple[int, int]], ratio: float) -> None:
        for stream, (width, height) in zip(self._streams, sizes, strict=True):
            stream.resize(width, height, ratio)

    def pointer(self, event: Pointer) -> None:
        c = self.controller
        if event.kind == "double":
            if 0 < event.view < len(c.view_frames):
                c.swap_into_main(event.view)
        else:
            c.attempt(lambda: self._streams[event.view].pointer(event))

    def give_up(self, view: int) -> None:
        if view < len(self._views.pointers):
            pointer = self._views.pointers[view]
            if pointer.busy:
                pointer.cancel()
        else:
            self._streams[view].let_go()

    def key(self, event: Key) -> None:
        id = self._action_of.get(event.name)
        if id is not None and (action_table.BY_ID[id].repeats or not event.repeat):
            self.act(id)

    def drop(self, event: Drop) -> None:
        c = self.controller
        if event.view >= len(self._views.views) or not c.session.writable:
            return
        drop = placing.drop_model if event.what == "model" else placing.drop_object
        self._views.drop(
            event.view, self._streams[event.view].place(event.x, event.y), drop, event.name
        )

    # --- in: the panels --------------------------------------------------------------------------

    def act(self, id: str) -> None:
        """Run an action if it is enabled."""
        action = action_table.BY_ID.get(id)
        if action is not None and action.enabled(self.controller):
            self.controller.attempt(lambda: action.run(self.controller))

    def commands(self, typed: str) -> list[dict[str, Any]]:
        """Return the commands found for a typed text."""
        rows = command_palette.commands(self.controller, typed)
        return [{**asdict(row), "local": row.target in LOCAL} for row in rows]

    def run_command(self, kind: str, target: str) -> None:
        """Run a command of the list, if it can be run."""
        c = self.controller
        c.attempt(lambda: command_palette.run(c, kind, target))

    def select(self, name: str) -> None:
        self.controller.attempt(lambda: self.controller.select(name))

    def show_frame(self, index: int) -> None:
        """Show a frame by index; frames skipped by fast slider motion are not loaded."""
        waiting, self._wanted_frame = self._wanted_frame, int(index)
        if waiting is None:
            self._later(0.0, self._show_wanted_frame)

    def _show_wanted_frame(self) -> None:
        index, self._wanted_frame = self._wanted_frame, None
        frames = self.controller.session.scene.frames
        if index is not None and 0 <= index < len(frames):
            self.controller.attempt(lambda: self.controller.show_frame(frames[index].id))

    def answer(self, number: int, button: str, answers: dict[str, Any] | None = None) -> None:
        self.dialogs.answer(number, button, answers or {})

    def close_notice(self, number: int) -> None:
        self._notices.close(number)

    def add_object(self, model: str) -> None:
        placing.add_object(self.controller, model)

    def remove_point(self, frame: int, number: int) -> None:
        if self.controller.selected is not None:
            edit = ChangeClick(object=self.controller.selected, frame=frame, index=number)
            self.controller.apply(edit)

    def set_opacity(self, percent: float) -> None:
        self.controller.set_options(opacity=min(max(float(percent), 10), 100) / 100)

    def set_form(self, in_world: bool, form: str) -> None:
        """Set coordinate frame and rotation form of the pose fields."""
        self._fields.in_world = bool(in_world) and self.controller.session.posed
        self._fields.form = pose_text.RotationForm(form)
        self._refresh()

    def set_number(
        self, what: Literal["position", "rotation", "quaternion"], axis: int, text: str
    ) -> None:
        """Set a number of the pose, or the whole "quaternion", from typed text."""

        def enter() -> None:
            if what == "quaternion":
                self._fields.type_quaternion(text)
            elif axis in (0, 1, 2):
                self._fields.type_number(what, axis, text)

        if not self.controller.attempt(enter):
            # Recreates the field with the unchanged number.
            self._set(mistyped=self._state["mistyped"] + 1)
        self._refresh()

    def copied(self) -> None:
        """Handle that the page has copied the pose to the clipboard."""
        self._fields.tell_copied()

    def paste(self) -> None:
        """Ask for a pose as text: a page cannot read the clipboard without permission."""
        self.dialogs.ask_pose(f"mesh to {self._fields.where}", self._fields.paste)


def _as_png(rgb: NDArray[np.uint8]) -> str:
    """Return a PNG image as a data URL."""
    done, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    assert done
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode("ascii")
