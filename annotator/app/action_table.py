"""All actions in one table, from which menus, tool bar, keys and the guide are made.

All keys and what the mouse does, for the sheet of the page.

The keys and the mouse as tables for the guide: python -m annotator.app.action_table GUIDE.

Rewrites what stands between the marks in the guide.
"""

from __future__ import annotations

import sys
from pathlib import Path

from annotator.app.action import MOUSE
from annotator.app.object_actions import ALIGN_ACTIONS, OBJECT_ACTIONS
from annotator.app.view_actions import SCENE_ACTIONS, VIEW_ACTIONS

ACTIONS = (*SCENE_ACTIONS, *VIEW_ACTIONS, *OBJECT_ACTIONS, *ALIGN_ACTIONS)


MENUS = ("File", "Edit", "View", "Frame", "Object", "Align", "Help")


BY_ID = {a.id: a for a in ACTIONS}

# What the page has no dialog for.
LEFT_OUT = ("open", "close")

BEGIN = "<!-- keys: written by `python -m annotator.app.action_table docs/annotating.md` -->"

END = "<!-- end of keys -->"


def key_rows() -> list[tuple[str, list[tuple[str, str]]]]:
    """Keys (or gestures) and what they do, by menu."""
    groups = [
        (
            menu,
            [
                (" or ".join(a.keys), a.title)
                for a in ACTIONS
                if a.menu == menu and a.keys and a.id not in LEFT_OUT
            ],
        )
        for menu in MENUS
    ]
    return [
        *((m, rows) for m, rows in groups if rows),
        ("Mouse", [(m.gesture, m.effect) for m in MOUSE]),
    ]


ACTION_OF = {key: id for id, action in BY_ID.items() if id not in LEFT_OUT for key in action.keys}


def key_table() -> str:
    """Markdown: the mouse, then the actions of each menu with their keys."""
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
    """The text of the guide with the tables as they are now.

    Raises:
        ValueError: the marks are not there.
    """
    before, _, rest = guide.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise ValueError("the guide has no marks for the tables of keys")
    return f"{before}{BEGIN}\n{key_table()}\n{END}{after}"


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_key_table(path.read_text(encoding="utf-8")), encoding="utf-8")
