"""How the views show the scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from annotator.actions.action import Action, has_placed
from annotator.desk import alignment
from annotator.desk.view_options import CloudSource, Mode, Style

if TYPE_CHECKING:
    from annotator.desk.controller import Controller


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
        "Draw the silhouette over solid and wireframe meshes, too.",
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
        lambda c: c.session.posed,
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
        alignment.fit_view,
        group="look",
    ),
    Action(
        "zoom_object",
        "View",
        "Zoom to the object",
        ("Space",),
        "Bring the selected object close in every view.",
        alignment.zoom_to_object,
        enabled=has_placed,
        group="look",
    ),
)
