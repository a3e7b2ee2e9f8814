"""Table of all actions, the source of menus, tool bar, shortcuts and the tables in the guide.

`python -m annotator.app.action_table GUIDE` rewrites the tables between the marks in the guide.
"""

from __future__ import annotations

import sys
from collections.abc import Collection
from pathlib import Path

from annotator.app import object_actions, questions, view_actions
from annotator.app.action import MOUSE, Action

ACTIONS = (
    *view_actions.SCENE_ACTIONS,
    *view_actions.VIEW_ACTIONS,
    *object_actions.OBJECT_ACTIONS,
    *object_actions.ALIGN_ACTIONS,
)


MENUS = ("File", "Edit", "View", "Frame", "Object", "Align", "Help")


BY_ID = {a.id: a for a in ACTIONS}

# Groups of the tool bar, in the order of the work; "opacity" is a slider.
TOOLS = (
    ("open", "save"),
    ("undo", "redo"),
    ("mode_image", "mode_cloud"),
    ("style_solid", "style_wireframe", "style_contour", "style_textured", "opacity", "blink"),
    ("gizmo_move", "gizmo_turn", "gizmo_off", "axes"),
    ("clicking", "refine", "drop", "residuals"),
    ("done",),
)

# Main actions: shown with a name beside the icon if there is room.
SHORT_TITLES = {
    "mode_image": "Image",
    "mode_cloud": "Cloud",
    "clicking": "Points",
    "refine": "Refine",
    "drop": "Table",
    "residuals": "Measure",
    "done": "Done",
}

OPACITY_TIP = "How much of the image shines through solid and textured meshes."

BEGIN = (
    "<!-- keys: written by `python -m annotator.app.action_table docs/annotating-reference.md` -->"
)

END = "<!-- end of keys -->"


def available_actions(dialogs: Collection[str]) -> tuple[Action, ...]:
    """Return the actions of a front end that has these dialogs; see `Action.asks`."""
    return tuple(a for a in ACTIONS if not a.asks or a.asks in dialogs)


def key_rows(dialogs: Collection[str]) -> tuple[questions.Group, ...]:
    """Return keys (or gestures) and their effects by menu, for the shortcut sheet."""
    actions = [a for a in available_actions(dialogs) if a.keys]
    groups = [
        questions.Group(
            menu, tuple((" or ".join(a.keys), a.title) for a in actions if a.menu == menu), True
        )
        for menu in MENUS
    ]
    mouse = questions.Group("Mouse", tuple((m.gesture, m.effect) for m in MOUSE))
    return (*(g for g in groups if g.rows), mouse)


def key_table() -> str:
    """Return Markdown tables of mouse gestures and of the actions of each menu with their keys."""
    lines = ["| mouse | does |", "|---|---|"]
    lines += [f"| {m.gesture} | {m.effect} |" for m in MOUSE]
    lines += ["", "| menu | key | action | |", "|---|---|---|---|"]
    for menu in MENUS:
        for place, action in enumerate(a for a in ACTIONS if a.menu == menu and a.keys):
            keys = " or ".join(f"`{k}`" for k in action.keys)
            name = menu if place == 0 else ""
            lines.append(f"| {name} | {keys} | {action.title} | {action.tip} |")
    return "\n".join(lines)


def with_key_table(guide: str) -> str:
    """Return the text of the guide with current tables.

    Raises:
        ValueError: the guide has no marks.
    """
    before, _, rest = guide.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise ValueError("the guide has no marks for the tables of keys")
    # Steps and angles in the table are settings, which tools/figures.py need not find measured.
    table = f"<!--fact-->\n\n{key_table()}\n\n<!--/-->"
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{after}"


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_key_table(path.read_text(encoding="utf-8")), encoding="utf-8")
