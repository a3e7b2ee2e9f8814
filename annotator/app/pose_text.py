"""Text form of poses and times: millimetres, degrees, 4x4 matrices."""

from __future__ import annotations

import math
import re
from datetime import datetime
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from annotator.app.controller import Controller
from annotator.session import SetPoses
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp, so3_log

_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")

# Words around the numbers of a matrix as numpy, Python and others print it.
_ORNAMENT = re.compile(r"\b(?:np\.|numpy\.)?(?:array|matrix|asarray)\b|\bdtype=\w+|[\[\](){},;]")


class RotationForm(StrEnum):
    """Text form of a rotation: three numbers in degrees, or a quaternion w x y z."""

    EULER = "euler"
    VECTOR = "vector"
    QUATERNION = "quaternion"


FORM_TITLES = {
    RotationForm.EULER: "Euler x y z",
    RotationForm.VECTOR: "rotation vector",
    RotationForm.QUATERNION: "quaternion w x y z",
}

FORM_TIPS = {
    RotationForm.EULER: "Angle about the fixed {axis} axis; the turns are made in the order "
    "x, y, z.",
    RotationForm.VECTOR: "{axis} part of the rotation vector: its direction is the axis of the "
    "turn, its length the angle.",
    RotationForm.QUATERNION: "Unit quaternion, w first. Enter applies.",
}


def rotation_numbers(R: NDArray[np.floating], form: RotationForm) -> NDArray[np.float64]:
    """Return (3,) degrees, or (4,) unit quaternion w x y z, of a rotation (3, 3).

    Euler angles are about the fixed axes x, then y, then z: R = Rz Ry Rx. At y = +-90 degrees
    (gimbal lock) x is reported as 0. A rotation vector is the axis times the angle.
    """
    if form is RotationForm.VECTOR:
        return np.degrees(so3_log(R))
    if form is RotationForm.QUATERNION:
        return SE3(np.asarray(R, dtype=np.float64), np.zeros(3)).quat()
    y = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        # Gimbal lock: only the sum or the difference of x and z is determined.
        return np.degrees([0.0, y, np.arctan2(-R[0, 1], R[1, 1])])
    return np.degrees([np.arctan2(R[2, 1], R[2, 2]), y, np.arctan2(R[1, 0], R[0, 0])])


