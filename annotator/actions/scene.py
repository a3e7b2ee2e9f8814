"""Saving, undo, and which frame is shown."""

from __future__ import annotations

from typing import TYPE_CHECKING

from annotator.actions.action import Action, asking, is_idle
from annotator.desk import alignment

if TYPE_CHECKING:
    from annotator.desk.controller import Controller


def _undo_label(c: Controller) -> str:
    if c.dragging is not None or c.session.undoable is None:
        return "Undo"
    return f"Undo {c.session.undoable.title}"


def _redo_label(c: Controller) -> str:
    return "Redo" if c.session.redoable is None else f"Redo {c.session.redoable.title}"


def _swap(view: int) -> Action:
    return Action(
        f"swap_{view}",
        "Frame",
        f"Side view {view} into the main view",
        (f"Ctrl+{view}",),
        "Look at the frame of a side view in the main view; the main one goes to the side.",
        lambda c: c.swap_into_main(view),
        enabled=lambda c: view < len(c.view_frames),
        group="swap",
    )


SCENE_ACTIONS: tuple[Action, ...] = (
    asking(
        "open",
        "open",
        "File",
        "Open scene...",
        ("Ctrl+O",),
        "Open another scene folder.",
        group="open",
    ),
    asking(
        "add_mesh",
        "add_mesh",
        "File",
        "Add mesh...",
        ("Ctrl+M",),
        "Copy a CAD mesh (OBJ, PLY, GLB, STL, OFF) into the scene's mesh library.",
        enabled=lambda c: c.session.writable,
        group="mesh",
    ),
    Action(
        "save",
        "File",
        "Save",
        ("Ctrl+S",),
        "Write the labels into the scene. Edits are journalled all the time: a crash loses none.",
        alignment.save,
        enabled=lambda c: c.session.writable,
        group="save",
    ),
    asking(
        "propagate",
        "propagate",
        "File",
        "Save and propagate...",
        ("Ctrl+P",),
        "Save, then carry every label to all frames.",
        enabled=lambda c: c.session.writable and c.session.posed and is_idle(c),
        group="save",
    ),
    asking(
        "close", "close", "File", "Close", ("Ctrl+Q",), "Leave; no edit is lost.", group="close"
    ),
    Action(
        "undo",
        "Edit",
        "Undo",
        ("Ctrl+Z",),
        "Take the last edit back; there is no limit.",
        lambda c: c.undo(),
        enabled=lambda c: c.can_undo,
        label=_undo_label,
    ),
    Action(
        "redo",
        "Edit",
        "Redo",
        ("Ctrl+Shift+Z", "Ctrl+Y"),
        "Make the edit again that was taken back.",
        lambda c: c.redo(),
        enabled=lambda c: c.session.redoable is not None,
        label=_redo_label,
    ),
    Action(
        "cancel",
        "Edit",
        "Cancel",
        ("Esc",),
        "Stop a drag or a computation; what it would have changed stays as it was.",
        lambda c: c.cancel(),
        group="cancel",
    ),
    Action(
        "next_frame",
        "Frame",
        "Next frame",
        ("Ctrl+Right",),
        "Show the next frame in the main view.",
        lambda c: c.step_frame(1),
        repeats=True,
    ),
    Action(
        "previous_frame",
        "Frame",
        "Previous frame",
        ("Ctrl+Left",),
        "Show the frame before in the main view.",
        lambda c: c.step_frame(-1),
        repeats=True,
    ),
    Action(
        "first_frame",
        "Frame",
        "First frame",
        ("Ctrl+Home",),
        "Show the first frame in the main view.",
        lambda c: c.show_frame(c.session.scene.frames[0].id),
    ),
    *(_swap(view) for view in (1, 2, 3)),
    asking(
        "shortcuts",
        "shortcuts",
        "Help",
        "Keys and mouse",
        ("F1",),
        "All keys and what the mouse does in the views.",
    ),
    asking("about", "about", "Help", "About", (), "Version, and where the guide is."),
)
