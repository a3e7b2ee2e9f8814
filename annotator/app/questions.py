"""Questions as data: text, fields and buttons, which every front end renders.

In which unit a mesh file is written, as far as its size tells.

Sentences about a session that the window and the page say alike.

Which turns of a mesh look the same, asked so that nobody needs to know a syntax.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import UNITS_IN_M, load_mesh, mesh_extents
from std_toolkit.scene import Model

if TYPE_CHECKING:
    from annotator.session import Session
    from std_toolkit.scene import SymmetryModel

Answers = dict[str, Any]

Reaction = Callable[[str, Answers], None]

Button = dict[str, str]

_numbers = itertools.count(1)

Unit = Literal["m", "cm", "mm"]

UNITS: tuple[Unit, ...] = ("m", "mm", "cm")

# What lies on a table is about so large; it decides which of two plausible units comes first.
_USUAL_SIZE_M = 0.15

_AXIS_NAMES = ("x", "y", "z")

_TURN_AXES = ("x", "y", "z")


def button(id: str, text: str) -> Button:
    """A button; the first of a question is the usual answer."""
    return {"id": id, "text": text}


CANCEL = button("", "Cancel")


def whole_number(answers: Answers, name: str) -> int:
    """A number that was filled in.

    Raises:
        ToolkitError: it is none.
    """
    try:
        return int(str(answers.get(name, "")).strip())
    except ValueError:
        raise ToolkitError(
            "this is not a whole number", field=name, value=answers.get(name)
        ) from None


@dataclass(frozen=True)
class Field:
    """Something to be filled in.

    Attributes:
        name: key of its value in the answers.
        choices: titles and values of a field that lets choose.
        value: what stands in it first.
        when: name and value of another field: it is shown only if that has the value.
    """

    name: str
    label: str
    kind: Literal["line", "lines", "number", "switch", "choice"] = "line"
    choices: tuple[tuple[str, str], ...] = ()
    value: str | int | bool = ""
    when: tuple[str, Any] | None = None

    def shown(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "label": self.label,
            "kind": self.kind,
            "choices": [{"title": title, "value": value} for title, value in self.choices],
            "when": None if self.when is None else list(self.when),
        }


@dataclass(frozen=True)
class Question:
    """A dialog.

    Attributes:
        react: called with the button's id and the answers, unless it is cancelled.
        groups: tables to read: a heading each, and rows of two cells.
        must: it goes away only by one of its buttons.
        number: tells it from every other.
    """

    title: str
    react: Reaction
    text: str = ""
    fields: list[Field] = field(default_factory=list)
    buttons: list[Button] = field(default_factory=list)
    groups: list[tuple[str, list[tuple[str, str]]]] = field(default_factory=list)
    must: bool = False
    number: int = field(default_factory=lambda: next(_numbers))

    def shown(self) -> dict[str, Any]:
        """As plain values for the page."""
        return {
            "number": self.number,
            "title": self.title,
            "text": self.text,
            "fields": [f.shown() for f in self.fields],
            "buttons": self.buttons,
            "groups": [
                {"name": name, "rows": [list(r) for r in rows]} for name, rows in self.groups
            ],
            "must": self.must,
        }

    def first_answers(self) -> Answers:
        return {f.name: f.value for f in self.fields}


@dataclass(frozen=True)
class MeshSize:
    """Size of a mesh, and the units in which a table-top object has it.

    Attributes:
        extents: (x, y, z) of the bounding box in the numbers of the file.
        units: plausible ones, the likeliest first; metres alone where they are plausible.
    """

    extents: tuple[float, float, float]
    units: tuple[Unit, ...]

    def in_mm(self, unit: Unit) -> tuple[float, float, float]:
        """Extents in millimetres if the file is in `unit`."""
        factor = 1000 * UNITS_IN_M[unit]
        x, y, z = self.extents
        return x * factor, y * factor, z * factor


def measure_mesh(path: Path) -> MeshSize:
    """Size and plausible units of a mesh file.

    Raises:
        ToolkitError: unreadable, without faces, or of a size that no table-top object has in any
            unit.
    """
    found: dict[Unit, np.ndarray] = {}
    first: ToolkitError | None = None
    for unit in UNITS:
        try:
            found[unit] = mesh_extents(load_mesh(path, unit=unit)) / UNITS_IN_M[unit]
        except ToolkitError as error:
            first = first or error
            if "implausibly" not in error.problem:
                raise
        else:
            if unit == "m":
                break
    if not found:
        assert first is not None
        raise ToolkitError(
            "the mesh has a size that no object on a table has, in metres, centimetres or "
            "millimetres",
            path=path,
            value=first.value,
            hint="scale it in the program that made it",
        )
    x, y, z = (float(v) for v in next(iter(found.values())))
    size = max(x, y, z)
    order = sorted(found, key=lambda u: abs(np.log(size * UNITS_IN_M[u] / _USUAL_SIZE_M)))
    return MeshSize((x, y, z), tuple(order))


def propagation_text(session: Session) -> str:
    """What propagating does now, and which objects are not done yet."""
    placed = [o for o in session.state.objects if o.placements]
    undone = [o.name for o in placed if o.status != "done"]
    text = (
        f"The labels are saved, and the poses of {len(placed)} objects are carried to "
        f"{len(session.frames)} frames through the camera poses."
    )
    if undone:
        text += f"\n\nNot marked as done yet: {', '.join(undone)}."
    return text


def symmetry_text(symmetry: SymmetryModel) -> str:
    """A symmetry in full, for who is about to change it."""
    parts = []
    for one in symmetry.continuous:
        axis = next((a for a, x in zip(_AXIS_NAMES, one.axis, strict=True) if abs(x) > 0.999), None)
        parts.append(f"any turn about {axis or 'an axis of its own'}")
    if symmetry.discrete:
        parts.append(f"{len(symmetry.discrete)} turns")
    return ", ".join(parts) or "none told"


def symmetry_summary(symmetry: SymmetryModel) -> str:
    """A symmetry in a few words, for a tool tip."""
    if symmetry.continuous:
        return "symmetric about an axis"
    if symmetry.discrete:
        return f"{len(symmetry.discrete)} turns that look the same"
    return "no symmetry told"


_CHOICES = (
    ("No turn looks the same", "none"),
    *((f"Any turn about {axis} (bottle, can, bowl)", f"axis:{axis}") for axis in _TURN_AXES),
    ("Half turns about x, y and z (box)", "box"),
    *((f"Equal turns about {axis}", f"fold:{axis}") for axis in _TURN_AXES),
)


def symmetry_question(model: Model, react: Reaction) -> Question:
    """Ask for the symmetry of a mesh; see `symmetry_words`."""
    folds = [Field(f"count_{axis}", "How many turns make a full one", kind="number", value=2,
                   when=("symmetry", f"fold:{axis}")) for axis in _TURN_AXES]  # fmt: skip
    return Question(
        f"Symmetry of {model.id}",
        react,
        text="Refining and comparing treat turns that look the same as equal. Axes are the mesh's "
        "own, through the middle of its bounding box: the handles along the object's axes (A) "
        "show them.",
        fields=[
            Field(
                "symmetry",
                "Symmetry",
                kind="choice",
                choices=((f"As it is: {symmetry_text(model.symmetry)}", "keep"), *_CHOICES),
                value="keep",
            ),
            *folds,
        ],
        buttons=[button("set", "Set"), CANCEL],
    )


def symmetry_words(answers: Answers) -> list[str] | None:
    """What was chosen, as `parse_symmetry` reads it; None if it stays as it is."""
    chosen = str(answers.get("symmetry", "keep"))
    if chosen not in [value for _, value in _CHOICES]:
        return None
    if chosen == "box":
        return [f"fold:{axis}:2" for axis in _TURN_AXES]
    if chosen.startswith("fold:"):
        return [f"{chosen}:{whole_number(answers, f'count_{chosen[-1]}')}"]
    return [chosen]
