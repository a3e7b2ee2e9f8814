"""True poses of frames: as they were drawn, in both layouts and in scenes of the toolkit."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from benchmark.data.splits import open_split
from benchmark.data.true_poses import KnownBox, known_boxes, true_poses
from std_toolkit.errors import ToolkitError
from std_toolkit.options import RenderOptions
from std_toolkit.rendering.render_step import render_ground_truth
from tests.benchmark.evaluation.pose_set import SERIAL, SPLIT, write_pose_split
from tests.dreds_on_disk import BALLS, pose, write_dreds_scene
from tests.scene_on_disk import write_scene


def test_poses_are_those_that_were_drawn(tmp_path: Path) -> None:
    source = open_split(SPLIT, write_pose_split(tmp_path, scenes=1))
    frame = source.load(1, nocs=True)
    found = true_poses(frame, known_boxes(source, 1))
    assert [p.instance.mask_id for p in found] == [1, 2, 3], "what is of no class has no pose"
    for true, ball in zip(found, BALLS, strict=False):
        expected = pose(ball, 1)
        scale = np.cbrt(np.linalg.det(true.RT[:3, :3]))
        assert scale == pytest.approx(ball.diagonal, rel=0.01)
        np.testing.assert_allclose(true.RT[:3, :3] / scale, expected.R, atol=0.01)
        np.testing.assert_allclose(true.RT[:3, 3], expected.t, atol=0.001)
        np.testing.assert_allclose(true.size, 1 / np.sqrt(3))
        assert true.box_known
        assert true.pixels == int((frame.mask == ball.mask_id).sum())


def test_without_models_the_box_is_what_can_be_seen(tmp_path: Path) -> None:
    source = open_split(SPLIT, write_pose_split(tmp_path, scenes=1, cad=False))
    assert known_boxes(source, 0) == {}
    for true in true_poses(source.load(0, nocs=True), {}):
        assert not true.box_known
        scale = np.cbrt(np.linalg.det(true.RT[:3, :3]))
        # Half of a ball is seen: its sides are, up to a pixel at the outline.
        np.testing.assert_allclose(scale * true.size, 0.1, atol=0.01)


def test_frames_without_coordinates_have_no_poses(tmp_path: Path) -> None:
    folder = tmp_path / "DREDS-CatKnown" / "test" / "1"
    write_dreds_scene(folder, frames=1, short_meta=True)
    source = open_split(SPLIT, tmp_path)
    with pytest.raises(ToolkitError, match="no normalised coordinates"):
        true_poses(source.load(0, nocs=True), {})


def test_a_damaged_box_is_named(tmp_path: Path) -> None:
    source = open_split(SPLIT, write_pose_split(tmp_path, scenes=1))
    path = tmp_path / "cad_model" / "syn_test" / "02876657" / "bottle_a" / "bbox.txt"
    path.write_text("1 2\n")
    with pytest.raises(ToolkitError, match=r"bbox\.txt.*two rows of three"):
        known_boxes(source, 0)


def test_scenes_of_the_toolkit_tell_exact_poses(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "tiny")
    table = scene.objects
    camera = msgspec.structs.replace(table.models[0], class_id=3, category="camera")
    scene.save_objects(msgspec.structs.replace(table, models=[camera]))
    options = RenderOptions(renderer="raycast", policy="models")
    render_ground_truth(scene, options, jobs=SERIAL)
    source = open_split("scenes", tmp_path)
    boxes = known_boxes(source, 0)
    frame = source.load(0, nocs=True)
    (exact,) = true_poses(frame, boxes)
    (fitted,) = true_poses(frame, {i: KnownBox(box.sides) for i, box in boxes.items()})
    T_cam_obj = scene.T_cam_obj(scene.frames[0].id, 1)
    assert T_cam_obj is not None
    centre = scene.mesh(camera.id).bounds.mean(axis=0)
    np.testing.assert_allclose(exact.RT[:3, 3], T_cam_obj @ centre, atol=1e-9)
    np.testing.assert_allclose(
        exact.RT[:3, :3], T_cam_obj.R * np.linalg.norm(camera.size_m), atol=1e-9
    )
    np.testing.assert_allclose(exact.size * np.linalg.norm(camera.size_m), camera.size_m)
    assert np.linalg.norm(exact.RT[:3, 3] - fitted.RT[:3, 3]) < 1e-3
    np.testing.assert_allclose(exact.RT[:3, :3], fitted.RT[:3, :3], atol=2e-3)
