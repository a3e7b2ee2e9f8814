"""The keys and the mouse as tables for the guide: python -m annotator.actions.key_table GUIDE.

Rewrites what stands between the marks in the guide.
"""

from __future__ import annotations

import sys
from pathlib import Path

from annotator.actions import ACTIONS, MENUS
from annotator.actions.mouse import MOUSE

BEGIN = "<!-- keys: written by `python -m annotator.actions.key_table docs/annotating.md` -->"
END = "<!-- end of keys -->"


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
