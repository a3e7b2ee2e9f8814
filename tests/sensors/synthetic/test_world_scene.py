"""Scenes of many kinds: the images show the labelled objects, and a seed gives one scene."""

from pathlib import Path

import numpy as np
import pytest

from sensors.synthetic import read_truth
from sensors.synthetic.camera_frames import render_frame
from sensors.synthetic.kinds import JUDGING, SETTING
from sensors.synthetic.raycast_world import World as RaycastWorld
from sensors.synthetic.world_faults import label_faults
from sensors.synthetic.world_scene import (
    CAMERA_NOISE_M,
    CAMERA_NOISE_RAD,
    LARGEST_SHAPE_ERROR,
    SMALLEST_SHAPE_ERROR,
    World,
    draw_world,
    shake_cameras,
)
from std_toolkit.checks.measure.contours import LabelCaster
from std_toolkit.checks.measure.residuals import render_view
from std_toolkit.geometry import rotation_angle
from std_toolkit.scene import Scene
from std_toolkit.scene.model import pose_from_list

# Has a printed and a bare object of exact shape, glass, steel and clutter.
SEED = 0


def small(seed: int = SEED, **options: object) -> World:
    given = {"frames": 3, "width": 160, "height": 120, "sensor": "clean", "camera_noise": False}
    return draw_world(seed, JUDGING, **(given | options))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("world")


@pytest.fixture(scope="module")
def scene(folder: Path) -> Scene:
    return small().scene(folder)


def test_all_looks_sensors_and_faults_are_drawn() -> None:
    worlds = [draw_world(seed, kinds) for seed in range(25) for kinds in (SETTING, JUDGING)]
    assert {w.sensor for w in worlds} == {"colour", "stereo", "clean"}
    assert {w.camera_noise for w in worlds} == {True, False}
    things = [thing for world in worlds for thing in world.things()]
    assert {t.kind.name for t in things} == {k.name for k in (*SETTING, *JUDGING)}
    assert {t.look for t in things} == {"bare", "printed", "glass", "steel"}
    counts = [len(world.things()) for world in worlds]
    assert min(counts) <= 2 and 7 < max(counts) <= 9
    assert 0 < sum(not t.labelled for t in things) < 0.4 * len(things)


def test_other_shapes_differ_by_one_to_three_percent() -> None:
    things = [t for seed in range(20) for t in draw_world(seed, shape_errors=True).things()]
    others = [t for t in things if not t.is_exact]
    assert 0.3 < len(others) / len(things) < 0.7
    for thing in others:
        off = [abs(s - 1) for s in thing.scale] if thing.bulge == 0 else [abs(thing.bulge)]
        assert SMALLEST_SHAPE_ERROR <= min(off) <= max(off) <= LARGEST_SHAPE_ERROR
        ratio = thing.shape().mesh.extents / thing.mesh.extents
        assert np.abs(ratio - 1).max() <= 1.01 * LARGEST_SHAPE_ERROR
    assert all(t.is_exact for t in draw_world(3, shape_errors=False).things())


def test_the_labels_lie_where_the_recording_shows_the_objects(scene: Scene) -> None:
    placed = small().objects()
    world = RaycastWorld([p.shape for p in placed], [p.pose for p in placed], seed=SEED)
    labelled = [k for k, p in enumerate(placed) if p.labelled]
    assert [o.name for o in scene.objects.objects] == [placed[k].shape.name for k in labelled]
    assert len(labelled) < len(placed), "there is clutter"
    caster = LabelCaster.of_scene(scene)
    frame = scene.frames[0]
    view = render_view(scene, caster, frame)
    pose, camera = scene.T_world_cam(frame.id), scene.camera(frame)
    assert pose is not None
    maps = render_frame(world, camera, pose, rng=np.random.default_rng(0), samples=1)
    # The same picture but for noise.
    off = scene.read_color(frame).astype(float) - maps.color
    assert np.abs(np.median(off)) < 1 and np.percentile(np.abs(off), 90) < 12
    for k, item in zip(labelled, scene.objects.objects, strict=True):
        seen, label = maps.ids == k + 1, view.mask(item.id)
        # Clutter may hide a labelled object.
        label &= (maps.ids == 0) | np.isin(maps.ids - 1, labelled)
        assert seen.sum() > 40
        overlap = (seen & label).sum() / (seen | label).sum()
        assert overlap > (0.9 if placed[k].shape.mesh is placed[k].mesh else 0.8)