def rotation_from_numbers(numbers: ArrayLike, form: RotationForm) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of numbers: the inverse of `rotation_numbers`.

    Raises:
        ToolkitError: a quaternion whose length is far from 1.
    """
    if form is RotationForm.QUATERNION:
        return SE3.from_quat(numbers, np.zeros(3)).R
    x, y, z = np.radians(np.asarray(numbers, dtype=np.float64))
    if form is RotationForm.VECTOR:
        return so3_exp([x, y, z])
    return so3_exp([0, 0, z]) @ so3_exp([0, y, 0]) @ so3_exp([x, 0, 0])


def quaternion_text(wxyz: NDArray[np.floating]) -> str:
    """Return four numbers, rounded to a hundredth of a degree or less."""
    return " ".join(f"{x:.5f}" for x in wxyz)


def matrix_text(T: SE3) -> str:
    """Return the 4x4 matrix in four lines, metres, with all digits, as `parse_matrix` reads it."""
    return "\n".join(" ".join(repr(float(x)) for x in row) for row in T.matrix())


def parse_matrix(text: str) -> SE3:
    """Parse a pose from text: 16 or 12 numbers row by row, metres; brackets and commas optional.

    Raises:
        ToolkitError: not 16 or 12 numbers, other words, or not a rigid transform.
    """
    bare = _ORNAMENT.sub(" ", text)
    words = bare.split()
    strange = next((w for w in words if not _NUMBER.fullmatch(w)), None)
    if strange is not None:
        raise ToolkitError("this is not a number of a pose", value=strange, hint=_EXPECTED)
    if len(words) not in (12, 16):
        raise ToolkitError(
            "a pose needs 16 numbers (or 12), row by row",
            value=f"{len(words)} numbers",
            hint=_EXPECTED,
        )
    return SE3.from_matrix([float(w) for w in words])


_EXPECTED = "paste a 4x4 matrix [R t; 0 0 0 1] with t in metres"


def local_minute(time: str) -> str:
    """Format an ISO 8601 time as date and minute in the local time zone."""
    try:
        return datetime.fromisoformat(time).astimezone().strftime("%Y-%m-%d %H:%M")
    except ValueError:
        return "an unknown time"


class PoseFields:
    """The selected object's pose as numbers to read, type, copy and paste.

    Attributes:
        in_world: whether numbers are in the world frame instead of the active view's camera.
        form: text form of the rotation.
    """

    def __init__(self, controller: Controller) -> None:
        self._c = controller
        self.in_world = False
        self.form = RotationForm.EULER

    @property
    def pose(self) -> SE3 | None:
        """The displayed pose; None if the selected object has no pose here."""
        c = self._c
        T_cam_obj = None if c.selected is None else c.pose(c.selected, c.active_frame)
        if T_cam_obj is None or not self.in_world:
            return T_cam_obj
        T_world_cam = c.session.T_world_cam(c.active_frame)
        return None if T_world_cam is None else T_world_cam @ T_cam_obj

    @property
    def where(self) -> str:
        """The frame of the numbers."""
        return "world" if self.in_world else f"camera of frame {self._c.active_frame}"

    def numbers(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the position (3,) in mm and the numbers of the rotation; zeros without a pose."""
        T = self.pose
        if T is None:
            return np.zeros(3), np.zeros(4 if self.form is RotationForm.QUATERNION else 3)
        return 1000 * T.t, rotation_numbers(T.R, self.form)

    def set_pose(self, T: SE3, *, method: str = "typed") -> bool:
        """Set the pose, in the frame of the numbers; False on failure."""
        c = self._c
        if self.in_world:
            T_world_cam = c.session.T_world_cam(c.active_frame)
            if T_world_cam is None:
                return False
            T = T_world_cam.inverse() @ T
        c.cancel_drag()
        return c.selected is not None and c.apply(
            SetPoses.one(c.selected, c.active_frame, T, method=method)
        )

    def set_number(self, what: Literal["position", "rotation"], axis: int, value: float) -> bool:
        """Set a coordinate in mm or one number of the rotation; see `rotation_numbers`."""
        T = self.pose
        if T is None:
            return False
        R, t = T.R, T.t.copy()
        if what == "position":
            t[axis] = value / 1000
        else:
            numbers = rotation_numbers(R, self.form)
            numbers[axis] = value
            R = rotation_from_numbers(numbers, self.form)
        return self.set_pose(SE3(R, t))

    def type_number(self, what: Literal["position", "rotation"], axis: int, text: str) -> bool:
        """Call `set_number` with typed text.

        Raises:
            ToolkitError: the text is not a number.
        """
        return self.set_number(what, axis, _number(text, what))

    def type_quaternion(self, text: str) -> bool:
        """Set the rotation from four numbers w x y z.

        Raises:
            ToolkitError: not four numbers, or a length other than 1.
        """
        T = self.pose
        words = _ORNAMENT.sub(" ", text).split()
        if len(words) != 4:
            raise ToolkitError("a quaternion needs 4 numbers: w x y z", value=text)
        numbers = [_number(word, "quaternion") for word in words]
        R = rotation_from_numbers(numbers, RotationForm.QUATERNION)
        return T is not None and self.set_pose(SE3(R, T.t))

    def copied(self) -> str:
        """Return the 4x4 matrix as text, "" without a pose."""
        T = self.pose
        return "" if T is None else matrix_text(T)

    def tell_copied(self) -> None:
        self._c.tell(f"Copied the 4x4 matrix, mesh to {self.where}, metres.")

    def paste(self, text: str) -> bool:
        """Set the pose from text; see `parse_matrix`."""
        return self.set_pose(parse_matrix(text), method="pasted")

    def provenance(self) -> str:
        """Return a sentence on who set this pose, when and by which method."""
        c = self._c
        if c.selected is None:
            return "Select an object to see its pose."
        if self.pose is None:
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
        text = ", ".join(parts) + "."
        if placement.refinement:
            text += f"\n{placement.refinement}"
        return text + (f"\nNote: {obj.note}" if obj.note else "")


def _number(text: str, what: str) -> float:
    try:
        value = float(text.strip().replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ToolkitError("this is not a number", field=what, value=text)
    return value
