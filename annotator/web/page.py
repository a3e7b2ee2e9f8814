"""Template of the page, and the controller's state as plain values for it."""

from __future__ import annotations

import importlib
import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

from trame.ui.vuetify3 import VAppLayout

from annotator.app import (
    action_table,
    controller,
    icons,
    object_summary,
    palette,
    panels,
    pose_text,
    questions,
)
from annotator.app.evidence_card import evidence_card
from annotator.app.mesh_folder import FolderMesh, meshes_to_add
from annotator.session import Session
from std_toolkit.html.plots import object_color

STATIC = Path(__file__).parent / "static"

# Actions that each browser does for itself, in `static/look.js`. The keys of the text size stay the
# browser's own: they zoom the whole page.
LOCAL = ("light_theme", "larger_text", "smaller_text", "commands", "panels")

# Lines in the head of trame's page that are replaced.
_TITLE = "<title>trame is built by Kitware</title>"

# It would keep people from enlarging the page.
_FIXED_SIZE = ",maximum-scale=1,minimum-scale=1"

# Vuetify puts menus and dialogs here; it would make one that belongs to no part of the page.
_OVERLAYS = '<body><div class="v-overlay-container" role="region" aria-label="In front"></div>'

_ICON = '<link rel="icon" href="logo.png" />'


def index_html(*, title: str, secret: str) -> str:
    """Return the initial HTML: trame's page with the annotator's scripts first.

    Args:
        secret: authenticates the web socket of the page.
    """
    www = importlib.import_module("trame_client.module.vue3").www
    head = (
        '<head><meta charset="UTF-8" />'
        f'<meta name="secret" content="{_escaped(secret)}" />'
        f'<meta name="look" content="{_escaped(json.dumps(_look()))}" />'
        '<script src="annotator/start.js"></script>'
        '<script type="module" src="annotator/views.js"></script>'
        f"<style>{palette.style_sheet()}</style>"
        '<link rel="stylesheet" href="annotator/page.css" />'
    )
    page = (Path(www) / "index.html").read_text(encoding="utf-8")
    page = page.replace("<head>", head, 1)
    page = page.replace(_TITLE, f"<title>{_escaped(title)}</title>")
    page = page.replace(_FIXED_SIZE, "", 1).replace("<body>", _OVERLAYS, 1)
    page = page.replace(_ICON, '<link rel="icon" href="annotator/icon.svg" />')
    # The policy of `guard` forbids inline scripts; this one shows trame's logo.
    return re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)


def _look() -> dict[str, Any]:
    """Return what `static/look.js` needs to know."""
    p = palette
    sizes = {"least": p.SMALLEST_TEXT, "usual": p.USUAL_TEXT, "most": p.LARGEST_TEXT}
    keys = {key: id for id in ("commands", "panels") for key in action_table.BY_ID[id].keys}
    return {"text": {**sizes, "step": p.TEXT_STEP}, "keys": keys}


def build_page(server: Any, *, views: int) -> None:
    """Set the page of a trame server with N views, the first of which is the main one."""
    corners = [("fit_view", "zoom_object"), *((f"swap_{i}",) for i in range(1, views))]
    main, *side = [_view(i, actions) for i, actions in enumerate(corners)]
    columns = [f'<div class="main">{main}</div>']
    if side:
        columns.append(f'<div class="side">{"".join(side)}</div>')
    page = _read("page.html").replace("<!--views-->", "".join(columns))
    page = page.replace("<!--mesh-->", _view(views)).replace("<!--icons-->", icons.symbols())
    with VAppLayout(server, theme="dark") as layout:
        layout.root.add_child(page)


def _view(index: int, actions: tuple[str, ...] = ()) -> str:
    buttons = "".join(
        f'<button class="tool" :disabled="!actions.{id}.enabled" :title="actions.{id}.title" '
        f"data-tool=\"{id}\" @click=\"trigger('act', ['{id}'])\">"
        f'<svg class="icon small"><use href="#icon-{id}"></use></svg></button>'
        for id in actions
    )
    # `v-pre`: a custom element that Vue must not compile.
    return (
        f'<div class="view" :class="{{ inhand: {index} === active_view }}" data-view="{index}">'
        f'<annotator-view v-pre data-index="{index}"></annotator-view>'
        f'<div class="corner">{buttons}</div></div>'
    )


def _read(name: str) -> str:
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def page_constants(session: Session, *, dialogs: frozenset[str]) -> dict[str, Any]:
    """Return the constant values of the page."""
    name = session.scene.info.name
    return {
        "title": name,
        "trame__title": f"{name} · std-annotate",
        "annotator": session.annotator or "",
        "frame_count": len(session.scene.frames),
        "menus": [_menu(menu, dialogs) for menu in action_table.MENUS],
        "tools": _tools(dialogs),
        "forms": [
            {"value": f, "title": t, "tip": pose_text.FORM_TIPS[f]}
            for f, t in pose_text.FORM_TITLES.items()
        ],
        "posed": session.posed,
        "aspect": _aspect(session),
    }


def _aspect(session: Session) -> float:
    """Return the ratio of width to height of the images, to which the side views are fitted."""
    camera = session.scene.camera(session.scene.frames[0])
    return camera.width / camera.height


def _tools(dialogs: frozenset[str]) -> list[list[dict[str, Any]]]:
    known = {a.id: a for a in action_table.available_actions(dialogs)}
    return [
        [
            {"id": id, "tip": action_table.OPACITY_TIP, "keys": "[ and ]"}
            if id == "opacity"
            else {
                "id": id,
                "tip": known[id].tip,
                "keys": " ".join(known[id].keys[:1]),
                "label": action_table.SHORT_TITLES.get(id, ""),
            }
            for id in group
            if id in known or id == "opacity"
        ]
        for group in action_table.TOOLS
    ]


