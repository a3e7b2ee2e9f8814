"""Dialogs as data: text, fields and buttons that every front end renders."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from annotator.app.events import Level
from annotator.app.pose_text import local_minute
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from annotator.session.recovery import Recovery
    from std_toolkit.scene import Model, SymmetryModel

Answers = dict[str, Any]

Reaction = Callable[[str, Answers], object]

_numbers = itertools.count(1)

_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Button:
    """A button of a question.

    Attributes:
        id: argument of the reaction; "" cancels the question.
        tip: description of its effect.
    """

    id: str
    text: str
    tip: str = ""


CANCEL = Button("", "Cancel")


@dataclass(frozen=True)
class Choice:
    """Value of a field with a list of choices."""

    value: str
    text: str


@dataclass(frozen=True)
class Field:
    """Input field of a question.

    Attributes:
        name: key of its value in the answers.
        value: initial value.
        choices: of a field of the kind "choice".
        least, most: range of a number.
        unit: of a number, such as "frames".
        tip: its meaning in one sentence.
        when: another field and the values of it for which this field is enabled; None: always.
    """

    name: str
    label: str
    kind: Literal["line", "lines", "number", "switch", "choice"] = "line"
    value: str | int | bool = ""
    choices: tuple[Choice, ...] = ()
    least: int = 0
    most: int = 1_000_000
    unit: str = ""
    tip: str = ""
    when: tuple[str, tuple[str | bool, ...]] | None = None

    def is_asked(self, answers: Answers) -> bool:
        """Whether the field is enabled for these answers."""
        return self.when is None or answers.get(self.when[0]) in self.when[1]

    def read(self, answers: Answers) -> Any:
        """Return its value in the answers: str, int or bool by kind; the initial value if disabled.

        Raises:
            ToolkitError: not a number in the range, or not one of the choices.
        """
        value = answers.get(self.name, self.value)
        if not self.is_asked(answers):
            return self.value
        if self.kind == "switch":
            return bool(value)
        if self.kind == "number":
            return self._number(value)
        text = str(value).strip()
        if self.kind == "choice" and text not in [c.value for c in self.choices]:
            raise ToolkitError("this is not one of the choices", field=self.name, value=value)
        return text

    def _number(self, value: Any) -> int:
        try:
            number = int(str(value).strip())
        except ValueError:
            number = self.least - 1
        if not self.least <= number <= self.most:
            raise ToolkitError(
                f"expected a whole number from {self.least} to {self.most}",
                field=self.name,
                value=value,
            )
        return number


@dataclass(frozen=True)
class Group:
    """Read-only table in a question.

    Attributes:
        keys: whether the first cell of each row holds keys: "Ctrl+Y or Ctrl+Shift+Z".
    """

    heading: str
    rows: tuple[tuple[str, str], ...]
    keys: bool = False


@dataclass(frozen=True)
class Question:
    """Dialog with text, fields and buttons.

    Attributes:
        react: called with the button's id and the values of the fields, unless cancelled.
        cancelled: called if it is cancelled.
        buttons: the first is the default.
        searchable: whether the groups have a search field.
        must_answer: whether only its buttons close it.
        number: unique number.
    """

    title: str
    react: Reaction = lambda *_: None
    text: str = ""
    level: Level = "info"
    fields: tuple[Field, ...] = ()
    buttons: tuple[Button, ...] = (Button("close", "Close"),)
    groups: tuple[Group, ...] = ()
    searchable: bool = False
    must_answer: bool = False
    cancelled: Callable[[], object] = lambda: None
    number: int = field(default_factory=lambda: next(_numbers))

    def as_dict(self) -> dict[str, Any]:
        """Return the question as JSON values, without its reactions."""
        names = [f.name for f in dataclasses.fields(self) if f.name not in ("react", "cancelled")]
        shown: dict[str, Any] = msgspec.to_builtins({n: getattr(self, n) for n in names})
        return shown

    def first_answers(self) -> Answers:
        return {f.name: f.value for f in self.fields}

    def answer(self, pressed: str, answers: Answers) -> None:
        """Run the reaction to a button with the field values.

        Raises:
            ToolkitError: see `Field.read`; also raises what the reaction raises.
        """
        if pressed:
            self.react(pressed, {f.name: f.read(answers) for f in self.fields})
        else:
            self.cancelled()


# --- edits that are not saved ---------------------------------------------------------------------


def recovery_question(
    found: Recovery, react: Reaction = lambda *_: None, *, can_leave: bool = True
) -> Question:
    """Ask what to do with edits of an earlier session: "recover", "discard" or "" for later.

    Args:
        can_leave: whether the scene may be closed to decide later.
    """
    edits = "1 edit" if found.count == 1 else f"{found.count} edits"
    who = f" by {found.annotator}" if found.annotator else ""
    buttons: tuple[Button, ...] = (
        Button("recover", "Recover", "Undo and redo will work as before."),
        Button("discard", "Discard", "Open the scene as it was saved; the journal is kept aside."),
        Button("", "Decide later", "Close the scene; nothing is lost."),
    )
    text = "The last session on this scene ended before it saved. Restore its edits?"
    if found.problem:
        buttons = buttons[1:]
        text = f"They cannot be restored: {found.problem}. Their journal is kept aside."
    else:
        if found.changed:
            text += (
                f"\n\n{', '.join(found.changed)} was written by others since. Their changes are "
                "kept unless these edits conflict."
            )
        if found.damage:
            text += f"\n\nThe end of the journal cannot be read ({found.damage}): the rest can."
    return Question(
        f"{edits}{who} from {local_minute(found.time)} were not saved",
        react,
        text=text,
        level="warning",
        buttons=buttons if can_leave else buttons[:-1],
        must_answer=not can_leave,
    )


def closing_question(edits: int) -> Question:
    """Ask what to do with unsaved edits: "save" or "keep"."""
    count = "1 edit is" if edits == 1 else f"{edits} edits are" if edits else "The edits are"
    return Question(
        f"{count} not saved",
        text="Save the labels now, or leave the edits in the journal: the scene offers to recover "
        "them when it is opened next.",
        level="warning",
        buttons=(
            Button("save", "Save", "Write the labels into the scene, then close."),
            Button("keep", "Keep for next time", "Close; they can be recovered."),
            Button("", "Cancel", "Go on annotating."),
        ),
    )


def conflict_question(names: str, react: Reaction) -> Question:
    """Ask whose version of objects to save: "mine" or "theirs"."""
    return Question(
        "Others changed the same objects",
        react,
        text="While you edited them, another program or person wrote these into the scene: "
        f"{names}.\n\nWhose version shall be saved? Everything else is kept from both, and undo "
        "restores what you give up.",
        level="warning",
        buttons=(
            Button("mine", "Keep mine", "Your version of these objects is written."),
            Button("theirs", "Keep theirs", "Their version of these objects is taken over."),
            Button("", "Cancel", "Nothing is saved yet."),
        ),
    )


# --- symmetry -------------------------------------------------------------------------------------


def symmetry_text(symmetry: SymmetryModel) -> str:
    """Return the full description of a symmetry."""
    parts = []
    for one in symmetry.continuous:
        axis = next((a for a, x in zip(_AXES, one.axis, strict=True) if abs(x) > 0.999), None)
        parts.append(f"any turn about {axis or 'an axis of its own'}")
    if symmetry.discrete:
        parts.append(f"{len(symmetry.discrete)} turns")
    return ", ".join(parts) or "none set"


def symmetry_summary(symmetry: SymmetryModel) -> str:
    """Return a short description of a symmetry, for a tool tip."""
    if symmetry.continuous:
        return "symmetric about an axis"
    if symmetry.discrete:
        return f"{len(symmetry.discrete)} turns that look the same"
    return "no symmetry set"


def symmetry_question(model: Model, react: Reaction) -> Question:
    """Ask for the symmetry of a mesh; see `symmetry_words`."""
    choices = (
        Choice("keep", f"As it is: {symmetry_text(model.symmetry)}"),
        Choice("auto", "Turns after which the mesh and its colours are the same (found)"),
        Choice("none", "No turn looks the same"),
        *(Choice(f"axis:{a}", f"Any turn about {a} (bottle, can, bowl)") for a in _AXES),
        Choice("box", "Half turns about x, y and z (box)"),
        *(Choice(f"fold:{a}", f"Equal turns about {a}") for a in _AXES),
    )
    folds = tuple(f"fold:{a}" for a in _AXES)
    return Question(
        f"Symmetry of {model.id}",
        react,
        text="Refining and comparing treat turns that look the same as equal. Axes are the mesh's "
        "own, through the middle of its bounding box: the handles along the object's axes (A) "
        "show them.",
        fields=(
            Field("symmetry", "Symmetry", kind="choice", choices=choices, value="keep"),
            Field(
                "count",
                "Turns of a full circle",
                kind="number",
                value=2,
                least=2,
                most=36,
                unit="turns",
                when=("symmetry", folds),
            ),
        ),
        buttons=(Button("set", "Set"), CANCEL),
    )


def symmetry_words(answers: Answers) -> list[str] | None:
    """Return the choice as input of `parse_symmetry`; None for no change."""
    chosen = answers["symmetry"]
    if chosen == "keep":
        return None
    if chosen == "box":
        return [f"fold:{axis}:2" for axis in _AXES]
    return [f"{chosen}:{answers['count']}" if chosen.startswith("fold:") else chosen]
