"""Poses and times as users read and type them: millimetres, degrees, 4x4 matrices.

Times as people read them.

A number of the pose that was typed.
"""

from __future__ import annotations

import math
import re
from datetime import datetime
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from annotator.app.controller import Controller
from annotator.session import SetPoses
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp, so3_log

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")

# Words around the numbers of a matrix as numpy, Python and others print it.
_ORNAMENT = re.compile(r"\b(?:np\.|numpy\.)?(?:array|matrix|asarray)\b|\bdtype=\w+|[\[\](){},;]")


class RotationForm(StrEnum):
    """How a rotation is told in three numbers, degrees."""

    EULER = "euler"
    VECTOR = "vector"


def rotation_numbers(R: NDArray[np.floating], form: RotationForm) -> NDArray[np.float64]:
    """(3,) degrees of a rotation (3, 3).

    Euler angles are about the fixed axes x, then y, then z: R = Rz Ry Rx. Where y is +-90 degrees
    x and z are one; x is told as 0 then. A rotation vector is the axis times the angle.
    """
    if form is RotationForm.VECTOR:
        return np.degrees(so3_log(R))
    y = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        # Gimbal lock: only the sum or the difference of x and z is told.
        return np.degrees([0.0, y, np.arctan2(-R[0, 1], R[1, 1])])
    return np.degrees([np.arctan2(R[2, 1], R[2, 2]), y, np.arctan2(R[1, 0], R[0, 0])])


def rotation_from_numbers(numbers: ArrayLike, form: RotationForm) -> NDArray[np.float64]:
    """(3, 3) rotation of three numbers in degrees: the inverse of `rotation_numbers`."""
    x, y, z = np.radians(np.asarray(numbers, dtype=np.float64))
    if form is RotationForm.VECTOR:
        return so3_exp([x, y, z])
    return so3_exp([0, 0, z]) @ so3_exp([0, y, 0]) @ so3_exp([x, 0, 0])


def matrix_text(T: SE3) -> str:
    """The 4x4 matrix in four lines, metres, with all digits: what `parse_matrix` reads."""
    return "\n".join(" ".join(repr(float(x)) for x in row) for row in T.matrix())


def parse_matrix(text: str) -> SE3:
    """A pose from pasted text: 16 or 12 numbers, row by row, metres, brackets and commas or not.

    Raises:
        ToolkitError: other than 16 or 12 numbers, words in between, or no rigid transform.
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
    """Day and minute of an ISO 8601 time in UTC, in the time of this place."""
    try:
        return datetime.fromisoformat(time).astimezone().strftime("%Y-%m-%d %H:%M")
    except ValueError:
        return "an unknown time"


def type_number(c: Controller, what: str, axis: int, text: str) -> None:
    """Set one number of the selected object's pose in the camera of the view in hand.

    Args:
        what: "position", in mm, or "rotation": of the rotation vector, in degrees.

    Raises:
        ToolkitError: it is no number.
    """
    T = None if c.selected is None else c.session.pose(c.selected, c.active_frame)
    if c.selected is None or T is None or axis not in (0, 1, 2):
        return
    value = _number(text, what)
    R, t = T.R, T.t.copy()
    if what == "position":
        t[axis] = value / 1000
    else:
        numbers = rotation_numbers(R, RotationForm.VECTOR)
        numbers[axis] = value
        R = rotation_from_numbers(numbers, RotationForm.VECTOR)
    c.cancel_drag()
    c.apply(SetPoses.one(c.selected, c.active_frame, SE3(R, t), method="typed"))


def _number(text: str, what: str) -> float:
    try:
        value = float(text.strip().replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ToolkitError("this is not a number", field=what, value=text)
    return value
