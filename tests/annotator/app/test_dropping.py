"""A dropped mesh appears under the pointer, upright, and stands on the table if there is one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from annotator.app.placing import USUAL_DISTANCE_M, USUAL_UP, dropped_pose, upright_rotation
from std_toolkit.geometry import Camera, so3_exp
from std_toolkit.geometry.turned_surface import round_axis
from std_toolkit.labels.support.plane import Plane

CAMERA = Camera(640, 480, 600.0, 590.0, 321.0, 238.0, (-0.1, 0.02, 0.001, -0.002))
UV = (250.5, 310.25)
# Half a metre below the camera, seen at a slant.
TABLE = Plane(np.array([0.05, -0.8, -0.6]), 0.5)


def turned_can() -> tuple[np.ndarray, np.ndarray]:
    can = trimesh.creation.cylinder(0.033, 0.1)
    return np.asarray(can.vertices) + np.array([0.2, -0.1, 0.3]), so3_exp([0.7, -0.4, 1.1])


@pytest.mark.parametrize("table", [TABLE, None])
@pytest.mark.parametrize("depth_m", [0.6, None])
def test_the_middle_appears_under_the_pointer(table: Plane | None, depth_m: float | None) -> None:
    points, R = turned_can()
    depth = None if depth_m is None else np.full((480, 640), depth_m, np.float32)
    pose = dropped_pose(CAMERA, UV, points, R, depth=depth, table=table)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    assert CAMERA.project(pose @ middle) == pytest.approx(UV, abs=1e-6)
    np.testing.assert_allclose(pose.R, R, atol=1e-12)


def test_on_a_table_the_lowest_point_touches_it_however_the_mesh_is_turned() -> None:
    points, R = turned_can()
    pose = dropped_pose(CAMERA, UV, points, R, table=TABLE)
    assert TABLE.signed_distance(pose @ points).min() == pytest.approx(0, abs=1e-9)


def test_without_a_table_it_lies_behind_what_the_sensor_saw() -> None:
    points, R = turned_can()
    depth = np.zeros((480, 640), np.float32)
    depth[300:320, 240:260] = 0.8
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    assert 0.8 < (dropped_pose(CAMERA, UV, points, R, depth=depth) @ middle)[2] < 0.9


def test_where_nothing_was_seen_it_comes_to_the_usual_distance() -> None:
    points, R = turned_can()
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    empty = np.zeros((480, 640), np.float32)
    for depth in (None, empty):
        pose = dropped_pose(CAMERA, UV, points, R, depth=depth)
        assert (pose @ middle)[2] == pytest.approx(USUAL_DISTANCE_M)


def test_a_table_seen_from_below_holds_nothing() -> None:
    points, R = turned_can()
    above = Plane(np.array([0.0, -1.0, 0.0]), -0.5)  # over the camera, the pointer looks down
    pose = dropped_pose(CAMERA, UV, points, R, table=above)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    assert (pose @ middle)[2] == pytest.approx(USUAL_DISTANCE_M)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("up", [USUAL_UP, (0.1, -0.7, -0.7), (0.0, 0.0, -1.0)])
def test_the_axis_that_is_up_is_up(axis: int, up: tuple[float, float, float]) -> None:
    R = upright_rotation(up, axis)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    assert R[:, axis] == pytest.approx(np.array(up) / np.linalg.norm(up))


def test_the_front_looks_at_the_camera() -> None:
    """-y where z is up, as in CAD programs; +z where y is up, as in glTF."""
    assert (upright_rotation(USUAL_UP, 2) @ [0, -1, 0])[2] < -0.7
    assert (upright_rotation(USUAL_UP, 1) @ [0, 0, 1])[2] < -0.7


def _with_axis(mesh: trimesh.Trimesh, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with what is its z axis as another one."""
    return np.roll(np.asarray(mesh.vertices), axis - 2, axis=1), np.asarray(mesh.faces)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_cans_mugs_and_bowls_are_turned_about_the_axis_that_is_up(axis: int) -> None:
    can = trimesh.creation.cylinder(0.033, 0.1)
    handle = trimesh.creation.box((0.03, 0.01, 0.06))
    handle.apply_translation([0.045, 0, 0])
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.08)
    bowl = ball.submesh([np.flatnonzero(ball.triangles_center[:, 2] < -0.02)], append=True)
    for mesh in (can, trimesh.util.concatenate([can, handle]), bowl):
        assert round_axis(*_with_axis(mesh, axis)) == axis


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("size", [(0.2, 0.1, 0.04), (0.1, 0.1, 0.1), (0.05, 0.05, 0.2)])
def test_boxes_do_not_tell_which_way_is_up(axis: int, size: tuple[float, float, float]) -> None:
    box = trimesh.creation.box(size).subdivide().subdivide().subdivide()
    assert round_axis(*_with_axis(box, axis)) is None


def test_a_ball_does_not_tell_which_way_is_up() -> None:
    assert round_axis(*_with_axis(trimesh.creation.icosphere(radius=0.05), 2)) is None


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "axis"),
    [
        ("002_master_chef_can", 2),
        ("024_bowl", 2),
        ("025_mug", 2),
        ("019_pitcher_base", 2),
        ("003_cracker_box", None),
        ("010_potted_meat_can", None),
        ("061_foam_brick", None),
        ("035_power_drill", None),
    ],
)
def test_scanned_meshes(test_data: Path, name: str, axis: int | None) -> None:
    path = test_data / "ycb_meshes" / name / "textured.obj"
    mesh = trimesh.load(path, force="mesh", process=False)
    assert round_axis(*_with_axis(mesh, 2)) == axis  # type: ignore[arg-type]
