"""Actions on the scene and the views: save, undo, frames, how the scene is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from annotator.app import operations
from annotator.app.action import Action, busy, dialog_action, not_placed, read_only
from annotator.app.view_options import CloudSource, Mode, Style

if TYPE_CHECKING:
    from annotator.app.controller import Controller


def _style(style: Style, key: str, tip: str) -> Action:
    return Action(
        f"style_{style}",
        "View",
        style.value.capitalize(),
        (key,),
        tip,
        lambda c: c.set_options(style=style),
        lambda c: c.options.style is style,
        group="style",
    )


def _switch(id: str, title: str, key: str, tip: str, field: str, group: str) -> Action:
    return Action(
        id,
        "View",
        title,
        (key,) if key else (),
        tip,
        lambda c: c.set_options(**{field: not getattr(c.options, field)}),
        lambda c: bool(getattr(c.options, field)),
        group=group,
    )


def _mode(mode: Mode, title: str, tip: str) -> Action:
    return Action(
        f"mode_{mode}",
        "View",
        title,
        (),
        tip,
        lambda c: c.set_mode(mode),
        lambda c: c.mode is mode,
        group="mode",
    )


def _toggle_mode(c: Controller) -> None:
    c.set_mode(Mode.CLOUD if c.mode is Mode.IMAGE else Mode.IMAGE)


def _toggle_table(c: Controller) -> None:
    c.set_options(table=not c.options.table)
    if c.options.table and c.table is None:
        c.tell(f"The table is not known: {c.table_problem or 'it is still searched for'}.")


def _opacity(c: Controller, by: float) -> None:
    c.set_options(opacity=round(min(max(c.options.opacity + by, 0.1), 1.0), 2))


def _no_camera_poses(c: Controller) -> str:
    return "" if c.session.posed else "the scene has no camera poses"


VIEW_ACTIONS: tuple[Action, ...] = (
    _mode(Mode.IMAGE, "Image", "Show the frame's image in the main view."),
    _mode(Mode.CLOUD, "Cloud", "Show the 3D point cloud in the main view."),
    Action(
        "toggle_mode",
        "View",
        "Image or point cloud",
        ("Tab",),
        "Switch the main view between the 2D image and the 3D point cloud.",
        _toggle_mode,
        group="mode",
    ),
    _style(Style.SOLID, "1", "Meshes as shaded surfaces over the image."),
    _style(Style.WIREFRAME, "2", "Meshes as wireframes."),
    _style(Style.CONTOUR, "3", "Only the silhouette: compare it with the edges in the image."),
    _style(
        Style.TEXTURED,
        "4",
        "Meshes with their texture or vertex colours: compare the texture with the image.",
    ),
    Action(
        "more_opaque",
        "View",
        "More opaque",
        ("]",),
        "Less of the image shines through the meshes.",
        lambda c: _opacity(c, 0.1),
        repeats=True,
        group="opacity",
    ),
    Action(
        "less_opaque",
        "View",
        "More transparent",
        ("[",),
        "More of the image shines through the meshes.",
        lambda c: _opacity(c, -0.1),
        repeats=True,
        group="opacity",
    ),
    _switch("blink", "Blink", "B", "Let the meshes come and go over the image.", "blink", "what"),
    _switch("hide", "Hide meshes", "H", "Show the bare image or cloud.", "hidden", "what"),
    _switch(
        "only_selected",
        "Only the selected object",
        "I",
        "Leave the other objects out of the views.",
        "only_selected",
        "what",
    ),
    _switch(
        "contour_always",
        "Contour over every style",
        "K",
        "Draw the silhouette over the meshes in the other styles, too.",
        "contour_always",
        "style",
    ),
    Action(
        "fused_cloud",
        "View",
        "Cloud of many frames",
        ("U",),
        "Show the points of many frames together instead of those of one.",
        lambda c: c.set_options(
            cloud=CloudSource.FRAME if c.options.cloud is CloudSource.FUSED else CloudSource.FUSED
        ),
        lambda c: c.options.cloud is CloudSource.FUSED,
        _no_camera_poses,
        group="cloud",
    ),
    Action(
        "table",
        "View",
        "Table plane",
        ("T",),
        "Draw the table plane in the cloud.",
        _toggle_table,
        lambda c: c.options.table,
        group="cloud",
    ),
    _switch(
        "penetration",
        "Show penetration",
        "",
        "Paint red where objects run into each other or into the table.",
        "penetration",
        "what",
    ),
    Action(
        "fit_view",
        "View",
        "Whole image",
        ("Home",),
        "Undo zooming and panning in the main view.",
        operations.fit_view,
        group="look",
    ),
    _switch(
        "maximised",
        "Only the view in hand",
        "F",
        "Show the view that was clicked last alone and large; again to show all views.",
        "maximised",
        "look",
    ),
    Action(
        "zoom_object",
        "View",
        "Zoom to the object",
        ("Space",),
        "Bring the selected object close in every view.",
        operations.zoom_to_object,
        problem=not_placed,
        group="look",
    ),
    dialog_action(
        "panels",
        "View",
        "Go to the panels",
        ("F6",),
        "Give the keys to the fields of the panels, one after the other; Esc gives them back.",
        group="look",
    ),
    dialog_action(
        "light_theme",
        "View",
        "Light theme",
        (),
        "Dark words on light panels. Images and clouds keep their dark background.",
        checked=lambda c: c.light,
        group="theme",
    ),
    dialog_action(
        "larger_text",
        "View",
        "Larger text",
        ("Ctrl++", "Ctrl+="),
        "Larger words in all panels, in steps up to one and a half times.",
        group="theme",
    ),
    dialog_action(
        "smaller_text",
        "View",
        "Smaller text",
        ("Ctrl+-",),
        "Smaller words in all panels.",
        group="theme",
    ),
)


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
        problem=lambda c: "" if view < len(c.view_frames) else "there is no such side view",
        group="swap",
    )


SCENE_ACTIONS: tuple[Action, ...] = (
    dialog_action(
        "open",
        "File",
        "Open scene...",
        ("Ctrl+O",),
        "Open another scene folder.",
        group="open",
    ),
    dialog_action(
        "add_mesh",
        "File",
        "Add mesh...",
        ("Ctrl+M",),
        "Copy a CAD mesh (OBJ, PLY, GLB, STL, OFF) into the scene's mesh library.",
        problem=read_only,
        group="mesh",
    ),
    Action(
        "save",
        "File",
        "Save",
        ("Ctrl+S",),
        "Write the labels into the scene. Edits are journalled all the time: a crash loses none.",
        operations.save,
        problem=read_only,
        group="save",
    ),
    dialog_action(
        "propagate",
        "File",
        "Save and propagate...",
        ("Ctrl+P",),
        "Save, then carry every label to all frames.",
        problem=lambda c: read_only(c) or _no_camera_poses(c) or busy(c),
        group="save",
    ),
    dialog_action("close", "File", "Close", ("Ctrl+Q",), "Leave; no edit is lost.", group="close"),
    Action(
        "undo",
        "Edit",
        "Undo",
        ("Ctrl+Z",),
        "Take the last edit back; there is no limit.",
        lambda c: c.undo(),
        problem=lambda c: "" if c.can_undo else "there is no edit to take back",
        label=_undo_label,
    ),
    Action(
        "redo",
        "Edit",
        "Redo",
        ("Ctrl+Shift+Z", "Ctrl+Y"),
        "Make the edit again that was taken back.",
        lambda c: c.redo(),
        problem=lambda c: "" if c.session.redoable is not None else "no edit was taken back",
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
    dialog_action(
        "commands",
        "Help",
        "Find a command...",
        ("Ctrl+Shift+P", "Ctrl+K"),
        "List all commands, objects, meshes and frames by name; type to filter, Return runs.",
    ),
    dialog_action(
        "shortcuts",
        "Help",
        "Keys and mouse",
        ("F1",),
        "All keys and what the mouse does in the views.",
    ),
    dialog_action("about", "Help", "About", (), "Version, and where the guide is."),
)
