"""The synthetic recording is exact where it claims truth, sensor-like where it does not."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from sensors.synthetic import (
    RecordingOptions,
    annotate_first_frame,
    label_errors,
    make_recording,
    read_truth,
    scene_from_truth,
)
from sensors.synthetic.camera_frames import FrameMaps, render_frame, sensor_depth
from sensors.synthetic.raycast_world import World
from sensors.synthetic.recording import look_at
from sensors.synthetic.shapes import default_shapes
from sensors.synthetic.truth import write_annotations
from std_toolkit.geometry import SE3, Camera, unproject_depth
from std_toolkit.geometry.mesh import mesh_bounds
from std_toolkit.jobs import JobOptions
from std_toolkit.labels.entry.posefile import read_pose
from std_toolkit.scene import Scene

SMALL = RecordingOptions(frames=3, arc_degrees=30, width=160, height=120, seed=3)
SERIAL = JobOptions(engine="serial")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("synthetic") / "recording"
    make_recording(out, SMALL, jobs=SERIAL)
    return out


@pytest.fixture(scope="module")
def frame() -> tuple[Camera, SE3, FrameMaps]:
    world = World([], [], seed=0)
    camera = Camera(160, 120, 150.0, 150.0, 82.0, 58.5)
    pose = look_at(np.array([0.4, -0.3, 0.5]), np.array([0.0, 0.0, 0.0]))
    return camera, pose, render_frame(world, camera, pose, rng=np.random.default_rng(0))


def test_depth_of_the_table_is_that_of_its_plane(frame: tuple[Camera, SE3, FrameMaps]) -> None:
    camera, pose, maps = frame
    points = pose @ unproject_depth(maps.depth, camera)
    on_table = np.abs(points[..., :2]).max(axis=-1) < 0.7
    assert on_table.sum() > 1000
    assert np.abs(points[on_table, 2]).max() < 1e-6


@pytest.mark.parametrize("shape", default_shapes(), ids=lambda s: s.name)
def test_objects_are_centred_and_stand_y_up(shape) -> None:
    low, high = mesh_bounds(shape.mesh)
    assert np.allclose(low, -high, atol=1e-9)
    if shape.symmetry.continuous:
        assert shape.symmetry.continuous[0][0] == (0.0, 1.0, 0.0)
        radius = np.hypot(*shape.mesh.vertices[:, [0, 2]].T)
        assert radius.max() == pytest.approx(high[0], rel=1e-3)


def test_objects_rest_on_the_table_and_keep_apart(recording: Path) -> None:
    truth = read_truth(recording)
    shapes = {s.name: s.mesh for s in default_shapes()}
    placed = {o.name: SE3.from_matrix(o.T_world_obj) for o in truth.objects}
    reach = {}
    for name, pose in placed.items():
        points = pose @ shapes[name].vertices
        assert points[:, 2].min() == pytest.approx(0, abs=1e-9)
        reach[name] = np.linalg.norm(points[:, :2] - pose.t[:2], axis=1).max()
    for a, b in combinations(placed, 2):
        assert np.linalg.norm(placed[a].t[:2] - placed[b].t[:2]) > reach[a] + reach[b]


def test_sensor_depth_is_biased_noisy_and_blind_on_glass() -> None:
    exact = np.full((120, 160), 0.6)
    behind = np.full_like(exact, 0.8)
    material = np.ones(exact.shape, dtype=int)
    material[:, 120:] = 2
    depth = sensor_depth(exact, behind, material, fx=600, bias=1.02, rng=np.random.default_rng(0))
    diffuse, glass = depth[:, 60:118], depth[:, 122:]
    assert np.median(diffuse[diffuse > 0]) == pytest.approx(0.6 * 1.02, rel=1e-3)
    assert 0.0003 < diffuse[diffuse > 0].std() < 0.002
    assert (diffuse > 0).mean() > 0.95
    assert (glass > 0).mean() < 0.35
    assert glass[glass > 0].min() > 0.75, "what a sensor sees through glass is the background"


def test_the_left_border_has_no_partner_in_the_right_image() -> None:
    exact = np.full((20, 160), 0.5)
    depth = sensor_depth(
        exact, exact, np.ones(exact.shape, int), fx=300, bias=1, rng=np.random.default_rng(0)
    )
    disparity = 300 * 0.055 / 0.5
    assert not depth[:, : int(disparity)].any()
    assert (depth[:, int(disparity) + 2 :] > 0).mean() > 0.95


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(recording: Path, tmp_path: Path) -> None:
    make_recording(tmp_path / "again", SMALL, jobs=SERIAL)
    files = sorted(p.relative_to(recording) for p in recording.rglob("*") if p.is_file())
    assert len(files) == 3 * 2 + 6 + 2
    for name in files:
        assert (recording / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


def test_labels_that_are_the_truth_have_no_error(recording: Path, tmp_path: Path) -> None:
    scene_from_truth(recording, tmp_path / "scene")
    errors = label_errors(Scene.open(tmp_path / "scene"), recording)
    assert errors.percentile_mm(100) < 1e-6
    assert set(errors.mssd_m) == {s.name for s in default_shapes()}


def test_annotation_noise_has_the_asked_size(recording: Path) -> None:
    truth = read_truth(recording)
    extents = dict.fromkeys((o.name for o in truth.objects), 0.1)
    T_cam_world = truth.camera_pose(0).inverse()
    pixels, degrees = [], []
    for seed in range(60):
        labels = annotate_first_frame(truth, extents_m=extents, seed=seed)
        for item in truth.objects:
            exact = T_cam_world @ truth.object_pose(item.name)
            camera = truth.camera.camera()
            pixels.append(camera.project(labels[item.name].t) - camera.project(exact.t))
            turn = labels[item.name].R @ exact.R.T
            degrees.append(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))
    assert np.std(pixels) == pytest.approx(1.0, rel=0.15)
    assert np.sqrt(np.mean(np.square(degrees))) == pytest.approx(1.0, rel=0.15)


def test_annotations_lie_beside_the_recording(recording: Path) -> None:
    truth = read_truth(recording)
    paths = write_annotations(truth, recording)
    assert set(paths) == {item.name for item in truth.objects}
    for item in truth.objects:
        assert paths[item.name] == recording / "annotation" / f"{item.name}.txt"
        exact = truth.camera_pose(0).inverse() @ SE3.from_matrix(item.T_world_obj)
        off = read_pose(paths[item.name]).inverse() @ exact
        assert 0 < np.linalg.norm(off.t) < 0.1
