"""How labels are carried to all frames."""

from __future__ import annotations

from PySide6.QtWidgets import (
    QCheckBox,
    QFormLayout,
    QSpinBox,
    QWidget,
)

from annotator.desk.controller import Controller
from annotator.desk.wording import propagation_text
from annotator.window.dialogs.question import Answer, Question
from std_toolkit.labels.propagate import PropagateOptions


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
