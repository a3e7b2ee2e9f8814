"""Angles and distances between poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pose_cases import pose, poses

from benchmark.metrics.pose import rotation_errors_deg, translation_errors_cm
from benchmark.metrics.pose.pose_frames import _is_similarity
from std_toolkit.errors import ToolkitError

YES = np.array([True])


def angle(a: np.ndarray, b: np.ndarray, **options: np.ndarray) -> float:
    return float(rotation_errors_deg(a[None], b[None], **options)[0])


@settings(deadline=None)
@given(poses, st.floats(0, 180), st.tuples(*[st.floats(-1, 1)] * 3))
def test_a_turn_by_an_angle(RT: np.ndarray, degrees: float, axis: tuple[float, ...]) -> None:
    length = np.linalg.norm(axis)
    if length < 0.1:
        return
    turned = RT @ pose(np.asarray(axis) / length * np.deg2rad(degrees), scale=0.7)
    assert angle(RT, turned) == pytest.approx(degrees, abs=1e-6)


@settings(deadline=None)
@given(poses, poses)
def test_it_is_the_clipped_arc_cosine(a: np.ndarray, b: np.ndarray) -> None:
    Ra, Rb = (RT[:3, :3] / np.cbrt(np.linalg.det(RT[:3, :3])) for RT in (a, b))
    whole = np.arccos(np.clip((np.trace(Ra @ Rb.T) - 1) / 2, -1, 1))
    axis = np.arccos(np.clip(Ra[:, 1] @ Rb[:, 1], -1, 1))
    assert angle(a, b) == pytest.approx(np.rad2deg(whole), abs=1e-4)
    assert angle(a, b, round_about_y=YES) == pytest.approx(np.rad2deg(axis), abs=1e-4)
    flipped = angle(a, b, round_about_y=YES, upside_down=YES)
    assert flipped == pytest.approx(np.rad2deg(min(axis, np.pi - axis)), abs=1e-4)


@settings(deadline=None)
@given(poses)
def test_the_same_pose(RT: np.ndarray) -> None:
    assert angle(RT, RT) < 1e-9
    assert angle(RT, RT, round_about_y=YES) < 1e-9


def test_top_and_bottom() -> None:
    over = pose((np.pi, 0, 0))
    assert angle(np.eye(4), over, round_about_y=YES) == pytest.approx(180)
    assert angle(np.eye(4), over, round_about_y=YES, upside_down=YES) == pytest.approx(0, abs=1e-9)


def test_distance_is_in_centimetres() -> None:
    a, b = pose(t=(0, 0, 1)), pose((1, 1, 1), (0.02, 0, 1), scale=3)
    assert translation_errors_cm(a[None], b[None])[0] == pytest.approx(2)


def test_shapes() -> None:
    with pytest.raises(ToolkitError, match="two equal arrays"):
        rotation_errors_deg(np.eye(4)[None], np.eye(4))


@pytest.mark.parametrize("scale", [0.01, 0.3, 1.0, 40.0])
def test_skewed_matrices_are_refused_at_any_scale(scale: float) -> None:
    good = np.eye(4)
    good[:3, :3] *= scale
    skewed, mirrored = good.copy(), good.copy()
    skewed[0, 1] = 0.05 * scale
    mirrored[0, 0] *= -1
    assert _is_similarity(np.stack([good, skewed, mirrored])).tolist() == [True, False, False]