def test_the_sensor_measures_the_objects_at_the_labels(scene: Scene) -> None:
    exact = {t.name for t in small().things() if t.is_exact and t.look != "glass"}
    caster = LabelCaster.of_scene(scene)
    off: list[float] = []
    for frame in scene.frames:
        view, depth = render_view(scene, caster, frame), scene.read_depth(frame)
        assert depth is not None
        for item in scene.objects.objects:
            if item.name in exact:
                off += list((depth - view.depth)[view.mask(item.id) & (depth > 0)])
    # At this focal length the sensor's noise is 5 mm.
    assert len(off) > 300
    assert abs(np.median(off)) < 0.001
    assert 0.002 < np.median(np.abs(off)) < 0.005


def test_printed_meshes_have_the_print_and_no_symmetry(scene: Scene) -> None:
    printed = [t.name for t in small().things() if t.labelled and t.look == "printed"]
    assert printed
    for item in scene.objects.objects:
        mesh = scene.mesh(item.model)
        has_texture = mesh.visual.kind == "texture"
        assert has_texture == (item.name in printed)
        if has_texture:
            texture = np.asarray(mesh.visual.material.baseColorTexture.convert("L"))
            assert texture.std() > 20
            assert scene.objects.model_of(item.id).symmetry.symmetry().is_trivial


def test_a_seed_gives_one_scene(scene: Scene, folder: Path, tmp_path: Path) -> None:
    assert small().scene(folder).root == scene.root, "kept"
    again = small().scene(tmp_path).root
    files = sorted(p.relative_to(again) for p in again.rglob("*") if p.is_file())
    assert len([f for f in files if f.suffix == ".png"]) == 6
    for name in files:
        if name.suffix == ".png" or name.name in ("labels.json", "poses.json", "objects.json"):
            assert (again / name).read_bytes() == (scene.root / name).read_bytes(), name
    assert not list(tmp_path.glob(".making*"))
    assert small(SEED + 1).objects()[0].pose.flat() != small().objects()[0].pose.flat()


def test_colour_only_has_no_depth(tmp_path: Path) -> None:
    scene = small(6, sensor="colour", frames=1).scene(tmp_path)
    assert scene.read_depth(scene.frames[0]) is None
    assert not (scene.root / "depth").exists()


def test_camera_noise_has_the_stated_size_and_labels_stay_right(
    scene: Scene, tmp_path: Path
) -> None:
    noisy = small(6, sensor="colour", frames=1, camera_noise=True).scene(tmp_path)
    truth = read_truth(noisy.root)
    assert noisy.poses is not None and noisy.poses.frames[0].covariance is not None
    for label in noisy.labels.labels:
        name = noisy.objects.object(label.object).name
        assert np.allclose(label.T_world_obj, truth.object_pose(name).flat())
        T_world_cam = noisy.T_world_cam(label.frame)
        assert T_world_cam is not None
        there = T_world_cam @ pose_from_list(label.T_cam_obj)
        assert np.allclose(there.flat(), label.T_world_obj, atol=1e-9)
    exact, errors = noisy.poses, []
    for seed in range(100):
        noisy.save_poses(exact)
        shake_cameras(noisy, np.random.default_rng(seed))
        was, now = (pose_from_list(p.frames[0].T_world_cam) for p in (exact, noisy.poses))
        off = was.inverse() @ now
        errors.append([np.linalg.norm(off.t), rotation_angle(off.R)])
    assert 0 < np.linalg.norm((truth.camera_pose(0).inverse() @ T_world_cam).t) < 0.004
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert rms == pytest.approx([CAMERA_NOISE_M, CAMERA_NOISE_RAD], rel=0.15)


def test_faults_have_the_stated_size(scene: Scene) -> None:
    names = {t.name: t.kind.name for t in small().things()}
    for item in scene.objects.objects:
        right = scene.T_world_obj(item.id)
        faults = list(label_faults(scene, item.id, seed=3))
        assert {f.level for f in faults} == {0, 1, 2, 3}
        for fault in faults:
            wrong = fault.apply(scene).T_world_obj(item.id)
            assert right is not None and wrong is not None
            if fault.kind in ("sideways", "along", "up"):
                assert np.linalg.norm(wrong.t - right.t) == pytest.approx(abs(fault.size) / 1000)
                assert 0 < fault.mssd_m <= abs(fault.size) / 1000 + 1e-6
            else:
                turned = np.rad2deg(rotation_angle(right.R.T @ wrong.R))
                assert turned == pytest.approx(abs(fault.size), abs=1e-4)
        if names[item.name] == "house" and item.name == "house_3":
            assert "half" not in {f.kind for f in faults}, "a bare house looks the same"
