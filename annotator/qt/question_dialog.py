"""A question with a few named answers.

Questions about edits: recover them, save them, and whose version to keep.

Which turns of a mesh look the same.

How labels are carried to all frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QButtonGroup,
    QCheckBox,
    QDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QRadioButton,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)

from annotator.app.controller import Controller
from annotator.app.events import Level
from annotator.app.pose_text import local_minute
from annotator.app.questions import propagation_text, symmetry_text
from annotator.qt import theme
from annotator.qt.theme import pixmap
from annotator.session.recovery import Recovery
from std_toolkit.labels.propagate import PropagateOptions
from std_toolkit.labels.symmetry_argument import parse_symmetry
from std_toolkit.scene import Model
from std_toolkit.scene.model import SymmetryModel

_INK = {"info": theme.ACCENT, "warning": theme.WARNING, "error": theme.BAD}

_TURN_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Answer:
    """A button.

    Attributes:
        name: what the dialog returns.
        title: what stands on the button.
        tip: what it does.
    """

    name: str
    title: str
    tip: str = ""


class Question(QDialog):
    """Asks; closing it or Esc is the last answer.

    Args:
        heading: the matter, in one line.
        text: what a person must know to decide.
        answers: the first is the usual one, the last one changes nothing.
        middle: fields between the text and the buttons.
    """

    def __init__(
        self,
        parent: QWidget | None,
        heading: str,
        text: str,
        answers: Sequence[Answer],
        *,
        level: Level = "info",
        middle: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("std-annotate")
        self.heading = heading
        self.answer = answers[-1].name
        self.buttons: dict[str, QPushButton] = {}
        sign = QLabel()
        sign.setPixmap(pixmap(level, 32, _INK[level], self.devicePixelRatioF()))
        head = QLabel(heading)
        head.setObjectName("heading")
        head.setWordWrap(True)
        self.text = QLabel(text)
        self.text.setTextFormat(Qt.TextFormat.PlainText)
        self.text.setWordWrap(True)
        self.text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        words = QVBoxLayout()
        words.setSpacing(8)
        words.addWidget(head)
        words.addWidget(self.text)
        if middle is not None:
            words.addWidget(middle)
        words.addStretch(1)
        top = QHBoxLayout()
        top.setSpacing(14)
        top.addWidget(sign, 0, Qt.AlignmentFlag.AlignTop)
        top.addLayout(words, 1)
        row = QHBoxLayout()
        row.addStretch(1)
        for place, answer in enumerate(answers):
            button = QPushButton(answer.title)
            button.setToolTip(answer.tip)
            button.setDefault(place == 0)
            button.setAutoDefault(place == 0)
            button.clicked.connect(lambda _=False, name=answer.name: self._give(name))
            self.buttons[answer.name] = button
        for answer in reversed(answers):
            row.addWidget(self.buttons[answer.name])
        layout = QVBoxLayout(self)
        layout.setContentsMargins(18, 16, 18, 14)
        layout.setSpacing(14)
        layout.addLayout(top, 1)
        layout.addLayout(row)
        self.setMinimumWidth(460)
        self.buttons[answers[0].name].setFocus()

    def ask(self) -> str:
        """Show it and wait; the name of the answer."""
        self.exec()
        return self.answer

    def _give(self, name: str) -> None:
        self.answer = name
        self.accept()


def recovery_question(parent: QWidget | None, found: Recovery) -> Question:
    """Answers "recover", "discard" or "close"."""
    edits = "1 edit" if found.count == 1 else f"{found.count} edits"
    who = f" by {found.annotator}" if found.annotator else ""
    heading = f"{edits}{who} from {local_minute(found.time)} were not saved"
    discard = Answer(
        "discard", "Discard", "Open the scene as it was saved; the journal is kept aside."
    )
    close = Answer("close", "Decide later", "Close the scene; nothing is lost.")
    if found.problem:
        text = f"They cannot be brought back: {found.problem}. Their journal is kept aside."
        return Question(parent, heading, text, [discard, close], level="warning")
    text = "The last session on this scene ended before it saved. Bring its edits back?"
    if found.changed:
        text += (
            f"\n\n{', '.join(found.changed)} was written by others since. What they changed and "
            "these edits left alone is kept."
        )
    if found.damage:
        text += f"\n\nThe end of the journal cannot be read ({found.damage}): the rest can."
    recover = Answer("recover", "Recover", "Undo and redo will work as before.")
    return Question(parent, heading, text, [recover, discard, close], level="warning")


def closing_question(parent: QWidget | None, edits: int) -> Question:
    """Answers "save", "keep" or "cancel"."""
    told = "1 edit is" if edits == 1 else f"{edits} edits are" if edits else "The edits are"
    return Question(
        parent,
        f"{told} not saved",
        "Save the labels now, or leave the edits in the journal: the scene offers to recover "
        "them when it is opened next.",
        [
            Answer("save", "Save", "Write the labels into the scene, then close."),
            Answer("keep", "Keep for next time", "Close; they can be recovered."),
            Answer("cancel", "Cancel", "Go on annotating."),
        ],
        level="warning",
    )


def conflict_question(parent: QWidget | None, names: str) -> Question:
    """Answers "mine", "theirs" or "cancel"."""
    return Question(
        parent,
        "Others changed the same objects",
        f"While you edited them, another program or person wrote these into the scene: {names}.\n\n"
        "Whose version shall be saved? Everything else is kept from both, and what you give up "
        "can be brought back by undo.",
        [
            Answer("mine", "Keep mine", "Your version of these objects is written."),
            Answer("theirs", "Keep theirs", "Their version of these objects is taken over."),
            Answer("cancel", "Cancel", "Nothing is saved yet."),
        ],
        level="warning",
    )


class SymmetryDialog:
    """Asks for the symmetry of one mesh."""

    def __init__(self, parent: QWidget | None, controller: Controller, model: Model) -> None:
        self._controller, self._model = controller, model
        fields = QWidget()
        column = QVBoxLayout(fields)
        column.setContentsMargins(0, 4, 0, 0)
        self.group = QButtonGroup(fields)
        self.choices: dict[str, QRadioButton] = {}
        titles = {
            "keep": f"As it is: {symmetry_text(model.symmetry)}",
            "none": "No turn looks the same",
            **{f"axis:{a}": f"Any turn about {a} (bottle, can, bowl)" for a in _TURN_AXES},
            "box": "Half turns about x, y and z (box)",
            "fold": "Equal turns about one axis:",
        }
        for name, title in titles.items():
            button = self.choices[name] = QRadioButton(title)
            self.group.addButton(button)
            column.addWidget(button)
        self.choices["keep"].setChecked(True)
        self.fold_axis = QButtonGroup(fields)
        turns = QWidget()
        row = QHBoxLayout(turns)
        row.setContentsMargins(22, 0, 0, 0)
        for place, axis in enumerate(_TURN_AXES):
            button = QRadioButton(axis)
            button.setChecked(axis == "z")
            self.fold_axis.addButton(button, place)
            row.addWidget(button)
        self.count = QSpinBox()
        self.count.setRange(2, 36)
        self.count.setSuffix(" turns")
        row.addWidget(self.count)
        row.addStretch(1)
        column.addWidget(turns)
        self.choices["fold"].toggled.connect(turns.setEnabled)
        turns.setEnabled(False)
        note = QLabel(
            "Axes are the mesh's own, through the middle of its bounding box: the handles along "
            "the object's axes (A) show them."
        )
        note.setObjectName("muted")
        note.setWordWrap(True)
        column.addWidget(note)
        self.question = Question(
            parent,
            f"Symmetry of {model.id}",
            "Refining and comparing treat turns that look the same as equal.",
            [Answer("set", "Set"), Answer("cancel", "Cancel")],
            middle=fields,
        )

    def ask(self) -> SymmetryModel | None:
        """Show it and wait; None if it stays as it is."""
        return self.symmetry() if self.question.ask() == "set" else None

    def symmetry(self) -> SymmetryModel | None:
        """What is chosen; None for what the mesh has."""
        chosen = next(k for k, button in self.choices.items() if button.isChecked())
        if chosen == "keep":
            return None
        words = [chosen]
        if chosen == "fold":
            words = [f"fold:{_TURN_AXES[self.fold_axis.checkedId()]}:{self.count.value()}"]
        elif chosen == "box":
            words = [f"fold:{axis}:2" for axis in _TURN_AXES]
        centre = self._controller.session.centre(self._model.id).tolist()
        return parse_symmetry(words, centre=centre)


class PropagateDialog:
    """Asks for the options of propagating."""

    def __init__(self, parent: QWidget | None, controller: Controller) -> None:
        session = controller.session
        text = propagation_text(session)
        fields = QWidget()
        form = QFormLayout(fields)
        form.setContentsMargins(0, 4, 0, 0)
        self.refine = QCheckBox("Adjust each pose to several frames at once")
        self.refine.setToolTip("Takes minutes; the images decide, not the poses set by hand.")
        self.scale = QCheckBox("Estimate the scale of the camera poses as well")
        self.scale.setToolTip(
            "Rewrites poses.json with it: for scenes whose metres come from sensor depth alone."
        )
        self.depth = QCheckBox("Use the sensor depth on raw and diffuse objects")
        self.depth.setChecked(True)
        self.keyframes = QSpinBox()
        self.keyframes.setRange(2, 200)
        self.keyframes.setValue(10)
        self.keyframes.setSuffix(" frames")
        form.addRow(self.refine)
        form.addRow(self.scale)
        form.addRow(self.depth)
        form.addRow("Adjust to", self.keyframes)
        self.refine.toggled.connect(self._update)
        self._update()
        self.question = Question(
            parent,
            "Save and propagate",
            text,
            [
                Answer("go", "Save and propagate"),
                Answer("cancel", "Cancel", "Nothing is written."),
            ],
            middle=fields,
        )

    def _update(self) -> None:
        for field in (self.scale, self.depth, self.keyframes):
            field.setEnabled(self.refine.isChecked())

    def ask(self) -> PropagateOptions | None:
        """Show it and wait; None if nothing shall be done."""
        return self.options() if self.question.ask() == "go" else None

    def options(self) -> PropagateOptions:
        refine = self.refine.isChecked()
        return PropagateOptions(
            refine=refine,
            refine_scale=refine and self.scale.isChecked(),
            use_depth=self.depth.isChecked(),
            keyframes=self.keyframes.value(),
        )
