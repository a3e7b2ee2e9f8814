"""Motions of labels by sensor depth, on exact depth of boxes and balls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from std_toolkit.arrays import Array
from std_toolkit.checks.gates.located import Located, located_by
from std_toolkit.checks.measure.array_file import ArrayFile
from std_toolkit.checks.measure.contours import LabelCaster
from std_toolkit.checks.measure.depth_motion import (
    DepthEquations,
    DepthMotionSettings,
    depth_equations,
    depth_motion,
)
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.settings import override
from tests.std_toolkit.labels.realsense_ycb import load_frame
from tests.std_toolkit.scanning.ball import look_at

CAMERA = Camera(320, 240, 300, 300, 159.5, 119.5)
VIEWS = [
    look_at(0.5 * np.array([np.cos(a) * 0.8, np.sin(a) * 0.8, 0.6]), np.zeros(3))
    for a in np.deg2rad([0, 25, 50, 75, 100])
]
NOTHING_FREE = np.zeros((0, 6))
STILL = [np.zeros((6, 6))] * len(VIEWS)
BOX = trimesh.creation.box((0.12, 0.08, 0.06)).subdivide()
MOTION = np.array([4.0, -3.0, 2.0, 2.0, -1.0, 3.0])


def maps(mesh: trimesh.Trimesh, T_world_obj: SE3, view: SE3) -> tuple[Array, Array]:
    caster = LabelCaster({1: (T_world_obj @ np.asarray(mesh.vertices), np.asarray(mesh.faces))})
    whole = np.ones((CAMERA.height, CAMERA.width), bool)
    hits = caster.cast_pixels(CAMERA, view, whole)
    shape = whole.shape
    return hits.depth.reshape(shape), hits.object_id.reshape(shape) == 1


def equations(
    mesh: trimesh.Trimesh,
    motion: Array,
    *,
    factor: float = 1.0,
    shift: int = 0,
    noise_m: float = 0.0,
) -> list[DepthEquations]:
    """Of a label at the origin, whose object is off by a motion (6,), mm and degrees."""
    rng = np.random.default_rng(0)
    true = SE3(so3_exp(np.deg2rad(motion[3:])), motion[:3] / 1000)
    found = []
    for view in VIEWS:
        label, mask = maps(mesh, SE3.identity(), view)
        sensor, _ = maps(mesh, true, view)
        sensor = np.roll(sensor, shift, axis=1) * factor
        sensor = np.where(sensor > 0, sensor + rng.normal(0, noise_m, sensor.shape), 0)
        rows = depth_equations(label, sensor, mask, CAMERA, view, np.zeros(3))
        assert rows is not None
        found.append(rows)
    return found


def located(rows: list[DepthEquations], free: Array = NOTHING_FREE) -> Located:
    at = located_by(depth_motion(rows, free, STILL[: len(rows)]))
    assert at is not None
    return at


def deviations(at: Located, truth: Array) -> Array:
    values, axes = np.linalg.eigh(at.covariance)
    known = values > 1e-5 * values[-1]
    return np.abs(axes.T @ (at.motion - truth))[known] / np.sqrt(values[known])


def test_a_motion_is_measured() -> None:
    at = located(equations(BOX, MOTION))
    np.testing.assert_allclose(at.motion[:3], MOTION[:3], atol=1.5)
    np.testing.assert_allclose(at.motion[3:], MOTION[3:], atol=0.7)
    assert deviations(at, MOTION).max() < 1
    assert at.mm[1] < 10  # a factor of 2 % at half a metre is one of 5 mm in height
    assert at.deg[1] < 6


def test_noise_moves_it_within_its_deviations() -> None:
    at = located(equations(BOX, MOTION, noise_m=0.002))
    assert deviations(at, MOTION).max() < 2


@pytest.mark.parametrize(("factor", "shift"), [(1.015, 0), (0.985, 0), (1.0, 1), (1.01, -1)])
def test_errors_of_all_readings_are_within_its_deviations(factor: float, shift: int) -> None:
    at = located(equations(BOX, np.zeros(6), factor=factor, shift=shift))
    assert deviations(at, np.zeros(6)).max() < 2


def test_what_a_symmetry_leaves_open_is_left_out() -> None:
    ball = trimesh.creation.icosphere(4, 0.05)
    motion = np.array([5.0, 0, -4, 0, 0, 0])
    at = located(equations(ball, motion), np.eye(6)[3:])
    assert deviations(at, motion).max() < 1
    np.testing.assert_allclose(at.motion[3:], 0, atol=1e-9)
    assert np.abs(at.covariance[3:]).max() < 1e-9


def test_two_frames_do_not_tell_how_readings_err() -> None:
    assert depth_motion(equations(BOX, MOTION)[:2], NOTHING_FREE, STILL[:2]) is None


def test_errors_of_cameras_widen_it() -> None:
    rows = equations(BOX, np.zeros(6))
    cameras = [np.diag([0.01**2] * 3 + [0.03**2] * 3)] * len(rows)
    wide = located_by(depth_motion(rows, NOTHING_FREE, cameras))
    assert wide is not None
    assert wide.mm[1] > 1.2 * located(rows).mm[1]


def test_readings_of_other_surfaces_are_left_out() -> None:
    label, mask = maps(BOX, SE3.identity(), VIEWS[0])
    nothing = np.zeros_like(label)
    for sensor in (nothing, label + 0.1):
        assert depth_equations(label, sensor, mask, CAMERA, VIEWS[0], np.zeros(3)) is None
    rows = []
    for view in VIEWS:
        label, mask = maps(BOX, SE3.identity(), view)
        hand = label.copy()
        hand[:, :150] -= 0.1  # a hand before a part of it
        rows.append(depth_equations(label, hand, mask, CAMERA, view, np.zeros(3)))
    at = located([row for row in rows if row is not None])
    np.testing.assert_allclose(at.motion, 0, atol=0.1)


@pytest.mark.real
def test_deviations_hold_for_a_real_sensor(test_data: Path) -> None:
    """The two frames that did not set them, against reference poses, which have errors, too."""
    z = []
    for index in (2, 3):
        frame = load_frame(test_data, index)
        objects = dict(enumerate(frame.objects, 1))
        view = frame.view
        caster = LabelCaster({k: (o.T_world_obj @ o.vertices, o.faces) for k, o in objects.items()})
        whole = np.ones((view.camera.height, view.camera.width), bool)
        hits = caster.cast_pixels(view.camera, view.T_world_cam, whole)
        depth, ids = hits.depth.reshape(whole.shape), hits.object_id.reshape(whole.shape)
        for k, thing in objects.items():
            centre = caster.corners[k].mean(axis=0)
            rows = depth_equations(
                depth, view.depth, ids == k, view.camera, view.T_world_cam, centre
            )
            assert rows is not None, thing.name
            with override(DepthMotionSettings(fewest_frames=1)):
                at = located([rows])
            z += list(deviations(at, np.zeros(6)))
    assert len(z) == 60
    assert np.mean(np.array(z) < 1) > 0.6
    assert np.mean(np.array(z) < 2) > 0.85


def test_rows_in_a_file_give_the_same(tmp_path: Path) -> None:
    rows = equations(BOX, MOTION)
    with ArrayFile(tmp_path) as file:
        filed = located([row.filed(file) for row in rows])
        np.testing.assert_array_equal(filed.motion, located(rows).motion)
