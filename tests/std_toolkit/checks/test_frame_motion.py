"""Runs of frames in which an object lies elsewhere, on drawn edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from std_toolkit.checks.measure.frame_motion import ObjectFrames
from std_toolkit.checks.measure.motion import MotionEquations
from std_toolkit.checks.measure.residuals import ObjectObservation
from std_toolkit.geometry import so3_exp

FX, Z_M, RADIUS_M = 600.0, 0.6, 0.05
REACH_PX = 16.0
FREE = np.zeros((0, 6))


def draw(rng: np.random.Generator, mm: Sequence[float], *, hidden: bool = False) -> MotionEquations:
    """Edges near a square contour that lies elsewhere, among clutter, from a random side."""
    t = np.linspace(-1, 1, 25)[:-1]
    one = np.ones_like(t)
    points = np.concatenate([np.stack(p, 1) for p in ((t, one), (one, t), (t, -one), (-one, t))])
    normals = np.repeat([[0, 1], [1, 0], [0, -1], [-1, 0]], len(t), axis=0)
    R = so3_exp([0.5 * rng.normal(), 0.5 * rng.normal(), 0.0])
    arm = np.column_stack([RADIUS_M * points, np.zeros(len(points))]) @ R.T
    force = np.column_stack([normals, np.zeros(len(points))]) * FX / Z_M
    size = (force * arm).sum(axis=1, keepdims=True)
    jacobian = np.concatenate([force, np.cross(arm, force), size], axis=1)
    true = jacobian[:, :3] @ np.asarray(mm) / 1000 + rng.normal(0, 0.5, len(points))
    true[rng.random(len(points)) < (1.0 if hidden else 0.15)] = np.inf
    offsets = np.column_stack([true, rng.uniform(-REACH_PX, REACH_PX, (len(points), 2))])
    offsets[np.abs(offsets) > REACH_PX] = np.inf
    strengths = np.where(np.isfinite(offsets), rng.uniform(0.4, 1, offsets.shape), 0.0)
    clutter = np.maximum(np.isfinite(offsets).sum(axis=1) / (2 * REACH_PX), 0.02)
    return MotionEquations(
        offsets.astype(np.float32),
        strengths.astype(np.float32),
        clutter.astype(np.float32),
        jacobian.astype(np.float32),
        4 * 2 * RADIUS_M * FX / Z_M,
    )


def look(frames: Sequence[MotionEquations], *, camera_mm: float = 0.0) -> ObjectFrames:
    observed = [
        (10 * k, ObjectObservation(900, 900, 1.0, metres_per_px=Z_M / FX, motion=e))
        for k, e in enumerate(frames)
    ]
    camera = np.diag([camera_mm / 1000] * 3 + [0.0] * 3) ** 2
    return ObjectFrames(observed, FREE, smallest_mm=4.0, cameras=[camera] * len(frames))


def recording(
    seed: int, count: int, moved: Sequence[int] = (), mm: Sequence[float] = (0, 0, 0), **more: bool
) -> list[MotionEquations]:
    rng = np.random.default_rng(seed)
    return [
        draw(rng, mm, **more) if k in moved else draw(rng, (0.0, 0.0, 0.0)) for k in range(count)
    ]


@pytest.mark.parametrize("count", [8, 50, 600])
def test_the_number_of_frames_brings_no_false_alarm(count: int) -> None:
    found = look(recording(1, count))
    assert found.tells and not found.displaced and not found.unfit


@pytest.mark.parametrize(
    "moved", [(47, 48, 49), (0,), (23,), (10, 11), tuple(range(25, 50)), tuple(range(5, 12))]
)
def test_motions_are_found_with_their_frames(moved: tuple[int, ...]) -> None:
    found = look(recording(2, 50, moved, (9.0, 5.0, 0.0)))
    (run,) = found.displaced
    wanted = tuple(10 * k for k in moved)
    other = tuple(10 * k for k in range(50) if k not in moved)
    # With one half against the other, nobody knows which of them the label belongs to.
    assert run.frames in (wanted, other) if len(moved) == 25 else run.frames == wanted
    assert run.mm == pytest.approx(10.3, abs=1.0)
    if moved[-1] == 49 and len(moved) < 25:
        assert (run.before, run.after) == (460, None)


def test_an_error_of_the_label_is_no_motion() -> None:
    found = look(recording(3, 50, range(50), (5.0, -6.0, 3.0)))
    assert found.tells and not found.displaced and not found.unfit


def test_hidden_frames_are_unfit() -> None:
    found = look(recording(4, 50, (20, 21, 22, 40), hidden=True))
    assert not found.displaced
    assert found.unfit == (200, 210, 220, 400)
    found.leave_out([210])
    assert found.unfit == (200, 220, 400)


def test_small_motions_are_no_fault() -> None:
    """Camera poses have errors of a millimetre or two."""
    assert not look(recording(5, 50, (12, 30), (2.0, 1.0, 0.0))).displaced


def test_what_the_error_of_a_camera_explains_is_no_motion() -> None:
    frames = recording(8, 50, (49,), (7.0, 4.0, 0.0))
    assert [d.frames for d in look(frames).displaced] == [(490,)]
    assert not look(frames, camera_mm=6.0).displaced


@pytest.mark.parametrize("moved", [(47, 48, 49), (23,)])
def test_motions_are_found_beside_errors_of_cameras(moved: tuple[int, ...]) -> None:
    (run,) = look(recording(9, 50, moved, (11.0, 6.0, 0.0)), camera_mm=1.0).displaced
    assert run.frames == tuple(10 * k for k in moved)
    assert run.mm == pytest.approx(12.5, abs=1.0)


def test_clutter_alone_tells_nothing() -> None:
    assert not look(recording(6, 50, range(50), hidden=True)).tells


def test_two_frames_tell_nothing() -> None:
    assert not look(recording(7, 2)).tells
