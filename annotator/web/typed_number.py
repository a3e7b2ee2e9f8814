"""A number of the pose that was typed."""

from __future__ import annotations

import math

from annotator.desk.controller import Controller
from annotator.pose_text import RotationForm, rotation_from_numbers, rotation_numbers
from annotator.session import SetPoses
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3


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
