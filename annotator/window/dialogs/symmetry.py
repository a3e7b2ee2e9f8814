"""Which turns of a mesh look the same."""

from __future__ import annotations

from PySide6.QtWidgets import (
    QButtonGroup,
    QHBoxLayout,
    QLabel,
    QRadioButton,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)

from annotator.desk.controller import Controller
from annotator.desk.wording import symmetry_text
from annotator.window.dialogs.question import Answer, Question
from std_toolkit.labels.symmetry_argument import parse_symmetry
from std_toolkit.scene import Model
from std_toolkit.scene.model import SymmetryModel

_AXES = ("x", "y", "z")


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
            **{f"axis:{a}": f"Any turn about {a} (bottle, can, bowl)" for a in _AXES},
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
        for place, axis in enumerate(_AXES):
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
            words = [f"fold:{_AXES[self.fold_axis.checkedId()]}:{self.count.value()}"]
        elif chosen == "box":
            words = [f"fold:{axis}:2" for axis in _AXES]
        centre = self._controller.session.centre(self._model.id).tolist()
        return parse_symmetry(words, centre=centre)
