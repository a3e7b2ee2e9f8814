"""Everything that can be done now as a list to search: actions, objects, meshes and frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from annotator.app.action import read_only
from annotator.app.action_table import BY_ID, available_actions
from annotator.app.mesh_folder import meshes_to_add
from annotator.app.placing import add_object
from std_toolkit.errors import check_known

if TYPE_CHECKING:
    from annotator.app.controller import Controller

# Rows shown at a time: more are found by typing on.
MOST = 60

SELF = "commands"


@dataclass(frozen=True)
class Command:
    """One row of the list.

    Attributes:
        kind: "action", "object", "mesh" or "frame".
        target: id of the action, name of the object or mesh, or number of the frame.
        title: what it does, such as "Select mug_3".
        where: menu of an action, such as "Object/Flip".
        keys: of an action, as Qt writes them.
        tip: description of an action, file of a frame or of a mesh that is not in the scene yet.
        problem: why it cannot be run now, or "".
    """

    kind: str
    target: str
    title: str
    where: str
    keys: str = ""
    tip: str = ""
    problem: str = ""


def commands(c: Controller, typed: str = "") -> list[Command]:
    """Return the rows that contain every typed word, the closest first, at most `MOST`.

    Rows whose title begins with what was typed precede those in which a word begins with it, and
    those that can be run precede those that cannot.
    """
    sought = typed.lower().split()
    found = [
        (_distance(row, sought), bool(row.problem), place, row)
        for place, row in enumerate(_all(c))
        if all(word in _searched(row) for word in sought)
    ]
    return [row for *_, row in sorted(found, key=lambda one: one[:3])[:MOST]]


def run(c: Controller, kind: str, target: str) -> None:
    """Run a row; one that cannot be run now says why.

    Raises:
        ToolkitError: the object, the mesh or the frame does not exist.
    """
    if kind == "object":
        c.select(target)
    elif kind == "frame":
        c.show_frame(int(target) if target.isdecimal() else -1)
    elif kind == "mesh":
        check_known(target, (name for name, _ in _meshes(c)), "no such mesh")
        add_object(c, target)
    elif target in BY_ID:
        action = BY_ID[target]
        if problem := action.problem(c):
            c.tell(f"{action.title}: {problem}.", "warning")
        else:
            action.run(c)


def _all(c: Controller) -> Iterator[Command]:
    for action in available_actions(c.dialogs):
        if action.id != SELF:
            title = action.title if action.label is None else action.label(c)
            where = f"{action.menu}/{action.submenu}" if action.submenu else action.menu
            yield Command(
                "action",
                action.id,
                title,
                where,
                " or ".join(action.keys),
                action.tip,
                action.problem(c),
            )
    for thing in c.session.state.objects:
        chosen = "it is selected" if thing.name == c.selected else ""
        yield Command("object", thing.name, f"Select {thing.name}", "Objects", problem=chosen)
    for name, tip in _meshes(c):
        yield Command("mesh", name, f"Place {name}", "Meshes", tip=tip, problem=read_only(c))
    for frame in c.session.scene.frames:
        shown = "it is in the main view" if frame.id == c.frame else ""
        yield Command(
            "frame", str(frame.id), f"Frame {frame.id}", "Frames", tip=frame.name, problem=shown
        )


def _meshes(c: Controller) -> Iterator[tuple[str, str]]:
    """Name and tip of every mesh of the library."""
    yield from ((m.id, "Place it in the middle of the main view.") for m in c.session.state.models)
    yield from ((m.name, str(m.path)) for m in meshes_to_add(c.mesh_folder, c.session))


def _searched(row: Command) -> str:
    return f"{row.title} {row.where}".lower()


def _distance(row: Command, sought: Sequence[str]) -> int:
    """Return 0 for a title that begins with the words, 1 if each begins a word of it, else 2."""
    title = row.title.lower()
    if title.startswith(" ".join(sought)):
        return 0
    words = title.replace("_", " ").split()
    begun = all(any(word.startswith(one) for word in words) for one in sought)
    return 1 if begun else 2
