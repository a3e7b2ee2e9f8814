"""The page: one template, filled by the server's state; menus come from the table of actions."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

from trame.ui.vuetify3 import VAppLayout

from annotator.actions import ACTIONS, BY_ID, MENUS, Action
from annotator.session import Session
from annotator.web.shown import ICONS

TOOLS = (
    ("save", "undo", "redo"),
    ("toggle_mode", "style_solid", "style_wireframe", "style_contour"),
    ("gizmo_move", "gizmo_turn", "fit_view", "zoom_object"),
    ("clicking", "refine", "drop", "residuals", "done"),
)
STATIC = Path(__file__).parent / "static"
# Lines of the head of trame's own page that ours has instead.
_TITLE = "<title>trame is built by Kitware</title>"
_ICON = '<link rel="icon" href="logo.png" />'


def index_html(*, title: str, secret: str) -> str:
    """The first thing that a browser gets: trame's own page with our scripts before its own.

    Args:
        secret: by which the page's web socket is told from any other.
    """
    www = importlib.import_module("trame_client.module.vue3").www
    head = (
        '<head><meta charset="UTF-8" />'
        f'<meta name="secret" content="{_escaped(secret)}" />'
        '<script src="annotator/start.js"></script>'
        '<script type="module" src="annotator/views.js"></script>'
        '<link rel="stylesheet" href="annotator/page.css" />'
    )
    page = (Path(www) / "index.html").read_text(encoding="utf-8")
    page = page.replace("<head>", head, 1)
    page = page.replace(_TITLE, f"<title>{_escaped(title)}</title>")
    page = page.replace(_ICON, '<link rel="icon" href="annotator/icon.svg" />')
    # Scripts within the page are forbidden by `guard`; this one shows trame's logo.
    return re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)


def build_page(server: Any, *, views: int) -> None:
    """Give a trame server its page, with so many views of which the first is the main one."""
    main, *side = [_view(i) for i in range(views)]
    columns = [f'<div class="main">{main}</div>']
    if side:
        columns.append(f'<div class="side">{"".join(side)}</div>')
    page = _read("page.html").replace("<!--views-->", "".join(columns))
    page = page.replace("<!--mesh-->", _view(views))
    with VAppLayout(server, theme="dark") as layout:
        layout.root.add_child(page)


def _view(index: int) -> str:
    # `v-pre`: it is an element of the browser, which Vue leaves alone.
    return (
        f'<div class="view" :class="{{ inhand: {index} === active_view }}" data-view="{index}">'
        f'<annotator-view v-pre data-index="{index}"></annotator-view></div>'
    )


def _read(name: str) -> str:
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def page_constants(session: Session, *, dialogs: frozenset[str]) -> dict[str, Any]:
    """What of the page never changes."""
    name = session.scene.info.name
    return {
        "title": name,
        "trame__title": f"{name} · std-annotate",
        "annotator": session.annotator or "",
        "frame_count": len(session.scene.frames),
        "menus": [_menu(menu, dialogs) for menu in MENUS],
        "tools": [[_tool(BY_ID[i]) for i in group] for group in TOOLS],
    }


def _tool(action: Action) -> dict[str, Any]:
    keys = " ".join(action.keys[:1])
    return {"id": action.id, "icon": ICONS[action.id], "tip": action.tip, "keys": keys}


def _menu(name: str, dialogs: frozenset[str]) -> dict[str, Any]:
    """The entries of one menu; what would need a dialog that the page lacks is left out."""
    entries: list[dict[str, Any]] = []
    group = None
    for action in ACTIONS:
        if action.menu != name or (action.asks and action.asks not in dialogs):
            continue
        entries.append(
            {
                "id": action.id,
                "tip": action.tip,
                "keys": ", ".join(action.keys),
                "switch": action.checked is not None,
                "divider": group is not None and action.group != group,
                "heading": action.submenu if action.group != group else "",
            }
        )
        group = action.group
    return {"name": name, "entries": entries}
