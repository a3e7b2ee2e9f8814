"""Finding the table: from depth, from reconstructed points, from objects, or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from table_scene import BOX, CAMERA, T_WORLD_BOX, T_WORLD_TABLE, camera_pose, write_table_scene

from std_toolkit.geometry import SE3
from std_toolkit.io.images import write_depth_png16
from std_toolkit.labels.support.neighbours import Cameras, score_support
from std_toolkit.labels.support.plane import Plane
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.labels.support.table import find_table, search_table
from std_toolkit.rendering.maps import compose
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import PlacedMesh

TRUE_NORMAL = T_WORLD_TABLE.R[:, 2]


def off(plane: Plane, T_frame_table: SE3 = T_WORLD_TABLE) -> tuple[float, float]:
    """Degrees of slope and millimetres of height by which a plane misses the table."""
    slope = np.degrees(np.arccos(min(1.0, float(plane.normal @ T_frame_table.R[:, 2]))))
    return float(slope), 1000 * float(plane.signed_distance(T_frame_table.t))


def test_exact_depth_gives_the_table(tmp_path: Path) -> None:
    table = find_table(write_table_scene(tmp_path / "s"))
    assert table is not None
    slope, height = off(table.plane)
    assert slope < 0.05
    assert abs(height) < 0.3
    assert table.plane.frame == "world"
    assert (table.source, table.quality, table.frames) == ("depth", "good", 8)
    assert 0.0005 < table.rms_m < 0.001
    assert 0.2 < table.radius_m < 0.6
    assert abs(table.plane.signed_distance(table.centre)) < 1e-9


def test_the_normal_points_to_the_cameras(tmp_path: Path) -> None:
    table = find_table(write_table_scene(tmp_path / "s"))
    assert table is not None
    cameras = np.array([camera_pose(i, 8).t for i in range(8)])
    assert (table.plane.signed_distance(cameras) > 0.3).all()


@pytest.mark.parametrize("factor", [0.985, 1.02])
def test_a_biased_sensor_is_found_out_by_cameras_at_different_heights(
    tmp_path: Path, factor: float
) -> None:
    table = find_table(write_table_scene(tmp_path / "s", frames=12, factor=factor))
    assert table is not None
    assert table.depth_factor == pytest.approx(factor, abs=0.001)
    assert abs(off(table.plane)[1]) < table.uncertainty_m * 1000 < 2
    assert any("the sensor reads" in note for note in table.notes)


def test_reconstructed_points_settle_the_height_of_a_biased_sensor(tmp_path: Path) -> None:
    """Two frames at one height tell nothing about the bias; the points do."""
    scene = write_table_scene(tmp_path / "s", factor=1.02, sparse=800)
    table = find_table(scene, frames=[scene.frames[0], scene.frames[1]])
    assert table is not None
    assert table.depth_factor == pytest.approx(1.02, abs=0.001)
    assert abs(off(table.plane)[1]) < 0.5
    assert any("points of the reconstruction" in note for note in table.notes)


def test_a_bias_that_cannot_be_told_is_part_of_the_uncertainty(tmp_path: Path) -> None:
    scene = write_table_scene(tmp_path / "s", factor=1.015)
    table = find_table(scene, frames=scene.frames[:2])
    assert table is not None
    assert table.depth_factor is None
    missed = abs(off(table.plane)[1])
    assert 4 < missed < 1000 * table.uncertainty_m
    assert any("too low" in note for note in table.notes)


def test_depth_inside_placed_objects_plays_no_part(tmp_path: Path) -> None:
    """A crate covers most of the view: its lid is a larger plane than the table around it."""
    scene = write_table_scene(tmp_path / "s", labelled=False)
    T_cam_world = camera_pose(0, 8).inverse()
    lid = trimesh.creation.box((0.34, 0.34, 0.02))
    crate = PlacedObject("crate", lid, T_WORLD_TABLE @ SE3(np.eye(3), np.array([0, 0, 0.09])))
    depth = scene.read_depth(scene.frames[0])
    assert depth is not None
    drawn = compose(
        RaycastRenderer(), CAMERA, [PlacedMesh(1, lid, T_cam_world @ crate.T_frame_obj)]
    ).depth
    assert (drawn > 0).mean() > 0.3
    covered = np.where(drawn > 0, drawn, depth)
    write_depth_png16(scene.root / "depth/000000.png", covered, scale=0.0001)
    blind = find_table(scene, frames=scene.frames[:1], objects=[])
    knowing = find_table(scene, frames=scene.frames[:1], objects=[crate])
    assert blind is not None
    assert off(blind.plane)[1] < -90
    assert knowing is not None
    assert abs(off(knowing.plane)[1]) < 2


def test_one_frame_gives_the_table_in_its_camera(tmp_path: Path) -> None:
    scene = write_table_scene(tmp_path / "s", posed=False)
    table = find_table(scene, camera_frame=3)
    assert table is not None
    assert table.plane.frame == "camera 3"
    slope, height = off(table.plane, camera_pose(3, 8).inverse() @ T_WORLD_TABLE)
    assert slope < 0.1
    assert abs(height) < 0.5
    world = search_table(scene)
    assert world.table is None
    assert "no frame has a camera pose" in world.reason


def test_poses_of_unknown_unit_give_no_table_in_the_world(tmp_path: Path) -> None:
    found = search_table(write_table_scene(tmp_path / "s", metres=False))
    assert found.table is None
    assert "unit" in found.reason


def test_without_depth_the_reconstruction_shows_the_table(tmp_path: Path) -> None:
    table = find_table(write_table_scene(tmp_path / "s", depth=False, sparse=600))
    assert table is not None
    assert table.source == "reconstruction"
    assert table.quality == "good"
    slope, height = off(table.plane)
    assert slope < 0.2
    assert abs(height) < 1000 * table.uncertainty_m


def standing_boxes() -> list[PlacedObject]:
    """Three boxes with label errors of a millimetre and half a degree."""
    rng = np.random.default_rng(5)
    places = [(0.05, 0.02, 0.0), (-0.2, 0.1, 1.0), (0.1, -0.25, 2.0)]
    things = []
    for i, (x, y, turn) in enumerate(places):
        upright = SE3.exp([0, 0, 0, 0, 0, turn])
        T = T_WORLD_TABLE @ SE3(upright.R, np.array([x, y, 0.05]))
        error = SE3.exp([*rng.normal(0, 0.001, 3), *rng.normal(0, np.radians(0.5), 3)])
        things.append(PlacedObject(f"box {i}", BOX, T @ error))
    return things


def test_without_either_the_objects_show_on_what_they_stand(tmp_path: Path) -> None:
    scene = write_table_scene(tmp_path / "s", depth=False, labelled=False)
    table = find_table(scene, objects=standing_boxes())
    assert table is not None
    assert (table.source, table.quality) == ("objects", "good")
    slope, height = off(table.plane)
    assert slope < 0.6
    assert abs(height) < 1.5


def test_a_lifted_object_does_not_lift_the_table(tmp_path: Path) -> None:
    things = standing_boxes()
    stacked = T_WORLD_BOX @ SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    scene = write_table_scene(tmp_path / "s", depth=False, labelled=False)
    table = find_table(scene, objects=[*things, PlacedObject("on top", BOX, stacked)])
    assert table is not None
    assert abs(off(table.plane)[1]) < 1.5
    assert "on top" not in table.notes[0]


def test_one_object_alone_is_a_doubtful_witness(tmp_path: Path) -> None:
    scene = write_table_scene(tmp_path / "s", depth=False)
    table = find_table(scene)
    assert table is not None
    assert table.quality == "doubtful"
    assert "only one object determines the table" in table.notes
    assert off(table.plane)[0] < 0.01


def test_with_nothing_to_go_by_the_reason_is_told(tmp_path: Path) -> None:
    scene = write_table_scene(tmp_path / "s", depth=False, labelled=False)
    assert find_table(scene) is None
    reason = search_table(scene).reason
    assert "no sensor depth" in reason
    assert "no object is placed yet" in reason


def test_a_wall_is_told_from_a_table() -> None:
    """The camera looks down on a table; a wall it sees straight on, or from below when it nods."""
    ahead, middle = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])
    verdicts = [
        score_support(ahead, 1.0, 0.5, middle, Cameras.of([SE3.exp([0, 0, 0, nod, 0, 0])]), ())
        for nod in np.radians([45, 0, -30])
    ]
    assert [round(v.upright, 2) for v in verdicts] == [0.71, 0.0, -0.5]
    scores = [v.score for v in verdicts]
    assert scores == sorted(scores, reverse=True)
    assert scores[0] > scores[1] > scores[2] > 0