def _menu(name: str, dialogs: frozenset[str]) -> dict[str, Any]:
    """Return the entries of one menu, without actions that need an unavailable dialog."""
    entries: list[dict[str, Any]] = []
    group = None
    for action in action_table.available_actions(dialogs):
        if action.menu != name:
            continue
        entries.append(
            {
                "id": action.id,
                "tip": action.tip,
                "keys": ", ".join(action.keys),
                "local": action.id in LOCAL,
                "switch": action.checked is not None,
                "divider": group is not None and action.group != group,
                "heading": action.submenu if action.group != group else "",
            }
        )
        group = action.group
    return {"name": name, "entries": entries}


def page_state(c: controller.Controller, fields: pose_text.PoseFields) -> dict[str, Any]:
    """Return the state of the page except images.

    Args:
        fields: the numbers of the pose.
    """
    frames = [f.id for f in c.session.scene.frames]
    return {
        "objects": _objects(c),
        "selected": c.selected or "",
        "models": [
            *(_model(m) for m in c.session.state.models),
            *(_folder_mesh(m) for m in meshes_to_add(c.mesh_folder, c.session)),
        ],
        "progress": object_summary.progress(c),
        "unsaved": c.session.unsaved,
        "writable": c.session.writable,
        "actions": {a.id: _action(c, a) for a in action_table.ACTIONS},
        "frame_index": frames.index(c.frame),
        "frame_ids": list(c.view_frames),
        "active_view": c.active_view,
        "maximised": c.options.maximised,
        "clicking": c.clicking,
        "frame_problem": _frame_problem(c),
        "busy": "" if c.task is None else c.task.title,
        "busy_alone": c.task is not None and c.task.alone,
        "opacity": round(100 * c.options.opacity),
        "step": c.step,
        "axes": c.axes,
        "points": _points(c),
        "residuals": [asdict(row) for row in panels.residual_rows(c)],
        "card": _card(c),
        "weak": panels.weak_direction(c),
        "marks": asdict(panels.frame_marks(c)),
        "provenance": fields.provenance(),
        **page_pose(c, fields),
    }


def page_pose(c: controller.Controller, fields: pose_text.PoseFields) -> dict[str, Any]:
    """Return the part of the page state that changes while an object is dragged."""
    return {"pose": _pose(fields), "hint": object_summary.next_hint(c)}


def _frame_problem(c: controller.Controller) -> str:
    return "no camera pose" if c.session.posed and c.frame not in c.session.frames else ""


def _action(c: controller.Controller, action: Any) -> dict[str, Any]:
    return {
        "enabled": bool(action.enabled(c)),
        "on": bool(action.checked(c)) if action.checked is not None else False,
        "title": action.label(c) if action.label is not None else action.title,
    }


def _objects(c: controller.Controller) -> list[dict[str, Any]]:
    ids = [o.id for o in c.session.state.objects]
    return [
        {
            "id": s.id,
            "name": s.name,
            "color": object_color(ids, s.id),
            "material": s.material,
            "model": s.model,
            "state": s.state,
            "noted": s.noted,
            "locked": s.locked,
            "badge": s.badge,
            "grade": s.grade,
            "alarm": s.alarm,
            "explanation": s.explanation,
            "searched": object_summary.searched(s),
        }
        for s in object_summary.summarize(c)
    ]


def _model(model: Any) -> dict[str, Any]:
    size = " × ".join(f"{1000 * x:.0f}" for x in model.size_m)
    turns = questions.symmetry_summary(model.symmetry)
    described = f"{size} mm · {model.category}"
    return {
        "id": model.id,
        "described": described,
        "explanation": f"{size} mm, {model.category}, {turns}",
    }


def _folder_mesh(mesh: FolderMesh) -> dict[str, Any]:
    return {
        "id": mesh.name,
        "described": "not in the scene yet",
        "explanation": f"{mesh.path}, copied into the scene when it is placed",
    }


def _pose(fields: pose_text.PoseFields) -> dict[str, Any] | None:
    """Return the numbers of the selected object's pose, mm and degrees; None without a pose."""
    if fields.pose is None:
        return None
    position, rotation = fields.numbers()
    as_quaternion = fields.form is pose_text.RotationForm.QUATERNION
    return {
        "where": fields.where,
        "in_world": fields.in_world,
        "form": fields.form,
        "position": [f"{x:.2f}" for x in position],
        "rotation": [] if as_quaternion else [f"{x:.3f}" for x in rotation],
        "quaternion": pose_text.quaternion_text(rotation) if as_quaternion else "",
        "matrix": fields.copied(),
    }


def _card(c: controller.Controller) -> dict[str, Any] | None:
    """Return the evidence on the selected object; None where there is nothing to show."""
    card = None if c.clicking else evidence_card(c)
    if card is None:
        return None
    shown = asdict(card)
    index = {f.id: i for i, f in enumerate(c.session.scene.frames)}
    for row in shown["rows"]:
        row["index"] = index.get(row["frame"])
    return shown


def _points(c: controller.Controller) -> list[dict[str, Any]]:
    if c.selected is None:
        return []
    return [
        {
            "frame": row.frame,
            "number": row.number,
            "pixel": f"{row.u:.1f}, {row.v:.1f}",
            "residual": "" if row.residual_px is None else f"{row.residual_px:.1f} px",
        }
        for row in panels.click_rows(c, c.selected)
    ]
