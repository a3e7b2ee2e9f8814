"""The selected object's pose in numbers: to read, to type, to copy and to paste."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt, QTimer, Signal
from PySide6.QtWidgets import (
    QApplication,
    QComboBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from annotator.app.controller import STEPS, Controller
from annotator.app.events import Event
from annotator.app.pose_text import (
    RotationForm,
    local_minute,
    matrix_text,
    parse_matrix,
    rotation_from_numbers,
    rotation_numbers,
)
from annotator.qt.commands import Commands
from annotator.qt.number_field import NumberField
from annotator.qt.theme import icon
from annotator.session import SetPoses
from std_toolkit.geometry import SE3

_TURN_TIPS = {
    RotationForm.EULER: "Angle about the fixed {axis} axis; the turns are made in the order "
    "x, y, z.",
    RotationForm.VECTOR: "{axis} part of the rotation vector: its direction is the axis of the "
    "turn, its length the angle.",
}


class PosePanel(QWidget):
    """Numbers in the camera of the view in hand, or in the world.

    Signals:
        left: typing is over, and keys should reach the views again.
    """

    left = Signal()

    def __init__(self, controller: Controller, commands: Commands) -> None:
        super().__init__()
        self._controller = controller
        self._frame_box = QComboBox()
        self._frame_box.addItem("camera", False)
        self._frame_box.addItem("world", True)
        self._frame_box.setToolTip(
            "<b>Frame of the numbers</b><br>Camera: x right, y down, z away."
        )
        self._form_box = QComboBox()
        self._form_box.addItem("Euler x y z", RotationForm.EULER)
        self._form_box.addItem("rotation vector", RotationForm.VECTOR)
        self._form_box.setToolTip("<b>How the rotation is told</b><br>Three numbers in degrees.")
        for box in (self._frame_box, self._form_box):
            box.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
            box.currentIndexChanged.connect(lambda _: self.refresh())

        grid = QGridLayout()
        grid.setHorizontalSpacing(4)
        grid.setVerticalSpacing(3)
        self.position = [NumberField("mm", 2) for _ in "xyz"]
        self.rotation = [NumberField("°", 3) for _ in "xyz"]
        for column, axis in enumerate("xyz"):
            label = QLabel(axis)
            label.setObjectName("muted")
            label.setAlignment(Qt.AlignmentFlag.AlignCenter)
            grid.addWidget(label, 0, column)
            grid.addWidget(self.position[column], 1, column)
            grid.addWidget(self.rotation[column], 2, column)
            self.position[column].setToolTip(
                f"{axis} of the mesh's origin. Enter applies; the arrow keys step."
            )
            self.position[column].typed.connect(lambda v, i=column: self._move(i, v))
            self.rotation[column].typed.connect(lambda v, i=column: self._turn(i, v))
        for field in (*self.position, *self.rotation):
            field.left.connect(self.left)

        self.copy_button = _button("copy", "Copy 4x4", "Copy the pose as a 4x4 matrix, metres.")
        self.copy_button.clicked.connect(self.copy)
        self.paste_button = _button(
            "paste", "Paste 4x4", "Set the pose from a 4x4 matrix on the clipboard, metres."
        )
        self.paste_button.clicked.connect(self.paste)
        matrix = QHBoxLayout()
        matrix.addWidget(self.copy_button)
        matrix.addWidget(self.paste_button)

        self.provenance = QLabel()
        self.provenance.setObjectName("muted")
        self.provenance.setWordWrap(True)
        self.provenance.setTextFormat(Qt.TextFormat.PlainText)
        self.provenance.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.provenance.setToolTip("Who set this pose, when, and with what.")

        frames = QHBoxLayout()
        frames.addWidget(self._frame_box, 1)
        frames.addWidget(self._form_box, 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(6, 6, 6, 4)
        layout.setSpacing(5)
        layout.addLayout(frames)
        layout.addLayout(grid)
        layout.addLayout(matrix)
        layout.addLayout(self._steps_row(commands))
        layout.addWidget(self.provenance)
        layout.addStretch(1)
        # Numbers that change faster cannot be read, and would slow a drag down.
        self._soon = QTimer(self, singleShot=True, interval=100)
        self._soon.timeout.connect(self.refresh)
        self._unsubscribe = controller.subscribe(self._on_event)
        self.refresh()

    def close_panel(self) -> None:
        self._unsubscribe()
        self._soon.stop()

    def _steps_row(self, commands: Commands) -> QHBoxLayout:
        row = QHBoxLayout()
        row.setSpacing(2)
        label = QLabel("Key steps")
        label.setObjectName("muted")
        row.addWidget(label)
        row.addStretch(1)
        for size, name in zip(STEPS, ("coarse", "middle", "fine"), strict=True):
            button = QToolButton()
            button.setDefaultAction(commands.actions[f"step_{name}"])
            button.setText(f"{size:g}")
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextOnly)
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            # The action's long title would replace it with every update.
            commands.actions[f"step_{name}"].setIconText(f"{size:g}")
            row.addWidget(button)
        unit = QLabel("mm, °")
        unit.setObjectName("muted")
        row.addWidget(unit)
        axes = QToolButton()
        axes.setDefaultAction(commands.actions["axes"])
        axes.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        row.addWidget(axes)
        return row

    # --- the pose in the chosen frame ------------------------------------------------------------

    @property
    def in_world(self) -> bool:
        return bool(self._frame_box.currentData())

    @property
    def form(self) -> RotationForm:
        return RotationForm(self._form_box.currentData())

    def pose(self) -> SE3 | None:
        """What the fields show; None if the selected object has no pose here."""
        c = self._controller
        if c.selected is None:
            return None
        T_cam_obj = c.pose(c.selected, c.active_frame)
        if T_cam_obj is None or not self.in_world:
            return T_cam_obj
        T_world_cam = c.session.T_world_cam(c.active_frame)
        return None if T_world_cam is None else T_world_cam @ T_cam_obj

    def _set_pose(self, T: SE3, method: str) -> None:
        c = self._controller
        if c.selected is None:
            return
        if self.in_world:
            T_world_cam = c.session.T_world_cam(c.active_frame)
            if T_world_cam is None:
                return
            T = T_world_cam.inverse() @ T
        c.cancel_drag()
        if not c.apply(SetPoses.one(c.selected, c.active_frame, T, method=method)):
            self.refresh()

    def _move(self, axis: int, value_mm: float) -> None:
        T = self.pose()
        if T is not None:
            t = T.t.copy()
            t[axis] = value_mm / 1000
            self._set_pose(SE3(T.R, t), "typed")

    def _turn(self, axis: int, value_deg: float) -> None:
        T = self.pose()
        if T is not None:
            numbers = rotation_numbers(T.R, self.form)
            numbers[axis] = value_deg
            self._set_pose(SE3(rotation_from_numbers(numbers, self.form), T.t), "typed")

    def copy(self) -> None:
        """The shown pose onto the clipboard."""
        T = self.pose()
        if T is not None:
            QApplication.clipboard().setText(matrix_text(T))
            where = "world" if self.in_world else f"camera of frame {self._controller.active_frame}"
            self._controller.tell(f"Copied the 4x4 matrix, mesh to {where}, metres.")

    def paste(self) -> None:
        """The pose from the clipboard."""
        text = QApplication.clipboard().text()
        self._controller.attempt(lambda: self._set_pose(parse_matrix(text), "pasted"))

    # --- showing ---------------------------------------------------------------------------------

    def refresh(self) -> None:
        c = self._controller
        with QSignalBlocker(self._frame_box):
            self._frame_box.setItemText(0, f"camera of frame {c.active_frame}")
            self._frame_box.setEnabled(c.session.posed)
            if not c.session.posed:
                self._frame_box.setCurrentIndex(0)
        T = self.pose()
        editable = c.selected is not None and c.session.writable
        for field in (*self.position, *self.rotation):
            field.setEnabled(T is not None and c.session.writable)
            field.setSingleStep(c.step)
        self.copy_button.setEnabled(T is not None)
        self.paste_button.setEnabled(editable)
        numbers = np.zeros(6)
        if T is not None:
            numbers = np.concatenate([1000 * T.t, rotation_numbers(T.R, self.form)])
        for field, value in zip((*self.position, *self.rotation), numbers, strict=True):
            field.show_number(float(value))
        for axis, field in zip("xyz", self.rotation, strict=True):
            field.setToolTip(_TURN_TIPS[self.form].format(axis=axis))
        self.provenance.setText(self._provenance(T is not None))

    def _provenance(self, placed: bool) -> str:
        c = self._controller
        if c.selected is None:
            return "Select an object to see its pose."
        if not placed:
            return f"{c.selected} has no pose in frame {c.active_frame} yet."
        obj = c.session.object(c.selected)
        placement = obj.placements.get(c.active_frame) or next(iter(obj.placements.values()))
        frame = next(f for f, p in obj.placements.items() if p is placement)
        parts = [placement.method or "placed"]
        if placement.annotator:
            parts.append(f"by {placement.annotator}")
        if placement.time:
            parts.append(local_minute(placement.time))
        parts.append(f"in frame {frame}")
        told = ", ".join(parts) + "."
        if placement.refinement:
            told += f"\n{placement.refinement}"
        return told + (f"\nNote: {obj.note}" if obj.note else "")

    def _on_event(self, event: Event) -> None:
        if event.kind == "preview" and not self._soon.isActive():
            self._soon.start()
        elif event.kind in ("edited", "selected", "frames", "tool"):
            self._soon.stop()
            self.refresh()


def _button(name: str, text: str, tip: str) -> QPushButton:
    button = QPushButton(icon(name), text)
    button.setToolTip(tip)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    return button
