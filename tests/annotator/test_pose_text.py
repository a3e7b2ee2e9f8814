"""Poses as people type and paste them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annotator.app.pose_text import (
    RotationForm,
    matrix_text,
    parse_matrix,
    rotation_from_numbers,
    rotation_numbers,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp

POSE = SE3.exp([0.1234567890123, -0.2, 0.7, 0.5, -1.1, 2.0])
angles = st.floats(-180, 180)
TURNS = st.tuples(*[st.floats(-3, 3)] * 3).map(lambda v: so3_exp(np.array(v)))


@given(R=TURNS, form=st.sampled_from(RotationForm))
def test_three_numbers_tell_the_whole_rotation(R: np.ndarray, form: RotationForm) -> None:
    np.testing.assert_allclose(rotation_from_numbers(rotation_numbers(R, form), form), R, atol=1e-7)


@given(x=angles, z=angles, up=st.sampled_from([-90.0, 90.0]))
def test_also_where_two_euler_angles_are_one(x: float, z: float, up: float) -> None:
    R = rotation_from_numbers([x, up, z], RotationForm.EULER)
    numbers = rotation_numbers(R, RotationForm.EULER)
    assert numbers[0] == 0
    np.testing.assert_allclose(rotation_from_numbers(numbers, RotationForm.EULER), R, atol=1e-6)


def test_euler_angles_turn_about_fixed_axes_x_first() -> None:
    R = rotation_from_numbers([90, 0, 90], RotationForm.EULER)
    # y goes to z by the first turn, where the turn about z leaves it.
    np.testing.assert_allclose(R @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(R @ [1, 0, 0], [0, 1, 0], atol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        matrix_text(POSE),
        repr(POSE.matrix().tolist()),
        repr(POSE.matrix()[:3].tolist()),
        "np." + repr(POSE.matrix()).replace("\n", " "),
        ";".join(",".join(map(repr, row)) for row in POSE.matrix().tolist()),
    ],
)
def test_matrices_are_read_however_they_are_printed(text: str) -> None:
    # numpy prints eight digits.
    np.testing.assert_allclose(parse_matrix(text).matrix(), POSE.matrix(), atol=1e-7)


def test_what_is_copied_is_pasted_bit_for_bit() -> None:
    once = parse_matrix(matrix_text(POSE))
    assert parse_matrix(matrix_text(once)).flat() == once.flat()
    np.testing.assert_allclose(once.matrix(), POSE.matrix(), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "needs 16 numbers"),
        ("1 0 0 0", "4 numbers"),
        ("nan " * 16, "not a number of a pose.*'nan'"),
        ("mug " + "0 " * 15, "not a number of a pose.*'mug'"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1", "rotation"),
        ("1000 0 0 0 0 1000 0 0 0 0 1000 0 0 0 0 1", "rotation"),
    ],
)
def test_what_is_no_pose_is_refused(text: str, problem: str) -> None:
    with pytest.raises(ToolkitError, match=problem):
        parse_matrix(text)
