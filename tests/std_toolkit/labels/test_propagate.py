from __future__ import annotations

import numpy as np
import pytest
from tiny_camera import camera_pose

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.entry.label import add_model, add_object, set_pose
from std_toolkit.labels.entry.symmetry_argument import parse_symmetry
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.options import PropagateOptions
from std_toolkit.scene import Scene

T_WORLD_OBJ = SE3.exp(np.array([0.02, -0.03, 0.05, 0.1, 0.2, 0.5]))


@pytest.fixture
def labelled(scene, box_path):
    add_model(scene, box_path)
    add_object(scene, "box", model="box")
    set_pose(scene, "box", 0, camera_pose(0.0).inverse() @ T_WORLD_OBJ)
    return scene


def test_one_pose_serves_every_registered_frame(labelled):
    labels = propagate_labels(labelled)
    assert np.allclose(np.reshape(labels.labels[0].T_world_obj, (4, 4)), T_WORLD_OBJ.matrix())
    scene = Scene.open(labelled.root)
    expected = camera_pose(1.0).inverse() @ T_WORLD_OBJ
    assert np.allclose(scene.T_cam_obj(1, 1).matrix(), expected.matrix())
    # Frame 2 has no camera pose: no label is made up for it.
    assert scene.T_cam_obj(2, 1) is None


def test_it_is_not_redone_and_gives_the_same_bytes(labelled):
    propagate_labels(labelled)
    path = labelled.root / "labels.json"
    data, time = path.read_bytes(), path.stat().st_mtime_ns
    propagate_labels(Scene.open(labelled.root))
    assert path.stat().st_mtime_ns == time
    path.unlink()
    scene = Scene.open(labelled.root)
    set_pose(scene, "box", 0, camera_pose(0.0).inverse() @ T_WORLD_OBJ)
    propagate_labels(scene)
    assert path.read_bytes() == data


def test_views_from_two_sides_fix_each_others_depth(labelled):
    # Each annotation is 8 mm off along its own viewing ray, which moves no pixel much.
    for frame, angle in ((0, 0.0), (1, 1.0)):
        T = camera_pose(angle).inverse() @ T_WORLD_OBJ
        along = T.t / np.linalg.norm(T.t)
        set_pose(labelled, "box", frame, SE3(T.R, T.t + 0.008 * along), as_view=frame == 1)
    labels = propagate_labels(labelled)
    error = np.reshape(labels.labels[0].T_world_obj, (4, 4))[:3, 3] - T_WORLD_OBJ.t
    assert np.linalg.norm(error) < 0.004


def test_a_view_may_show_a_symmetric_variant(scene, box_path):
    symmetry = parse_symmetry(["fold:z:2"], centre=(0, 0, 0))
    add_model(scene, box_path, symmetry=symmetry)
    add_object(scene, "box", model="box")
    set_pose(scene, "box", 0, camera_pose(0.0).inverse() @ T_WORLD_OBJ)
    turned = T_WORLD_OBJ @ SE3.exp(np.array([0, 0, 0, 0, 0, np.pi]))
    set_pose(scene, "box", 1, camera_pose(1.0).inverse() @ turned, as_view=True)
    labels = propagate_labels(scene)
    assert np.allclose(
        np.reshape(labels.labels[0].T_world_obj, (4, 4)), T_WORLD_OBJ.matrix(), atol=1e-6
    )


def test_contradicting_views_are_refused(labelled):
    moved = SE3(T_WORLD_OBJ.R, T_WORLD_OBJ.t + np.array([0.15, 0, 0]))
    set_pose(labelled, "box", 1, camera_pose(1.0).inverse() @ moved, as_view=True)
    with pytest.raises(ToolkitError, match="contradict"):
        propagate_labels(labelled)


def test_an_object_annotated_in_an_unregistered_frame_gets_no_label(labelled):
    T = camera_pose(0.0).inverse() @ T_WORLD_OBJ
    set_pose(labelled, "box", 2, T)
    with pytest.raises(ToolkitError, match="no label is annotated in a registered frame"):
        propagate_labels(labelled)
    add_object(labelled, "other", model="box")
    set_pose(labelled, "other", 0, T)
    labels = propagate_labels(labelled)
    assert [x.T_world_obj is None for x in labels.labels] == [True, False]
    set_pose(labelled, "box", 1, camera_pose(1.0).inverse() @ T_WORLD_OBJ, as_view=True)
    labels = propagate_labels(labelled)
    assert np.allclose(np.reshape(labels.labels[0].T_world_obj, (4, 4)), T_WORLD_OBJ.matrix())


def test_what_is_missing_is_said(scene, box_path):
    with pytest.raises(ToolkitError, match="no labels"):
        propagate_labels(scene)
    with pytest.raises(ToolkitError, match="no such object"):
        propagate_labels(scene, PropagateOptions(objects=("ghost",)))
    (scene.root / "poses.json").unlink()
    with pytest.raises(ToolkitError, match="no camera poses"):
        propagate_labels(Scene.open(scene.root))
    with pytest.raises(ToolkitError, match="needs --refine"):
        PropagateOptions(refine_scale=True)


def test_the_same_annotation_again_keeps_what_was_derived(labelled):
    propagate_labels(labelled)
    label = labelled.labels.labels[0]
    again = set_pose(labelled, "box", 0, SE3.from_matrix(label.T_cam_obj))
    assert again.T_world_obj == label.T_world_obj is not None
    moved = SE3(np.eye(3), np.array([0.0, 0.0, 0.001])) @ SE3.from_matrix(label.T_cam_obj)
    assert set_pose(labelled, "box", 0, moved).T_world_obj is None
