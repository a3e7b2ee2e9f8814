"""Panel with the selected object's pose as numbers to read, type, copy and paste."""

from __future__ import annotations

from typing import Literal

from PySide6 import QtWidgets
from PySide6.QtCore import QSignalBlocker, Qt, QTimer, Signal

from annotator.app import pose_text
from annotator.app.controller import STEPS, Controller
from annotator.app.events import Event
from annotator.qt import number_field, panel, theme
from annotator.qt.commands import Commands


class PosePanel(panel.Panel):
    """Pose in the camera of the active view, or in the world.

    Signals:
        left: typing has ended; the focus should return to the views.
    """

    KINDS = ("edited", "selected", "frames", "tool")
    left = Signal()

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__(controller)
        self.fields = pose_text.PoseFields(controller)
        self._frame_box = QtWidgets.QComboBox()
        self._frame_box.setAccessibleName("Frame of the numbers")
        self._frame_box.addItem("camera", False)
        self._frame_box.addItem("world", True)
        self._frame_box.setToolTip(
            "<b>Frame of the numbers</b><br>Camera: x right, y down, z away."
        )
        self._form_box = QtWidgets.QComboBox()
        self._form_box.setAccessibleName("How the rotation is written")
        for form, title in pose_text.FORM_TITLES.items():
            self._form_box.addItem(title, form)
        self._form_box.setToolTip("<b>How the rotation is written</b><br>Angles are in degrees.")
        for box in (self._frame_box, self._form_box):
            box.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
            box.currentIndexChanged.connect(lambda _: self._choose())

        grid = QtWidgets.QGridLayout()
        grid.setHorizontalSpacing(4)
        grid.setVerticalSpacing(3)
        self.position = [number_field.NumberField("mm", 2) for _ in "xyz"]
        self.rotation = [number_field.NumberField("°", 3) for _ in "xyz"]
        for column, axis in enumerate("xyz"):
            grid.addWidget(panel.label("muted", axis), 0, column, Qt.AlignmentFlag.AlignCenter)
            grid.addWidget(self.position[column], 1, column)
            grid.addWidget(self.rotation[column], 2, column)
            self.position[column].setAccessibleName(f"{axis}, mm")
            self.rotation[column].setAccessibleName(f"Turn about {axis}, degrees")
            self.position[column].setToolTip(
                f"{axis} of the mesh's origin. Enter applies; the arrow keys step."
            )
            self.position[column].typed.connect(lambda v, i=column: self._type("position", i, v))
            self.rotation[column].typed.connect(lambda v, i=column: self._type("rotation", i, v))
        for field in (*self.position, *self.rotation):
            field.left.connect(self.left)
        self.quaternion = QtWidgets.QLineEdit()
        self.quaternion.setAccessibleName("Quaternion w x y z")
        self.quaternion.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.quaternion.setToolTip(pose_text.FORM_TIPS[pose_text.RotationForm.QUATERNION])
        self.quaternion.editingFinished.connect(self._type_quaternion)
        self.quaternion.returnPressed.connect(self.left)
        grid.addWidget(self.quaternion, 3, 0, 1, 3)

        self.copy_button = _button("copy", "Copy 4x4", "Copy the pose as a 4x4 matrix, metres.")
        self.copy_button.clicked.connect(self.copy)
        self.paste_button = _button(
            "paste", "Paste 4x4", "Set the pose from a 4x4 matrix on the clipboard, metres."
        )
        self.paste_button.clicked.connect(self.paste)
        matrix = QtWidgets.QHBoxLayout()
        matrix.addWidget(self.copy_button)
        matrix.addWidget(self.paste_button)

        self.provenance = panel.label("muted")
        self.provenance.setWordWrap(True)
        self.provenance.setTextFormat(Qt.TextFormat.PlainText)
        self.provenance.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.provenance.setToolTip("Annotator, time and method of this pose.")

        frames = QtWidgets.QHBoxLayout()
        frames.addWidget(self._frame_box, 1)
        frames.addWidget(self._form_box, 1)
        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(6, 6, 6, 4)
        layout.setSpacing(5)
        layout.addLayout(frames)
        layout.addLayout(grid)
        layout.addLayout(matrix)
        layout.addLayout(self._steps_row(commands))
        layout.addWidget(self.provenance)
        layout.addStretch(1)
        # Faster updates are unreadable and slow down dragging.
        self._soon = QTimer(self, singleShot=True, interval=100)
        self._soon.timeout.connect(self.refresh)
        self.follow()

    def close_panel(self) -> None:
        super().close_panel()
        self._soon.stop()

    def _steps_row(self, commands: Commands) -> QtWidgets.QHBoxLayout:
        row = QtWidgets.QHBoxLayout()
        row.setSpacing(2)
        row.addWidget(panel.label("muted", "Key steps"))
        row.addStretch(1)
        for size, name in zip(STEPS, ("coarse", "middle", "fine"), strict=True):
            # Every update would replace it by the action's long title.
            commands.actions[f"step_{name}"].setIconText(f"{size:g}")
            button = panel.tool_button(commands.actions[f"step_{name}"])
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextOnly)
            row.addWidget(button)
        row.addWidget(panel.label("muted", "mm, °"))
        row.addWidget(panel.tool_button(commands.actions["axes"]))
        return row

    # --- typing -----------------------------------------------------------------------------------

    def _choose(self) -> None:
        self.fields.in_world = bool(self._frame_box.currentData())
        self.fields.form = pose_text.RotationForm(self._form_box.currentData())
        self.refresh()

    def _type(self, what: Literal["position", "rotation"], axis: int, value: float) -> None:
        if not self.fields.set_number(what, axis, value):
            self.refresh()

    def _type_quaternion(self) -> None:
        if self.quaternion.isModified():
            text = self.quaternion.text()
            self._controller.attempt(lambda: self.fields.type_quaternion(text))
            self.quaternion.setModified(False)
            self.refresh()

    def copy(self) -> None:
        """Copy the shown pose to the clipboard."""
        if text := self.fields.copied():
            QtWidgets.QApplication.clipboard().setText(text)
            self.fields.tell_copied()

    def paste(self) -> None:
        """Set the pose from the clipboard."""
        text = QtWidgets.QApplication.clipboard().text()
        self._controller.attempt(lambda: self.fields.paste(text))

    # --- showing ---------------------------------------------------------------------------------

    def refresh(self) -> None:
        c = self._controller
        with QSignalBlocker(self._frame_box):
            self._frame_box.setItemText(0, f"camera of frame {c.active_frame}")
            self._frame_box.setEnabled(c.session.posed)
            if not c.session.posed:
                self._frame_box.setCurrentIndex(0)
                self.fields.in_world = False
        placed, form = self.fields.pose is not None, self.fields.form
        position, rotation = self.fields.numbers()
        for field in (*self.position, *self.rotation, self.quaternion):
            field.setEnabled(placed and c.session.writable)
        for field in (*self.position, *self.rotation):
            field.setSingleStep(c.step)
        self.copy_button.setEnabled(placed)
        self.paste_button.setEnabled(c.selected is not None and c.session.writable)
        for field, value in zip(self.position, position, strict=True):
            field.show_number(float(value))
        as_quaternion = form is pose_text.RotationForm.QUATERNION
        self.quaternion.setVisible(as_quaternion)
        if as_quaternion and not self.quaternion.isModified():
            self.quaternion.setText(pose_text.quaternion_text(rotation))
        for axis, field, value in zip("xyz", self.rotation, rotation[-3:], strict=True):
            field.setVisible(not as_quaternion)
            field.setToolTip(pose_text.FORM_TIPS[form].format(axis=axis))
            if not as_quaternion:
                field.show_number(float(value))
        self.provenance.setText(self.fields.provenance())

    def _on_event(self, event: Event) -> None:
        if event.kind == "preview" and not self._soon.isActive():
            self._soon.start()
        elif event.kind in self.KINDS:
            self._soon.stop()
            self.refresh()


def _button(name: str, text: str, tip: str) -> QtWidgets.QPushButton:
    button = QtWidgets.QPushButton(theme.icon(name), text)
    button.setToolTip(tip)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    return button
