"""All keys and what the mouse does, for the sheet of the page."""

from __future__ import annotations

from annotator.actions import ACTIONS, BY_ID, MENUS
from annotator.actions.mouse import MOUSE

# What the page has no dialog for.
LEFT_OUT = ("open", "close")


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
