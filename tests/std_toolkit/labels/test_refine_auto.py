"""One call refines what is there: with depth or without, with camera poses or in one frame."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from depth_picture import CAMERA, bottle_mesh, mesh_object, off, photograph
from tiny_camera import camera_pose

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.geometry.symmetry import mssd
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.labels import auto_refine
from std_toolkit.labels.auto_refine import RefineCancelled, RefinedPose, refine_objects
from std_toolkit.labels.entry.label import add_model, add_object
from std_toolkit.labels.refine.problem import RefineOptions
from std_toolkit.labels.refine_inputs import NOT_CONVERGED
from std_toolkit.scene import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Scene,
    SceneInfo,
)
from std_toolkit.scene.pose_model import ScaleReport

ANGLES = (-0.9, -0.3, 0.3, 0.9)
BOX = SE3(so3_exp([0.0, 0.0, 0.4]), np.array([-0.04, -0.02, 0.05]))
BOTTLE = SE3(so3_exp([0.0, 0.0, -0.9]), np.array([0.06, 0.01, 0.0]))


@dataclass(frozen=True)
class Stage:
    """A scene with a box (id 1) and a bottle (id 2), and where they are."""

    scene: Scene
    truth: dict[int, SE3]

    def rough(self, mm: float = 20, deg: float = 12) -> dict[int, SE3]:
        return {i: off(T, self.centre(i), mm / 1000, deg, seed=i) for i, T in self.truth.items()}

    def centre(self, i: int) -> np.ndarray:
        return self.scene.mesh(self.scene.objects.object(i).model).bounds.mean(axis=0)

    def error_mm(self, found: RefinedPose, truth: SE3 | None = None) -> float:
        mesh = self.scene.mesh(self.scene.objects.object(found.object).model)
        return 1000 * mssd(found.pose, truth or self.truth[found.object], mesh.vertices)

    def in_camera(self, poses: dict[int, SE3], angle: float) -> dict[int, SE3]:
        T = camera_pose(angle, radius=0.45, height=0.3).inverse()
        return {i: T @ pose for i, pose in poses.items()}


def make_stage(
    root: Path,
    *,
    depth: bool = True,
    registered: int = len(ANGLES),
    bottle: str = "transparent",
    unit: str | None = None,
) -> Stage:
    meshes = {"box": trimesh.creation.box((0.08, 0.05, 0.1)), "bottle": bottle_mesh()}
    things = [mesh_object(meshes["box"], BOX), mesh_object(meshes["bottle"], BOTTLE)]
    frames, poses = [], []
    for i, angle in enumerate(ANGLES):
        view = photograph(things, angle)
        write_color(root / f"color/{i}.png", view.color)
        if depth:
            write_depth_png16(root / f"depth/{i}.png", view.depth, scale=0.0001)
        frames.append(
            Frame(
                id=i, name=f"{i}", color=f"color/{i}.png", depth=f"depth/{i}.png" if depth else None
            )
        )
        if i < registered:
            pose = FramePose(frame=i, status="registered", T_world_cam=view.T_world_cam.flat())
        else:
            pose = FramePose(frame=i, status="unregistered")
        poses.append(pose)
    info = SceneInfo(name="stage", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.0001)
    scene = Scene.create(root, info, Frames(frames=frames))
    if registered:
        scale = ScaleReport(unit="unknown", chosen="none") if unit == "unknown" else None
        scene.save_poses(CameraPoses(frames=poses, scale=scale))
    for name, mesh in meshes.items():
        path = root / f"{name}.ply"
        mesh.export(path)
        material = "diffuse" if name == "box" else bottle
        add_object(scene, name, model=add_model(scene, path).id, material=material)
    return Stage(scene, {1: BOX, 2: BOTTLE})


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    return make_stage(tmp_path_factory.mktemp("stage") / "scene")


@pytest.mark.slow
def test_opaque_by_depth_and_glass_by_contours(stage: Stage) -> None:
    found = refine_objects(stage.scene, stage.rough())
    assert found.posed and not found.failures
    box, bottle = found.objects[1], found.objects[2]
    assert stage.error_mm(box) < 1.0 and stage.error_mm(bottle) < 1.5
    assert box.method.startswith("depth and edges, 4 views, edges 0.")
    assert bottle.method.startswith("edges, 4 views") and bottle.depth_m is None
    assert box.frames == (0, 1, 2, 3)
    assert box.explained > 0.95 and bottle.explained is None
    assert "object axis" in box.weak_direction and box.covariance.shape == (6, 6)
    assert box.warnings == () and bottle.warnings == ()


@pytest.mark.slow
def test_a_handle_on_the_wrong_side_is_found_where_depth_places_the_body(tmp_path: Path) -> None:
    stage = make_stage(tmp_path / "scene", bottle="diffuse")
    turn = SE3(so3_exp([0.0, 0.0, np.deg2rad(70)]), np.zeros(3))
    start = SE3(BOTTLE.R @ turn.R, BOTTLE.t + np.array([0.01, -0.008, 0.004]))
    found = refine_objects(stage.scene, {1: BOX, 2: start}, [2]).objects[2]
    assert found.method.startswith("depth and edges")
    assert stage.error_mm(found) < 1.0


def test_only_the_chosen_are_moved(stage: Stage) -> None:
    poses = stage.rough()
    found = refine_objects(stage.scene, poses, [1])
    assert list(found.objects) == [1]
    assert stage.error_mm(found.objects[1]) < 1.0


def test_one_frame_of_a_posed_scene(stage: Stage) -> None:
    found = refine_objects(stage.scene, stage.rough(), [1], frames=[2])
    box = found.objects[1]
    assert found.posed and box.frames == (2,)
    assert box.method.startswith("depth and edges, 1 view, edges")
    assert box.explained > 0.9
    assert stage.error_mm(box) < 1.0


def test_one_frame_without_depth_says_that_the_distance_is_weak(stage: Stage) -> None:
    found = refine_objects(stage.scene, stage.rough(8, 5), [2], frames=[1])
    (warning,) = found.objects[2].warnings
    assert "the distance to the camera is weak" in warning and "mm" in warning


@pytest.mark.slow
def test_a_frame_without_a_camera_pose_works_in_its_camera(tmp_path: Path) -> None:
    stage = make_stage(tmp_path / "scene", registered=3)
    poses = stage.in_camera(stage.rough(), ANGLES[3])
    found = refine_objects(stage.scene, poses, [1], frames=[3])
    assert not found.posed
    truth = stage.in_camera(stage.truth, ANGLES[3])
    assert stage.error_mm(found.objects[1], truth[1]) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("unit", [None, "unknown"])
def test_a_scene_without_metric_poses_needs_one_frame(tmp_path: Path, unit: str | None) -> None:
    stage = make_stage(tmp_path / "scene", registered=4 if unit else 0, unit=unit)
    poses = stage.in_camera(stage.rough(), ANGLES[0])
    found = refine_objects(stage.scene, poses, [1], frames=[0])
    truth = stage.in_camera(stage.truth, ANGLES[0])
    assert not found.posed and stage.error_mm(found.objects[1], truth[1]) < 1.0
    with pytest.raises(ToolkitError, match="one frame must be given"):
        refine_objects(stage.scene, poses, [1])
    with pytest.raises(ToolkitError, match="needs exactly one frame"):
        refine_objects(stage.scene, poses, [1], frames=[0, 1])


@pytest.mark.slow
def test_without_any_depth_opaque_objects_go_by_their_contours(tmp_path: Path) -> None:
    stage = make_stage(tmp_path / "scene", depth=False)
    found = refine_objects(stage.scene, stage.rough(), [1])
    assert found.objects[1].method.startswith("edges, 4 views")
    assert stage.error_mm(found.objects[1]) < 1.5


@pytest.mark.slow
def test_the_method_can_be_chosen(stage: Stage) -> None:
    poses = stage.rough()
    by_edges = refine_objects(stage.scene, poses, [1], method="multiview").objects[1]
    assert by_edges.depth_m is None and stage.error_mm(by_edges) < 1.5
    by_depth = refine_objects(stage.scene, poses, [2], method="depth", frames=[1]).objects[2]
    assert by_depth.depth_m is not None and stage.error_mm(by_depth) < 1.5


def test_depth_where_there_is_none_fails_with_a_reason(tmp_path: Path) -> None:
    stage = make_stage(tmp_path / "scene", depth=False)
    with pytest.raises(ToolkitError, match="the views have no sensor depth"):
        refine_objects(stage.scene, stage.rough(), [1], method="depth")


def test_one_object_out_of_view_does_not_stop_the_others(stage: Stage) -> None:
    poses = stage.rough()
    poses[2] = SE3(poses[2].R, np.array([3.0, 3.0, 0.0]))
    found = refine_objects(stage.scene, poses, frames=[0, 1, 2, 3])
    assert list(found.objects) == [1] and stage.error_mm(found.objects[1]) < 1.0
    assert "is not visible enough" in str(found.failures[2])
    with pytest.raises(ToolkitError):
        refine_objects(stage.scene, poses, [2], frames=[0, 1, 2, 3])


def test_what_cannot_be_asked(stage: Stage) -> None:
    with pytest.raises(ToolkitError, match="no object to refine"):
        refine_objects(stage.scene, {})
    with pytest.raises(ToolkitError, match="bottle: this object has no initial pose"):
        refine_objects(stage.scene, {1: BOX}, [2])
    with pytest.raises(ToolkitError, match="no such frame"):
        refine_objects(stage.scene, stage.truth, frames=[77])


@pytest.mark.slow
def test_a_sensor_that_contradicts_the_mesh_is_told(stage: Stage) -> None:
    """A slab in the place of a bottle: wherever it ends, nobody is told that it fits."""
    slab = trimesh.creation.box((0.15, 0.15, 0.02))
    found = refine_objects(
        stage.scene, {1: stage.truth[2]}, [1], frames=[0, 1, 2, 3], mesh=lambda _: slab
    )
    assert found.objects[1].explained < 0.5
    assert any("of the sensor depth on it agrees" in w for w in found.objects[1].warnings)


def test_progress_and_cancelling(stage: Stage) -> None:
    told: list[float] = []
    refine_objects(stage.scene, stage.truth, [1], frames=[0], progress=told.append)
    assert told == sorted(told) and told[-1] == 1.0 and len(told) >= 2
    with pytest.raises(RefineCancelled):
        refine_objects(stage.scene, stage.truth, [1], cancelled=lambda: True)


@pytest.mark.slow
def test_progress_goes_on_to_the_end(stage: Stage) -> None:
    """By depth, by a search, and along the edges: nowhere does it stand still for long."""
    told: list[float] = []
    began, seconds = time.process_time(), []

    def tell(fraction: float) -> None:
        told.append(fraction)
        seconds.append(time.process_time() - began)

    refine_objects(stage.scene, stage.rough(), progress=tell)
    assert told == sorted(told) and told[-1] == 1.0
    assert max(np.diff(told)) < 0.3
    # When half of the time is over, about half of the way is told to be done.
    halfway = told[int(np.searchsorted(seconds, seconds[-1] / 2))]
    assert 0.25 < halfway < 0.85
    assert max(np.diff(seconds)) < 0.4 * seconds[-1]


@pytest.mark.slow
def test_what_does_not_settle_is_told(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    poses = stage.rough(10, 6)
    settled = refine_objects(stage.scene, poses, [1], method="multiview").objects[1]
    assert NOT_CONVERGED not in settled.warnings
    # One step at the finest level, from wherever the search ends.
    monkeypatch.setattr(auto_refine, "RefineOptions", partial(RefineOptions, iterations=-3))
    stopped = refine_objects(stage.scene, poses, [1], method="multiview").objects[1]
    assert NOT_CONVERGED in stopped.warnings


def test_meshes_at_hand_are_not_read_again(stage: Stage) -> None:
    asked: list[str] = []

    def mesh(model: str) -> trimesh.Trimesh:
        asked.append(model)
        return stage.scene.mesh(model)

    refine_objects(stage.scene, stage.truth, [1], frames=[0], mesh=mesh)
    assert sorted(asked) == ["bottle", "box"]
