"""A simulated recording has the form that import, annotation and scoring already read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated_views import COLOR, LABELS, make_frame, make_scene

from sensors.output.recording_writer import simulated_recording
from sensors.synthetic import label_errors, read_truth, scene_from_truth
from sensors.synthetic.truth import write_annotations
from sensors.viewpoints.camera_path import TrajectoryOptions, smooth_trajectory
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.labels.entry.posefile import read_pose
from std_toolkit.scene import Labels


@pytest.fixture(scope="module")
def simulated():
    scene = make_scene(name="arc", frames=3)
    poses = smooth_trajectory(2, TrajectoryOptions(frames=3, sweep_deg=40))
    return scene, [make_frame(scene, i, T) for i, T in enumerate(poses)]


@pytest.fixture(scope="module")
def recording(simulated, tmp_path_factory) -> Path:
    scene, frames = simulated
    out = tmp_path_factory.mktemp("simulated") / "recording"
    with simulated_recording(out, scene) as writer:
        for frame in frames:
            writer.add(frame)
    return out


def test_the_truth_is_that_of_the_simulation(simulated, recording) -> None:
    scene, frames = simulated
    truth = read_truth(recording)
    assert truth.camera.camera() == COLOR.resized(*LABELS)
    assert truth.frames == ["000000", "000001", "000002"]
    for i, frame in enumerate(frames):
        np.testing.assert_allclose(
            truth.camera_pose(i).matrix(), frame.T_world_cam.matrix(), atol=1e-12
        )
    for item, found in zip(scene.objects, truth.objects, strict=True):
        assert (found.category, found.class_id) == (item.category, item.class_id)
        assert found.material == item.material_class
        assert len(found.symmetry.continuous) == len(item.symmetry.continuous)
        pose = truth.object_pose(found.name)
        np.testing.assert_allclose(pose.matrix(), item.T_world_obj.matrix(), atol=1e-12)
        mesh = load_mesh(recording / found.mesh)
        np.testing.assert_allclose(mesh.vertices, item.mesh.vertices * item.scale_m, atol=1e-7)


def test_it_is_imported_like_any_camera_s(simulated, recording, tmp_path) -> None:
    _, frames = simulated
    request = ImportRequest(
        source=recording,
        name="arc",
        color=str(recording / "color"),
        depth=str(recording / "depth"),
        depth_scale=0.001,
        intrinsics=str(recording / "intrinsics.json"),
    )
    scene = import_recording(request, tmp_path / "scene")
    assert scene.poses is None
    assert scene.camera(scene.frames[0]) == frames[0].label_camera
    for frame, row in zip(frames, scene.frames, strict=True):
        read = scene.read_depth(row)
        np.testing.assert_array_equal(read > 0, frame.depth_aligned > 0)
        assert np.abs(read - frame.depth_aligned).max() <= 0.0005 + 1e-6


def test_scoring_finds_no_error_in_the_truth_and_finds_one_in_a_shift(recording, tmp_path) -> None:
    scene = scene_from_truth(recording, tmp_path / "scene")
    assert label_errors(scene, recording).percentile_mm(100) < 1e-6
    shift = SE3(np.eye(3), np.array([0.003, 0, 0]))
    labels = [
        type(x)(
            object=x.object,
            frame=x.frame,
            T_cam_obj=x.T_cam_obj,
            T_world_obj=(shift @ SE3.from_matrix(x.T_world_obj)).flat(),
        )
        for x in scene.labels.labels
    ]
    scene.save_labels(Labels(labels=labels))
    assert label_errors(scene, recording).percentile_mm(50) == pytest.approx(3, rel=1e-3)


def test_the_simulated_annotator_works_on_it(simulated, recording) -> None:
    truth = read_truth(recording)
    paths = write_annotations(truth, recording)
    for item in truth.objects:
        exact = truth.camera_pose(0).inverse() @ SE3.from_matrix(item.T_world_obj)
        off = read_pose(paths[item.name]).inverse() @ exact
        assert 0 < np.linalg.norm(off.t) < 0.1


def test_readings_that_do_not_fit_are_lost_as_in_a_camera(simulated, tmp_path) -> None:
    scene, frames = simulated
    with simulated_recording(tmp_path / "fine", scene, depth_scale=1e-5) as writer:
        for frame in frames:
            writer.add(frame)
    request = ImportRequest(
        source=tmp_path / "fine",
        name="fine",
        color=str(tmp_path / "fine/color"),
        depth=str(tmp_path / "fine/depth"),
        depth_scale=1e-5,
        intrinsics=str(tmp_path / "fine/intrinsics.json"),
    )
    back = import_recording(request, tmp_path / "scene")
    depth, exact = back.read_depth(back.frames[0]), frames[0].depth_aligned
    assert (exact > 0.66).any()
    assert not depth[exact > 0.66].any()
    near = exact < 0.65
    assert np.abs(depth - exact)[near].max() < 1e-5


def test_what_is_no_recording_is_refused(simulated, tmp_path) -> None:
    scene, frames = simulated
    out = tmp_path / "recording"
    with pytest.raises(ToolkitError, match="2 of 3"), simulated_recording(out, scene) as writer:
        writer.add(frames[0])
    with (
        pytest.raises(ToolkitError, match="depth_scale"),
        simulated_recording(out, scene, depth_scale=0),
    ):
        pass
    assert list(tmp_path.iterdir()) == []
