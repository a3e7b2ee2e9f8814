"""The store: what is saved is found again, and a scene never refers to what it lacks."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scene_on_disk import CAMERA, OBJECT_IN_WORLD, camera_pose, contents, write_scene

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import write_color, write_depth_png16, write_png
from std_toolkit.scene import (
    CameraModel,
    CameraPoses,
    FramePose,
    Frames,
    Label,
    Labels,
    ObjectTable,
    Scene,
    SceneInfo,
)

IDENTITY = SE3.identity().flat()


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return write_scene(tmp_path / "scene")


def test_a_scene_opens_as_it_was_saved(scene: Scene) -> None:
    again = Scene.open(scene.root)
    assert again.info == scene.info
    assert again.frames == scene.frames
    assert again.objects == scene.objects
    assert again.poses == scene.poses
    assert again.labels == scene.labels
    before = contents(scene.root)
    again.save_info(again.info)
    again.save_objects(again.objects)
    again.save_poses(again.poses)
    again.save_labels(again.labels)
    assert contents(scene.root) == before


def test_images_come_in_memory_conventions(scene: Scene) -> None:
    frame = scene.frame(1)
    assert scene.read_color(frame).shape == (72, 96, 3)
    depth = scene.read_depth(frame)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, 0.8, rtol=1e-6)


def test_depth_carries_the_correction_of_its_sensor(scene: Scene) -> None:
    scene.save_info(msgspec.structs.replace(scene.info, depth_correction=0.98))
    np.testing.assert_allclose(scene.read_depth(scene.frame(0)), 0.8 * 0.98, rtol=1e-6)
    np.testing.assert_allclose(
        Scene.open(scene.root).read_depth(scene.frame(0)), 0.8 * 0.98, rtol=1e-6
    )


def test_a_frame_without_depth_says_so(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    assert scene.read_depth(msgspec.structs.replace(scene.frame(0), depth=None)) is None


def test_poses_chain_from_object_to_camera(scene: Scene) -> None:
    for i in range(3):
        expected = camera_pose(i).inverse() @ OBJECT_IN_WORLD
        np.testing.assert_allclose(scene.T_cam_obj(i, 1).matrix(), expected.matrix(), atol=1e-12)


def test_unregistered_frames_have_no_pose(scene: Scene) -> None:
    lost = FramePose(frame=1, status="unregistered")
    scene.save_poses(CameraPoses(frames=[scene.poses.frames[0], lost]))
    assert scene.T_world_cam(0) is not None
    assert scene.T_world_cam(1) is None
    assert scene.T_world_cam(2) is None
    assert [f.id for f in scene.registered_frames()] == [0]
    assert scene.T_cam_obj(1, 1) is None
    assert scene.T_cam_obj(0, 99) is None


def test_intrinsics_refined_with_the_poses_replace_the_recorded_ones(scene: Scene) -> None:
    refined = CameraModel.of(Camera(96, 72, 91.5, 91.0, 47.0, 36.0, (0.1, 0.0, 0.0, 0.0)))
    scene.save_poses(msgspec.structs.replace(scene.poses, cameras={"color": refined}))
    assert scene.camera(scene.frame(0)).fx == 91.5
    assert Scene.open(scene.root).camera(scene.frame(0)).distortion == (0.1, 0, 0, 0)


def test_meshes_are_read_once(scene: Scene) -> None:
    assert scene.mesh("box") is scene.mesh("box")
    with pytest.raises(ToolkitError, match=r"no such model.*known: box"):
        scene.mesh("mug")


def test_there_is_no_scene_without_its_document(tmp_path: Path) -> None:
    for root in (tmp_path, tmp_path / "missing"):
        with pytest.raises(ToolkitError, match=r"no scene here.*std-curate import"):
            Scene.open(root)


def test_creating_a_scene_overwrites_none(scene: Scene) -> None:
    before = contents(scene.root)
    with pytest.raises(ToolkitError, match="there is a scene here already"):
        Scene.create(scene.root, scene.info, scene.frame_table)
    assert contents(scene.root) == before


def test_a_scene_that_was_not_finished_is_none(tmp_path: Path, scene: Scene) -> None:
    """scene.json is written last: a killed import leaves no half scene that looks whole."""
    (scene.root / "scene.json").unlink()
    with pytest.raises(ToolkitError, match="no scene here"):
        Scene.open(scene.root)
    Scene.create(scene.root, scene.info, scene.frame_table, scene.objects)
    assert len(Scene.open(scene.root).frames) == 3


def test_an_unknown_frame_is_refused(scene: Scene) -> None:
    with pytest.raises(ToolkitError, match=r"no such frame \(got 7\)"):
        scene.frame(7)


def label_of(**changes: object) -> Labels:
    good = {"object": 1, "frame": 0, "T_cam_obj": IDENTITY}
    return Labels(labels=[Label(**{**good, **changes})])


def other_size(scene: Scene) -> CameraPoses:
    half = CameraModel.of(CAMERA.resized(48, 36))
    return msgspec.structs.replace(scene.poses, cameras={"color": half})


WRONG_DOCUMENTS = {
    "pose_of_unknown_frame": lambda s: s.save_poses(
        CameraPoses(frames=[FramePose(frame=9, status="unregistered")])
    ),
    "refined_unknown_camera": lambda s: s.save_poses(
        msgspec.structs.replace(s.poses, cameras={"other": CameraModel.of(CAMERA)})
    ),
    "refined_for_another_size": lambda s: s.save_poses(other_size(s)),
    "label_of_unknown_object": lambda s: s.save_labels(label_of(object=2)),
    "label_in_unknown_frame": lambda s: s.save_labels(label_of(frame=9)),
    "view_in_unknown_frame": lambda s: s.save_labels(label_of(views={"9": IDENTITY})),
    "cameras_that_frames_need": lambda s: s.save_info(
        SceneInfo(name="tiny", cameras={"infrared": CameraModel.of(CAMERA)})
    ),
    "nan_pose": lambda s: s.save_labels(label_of(T_cam_obj=[float("nan")] * 16)),
    "mirrored_pose": lambda s: s.save_labels(
        label_of(T_cam_obj=list(np.diag([1.0, 1, -1, 1]).ravel()))
    ),
    "nan_covariance": lambda s: s.save_labels(label_of(covariance=[float("nan")] * 36)),
}


@pytest.mark.parametrize("name", WRONG_DOCUMENTS)
def test_wrong_documents_are_not_saved(scene: Scene, name: str) -> None:
    before = contents(scene.root)
    with pytest.raises(ToolkitError):
        WRONG_DOCUMENTS[name](scene)
    assert contents(scene.root) == before
    assert scene.labels == Scene.open(scene.root).labels


@pytest.mark.parametrize("factor", [1000, 1e-3])
def test_depth_in_another_unit_is_refused(scene: Scene, factor: float) -> None:
    scene.save_info(msgspec.structs.replace(scene.info, depth_scale=0.001 * factor))
    with pytest.raises(ToolkitError, match=r"000000\.png: the median depth is implausible"):
        scene.read_depth(scene.frame(0))


def test_far_outliers_and_nearly_empty_depth_are_no_unit_error(scene: Scene) -> None:
    depth = np.zeros((72, 96))
    write_depth_png16(scene.root / "depth/000000.png", depth, scale=0.001)
    assert (scene.read_depth(scene.frame(0)) == 0).all()
    depth[:4, :4] = 65
    write_depth_png16(scene.root / "depth/000000.png", depth, scale=0.001)
    assert scene.read_depth(scene.frame(0)).max() == np.float32(65)


def test_images_of_another_size_are_refused(scene: Scene) -> None:
    write_color(scene.root / "color/000001.png", np.zeros((36, 48, 3), np.uint8))
    with pytest.raises(
        ToolkitError, match=r"000001\.png: image size differs from that of the camera, 96x72"
    ):
        scene.read_color(scene.frame(1))
    write_png(scene.root / "depth/000001.png", np.ones((36, 48), np.uint16))
    with pytest.raises(ToolkitError, match="depth must be aligned to colour"):
        scene.read_depth(scene.frame(1))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda f: [f[1], f[0]], "frames"),
        (lambda f: [f[0], f[0]], "frames"),
        (lambda f: [f[0], msgspec.structs.replace(f[1], name=f[0].name)], r"frames\[1\]\.name"),
    ],
    ids=["unsorted", "id_twice", "name_twice"],
)
def test_frames_rise_and_are_unique(scene: Scene, change: object, field: str) -> None:
    with pytest.raises(ToolkitError, match=field):
        Frames(frames=change(scene.frames))  # type: ignore[operator]


def test_objects_and_models_are_unique_and_known(scene: Scene) -> None:
    models, objects = scene.objects.models, scene.objects.objects
    for wrong in (
        {"models": models * 2, "objects": objects},
        {"models": models, "objects": objects * 2},
        {"models": [], "objects": objects},
    ):
        with pytest.raises(ToolkitError, match=r"^(models|objects)\[\d\]"):
            ObjectTable(**wrong)


def test_labels_are_one_per_object_and_sorted(scene: Scene) -> None:
    label = scene.labels.labels[0]
    with pytest.raises(ToolkitError, match=r"labels\[1\]\.object: appears twice"):
        Labels(labels=[label, label])
    second = msgspec.structs.replace(label, object=7)
    table = Labels(labels=[second]).with_label(label).with_label(second)
    assert [x.object for x in table.labels] == [1, 7]
    assert table.of(7) == second
    assert table.of(8) is None
