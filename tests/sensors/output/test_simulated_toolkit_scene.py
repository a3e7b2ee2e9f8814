"""A simulated toolkit scene is exact, current, and passes the toolkit's own check."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from simulated_views import (
    COLOR,
    LABELS,
    followed_frames,
    make_frame,
    make_objects,
    make_scene,
)

from sensors.output.toolkit_scene import (
    metric_objects,
    metric_symmetry,
    read_simulation,
    toolkit_scene,
)
from sensors.viewpoints.camera_path import TrajectoryOptions, smooth_trajectory
from std_toolkit.checks.check_step import run_check
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters import export_scene
from std_toolkit.geometry import SE3, Symmetry, so3_exp
from std_toolkit.io.exr import read_exr_depth
from std_toolkit.jobs import JobOptions
from std_toolkit.options import RenderOptions
from std_toolkit.rendering.ground_truth import read_ground_truth, rendered_frames
from std_toolkit.rendering.placements import truth_is_current
from std_toolkit.rendering.render_step import render_ground_truth
from std_toolkit.scene import Labels, Scene

SERIAL = JobOptions(engine="serial", progress=False)


@pytest.fixture(scope="module")
def simulated():
    """Four frames of an arc, labels at half the colour's size."""
    scene = make_scene(name="arc", frames=4)
    poses = smooth_trajectory(2, TrajectoryOptions(frames=4, sweep_deg=60))
    return scene, [make_frame(scene, i, T) for i, T in enumerate(poses)]


@pytest.fixture(scope="module")
def written(simulated, tmp_path_factory) -> Path:
    scene, frames = simulated
    out = tmp_path_factory.mktemp("simulated") / "arc"
    with toolkit_scene(out, scene) as writer:
        for frame in frames:
            writer.add(frame)
    return out


def test_the_scene_holds_what_was_simulated(simulated, written) -> None:
    source, frames = simulated
    scene = Scene.open(written)
    assert scene.info.source == "simulated:d415"
    assert scene.poses.source == "simulated"
    for frame, row in zip(frames, scene.frames, strict=True):
        assert scene.camera(row) == frame.label_camera
        halved = cv2.resize(frame.color, LABELS, interpolation=cv2.INTER_AREA)
        np.testing.assert_array_equal(scene.read_color(row), halved)
        np.testing.assert_array_equal(scene.read_depth(row), frame.depth_aligned)
        everything = read_exr_depth(written / f"reference/depth/{row.name}.exr")
        np.testing.assert_array_equal(everything, frame.depth_exact)
        for eye in ("left", "right"):
            stored = cv2.imread(f"{written}/infrared/{eye}/{row.name}.png", cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(stored, getattr(frame, f"infrared_{eye}"))
        np.testing.assert_allclose(
            scene.T_world_cam(row.id).matrix(), frame.T_world_cam.matrix(), atol=1e-12
        )
    for item in source.objects:
        thing = scene.objects.object(item.instance_id)
        assert (thing.name, thing.material) == (
            f"{item.category}_{item.instance_id}",
            item.material_class,
        )
        np.testing.assert_allclose(
            scene.T_world_obj(item.instance_id).matrix(), item.T_world_obj.matrix(), atol=1e-12
        )
        mesh = scene.mesh(thing.model)
        np.testing.assert_allclose(mesh.vertices, item.mesh.vertices * item.scale_m, atol=1e-7)
        label = scene.labels.of(item.instance_id)
        assert (label.method, label.frame, label.views) == ("simulated", 0, {})
        exact = frames[0].T_world_cam.inverse() @ item.T_world_obj
        np.testing.assert_allclose(label.T_cam_obj, exact.flat(), atol=1e-12)
    record = read_simulation(written)
    assert (record.seed, record.parameters) == (source.seed, source.parameters)


def test_ground_truth_is_that_of_the_simulation_and_of_a_new_rendering(
    simulated, written, tmp_path
) -> None:
    _, frames = simulated
    scene = Scene.open(written)
    again = Scene.open(shutil.copytree(written, tmp_path / "again"))
    options = RenderOptions(renderer="raycast", policy="models")
    with again.lock():
        report = render_ground_truth(again, options, jobs=SERIAL)
    assert set(report.results.values()) == {"done"}
    assert rendered_frames(scene) == [0, 1, 2, 3]
    for frame in frames:
        truth = read_ground_truth(scene, frame.index)
        assert truth_is_current(scene, truth.info)
        seen = frame.mask > 0
        np.testing.assert_array_equal(truth.mask, frame.mask)
        np.testing.assert_array_equal(truth.depth, np.where(seen, frame.depth_exact, 0))
        assert np.abs(truth.nocs - frame.nocs).max() < 1 / 65535
        assert np.abs(truth.normals - np.where(seen[..., None], frame.normals, 0)).max() < 1e-4
        rendered = read_ground_truth(again, frame.index)
        both = (rendered.mask == truth.mask) & seen
        assert both.sum() > 0.998 * seen.sum()
        assert np.abs(rendered.depth - truth.depth)[both].max() < 1e-4
        assert np.abs(rendered.nocs - truth.nocs)[both].max() < 1e-3
        for ours, theirs in zip(truth.info.objects, rendered.info.objects, strict=True):
            assert ours.object == theirs.object
            for name in ("px_all", "px_valid", "px_visible"):
                assert getattr(ours, name) == pytest.approx(getattr(theirs, name), abs=3)
            assert ours.visible_fraction == pytest.approx(theirs.visible_fraction, abs=0.01)
            np.testing.assert_allclose(ours.bbox_amodal, theirs.bbox_amodal, atol=1)
            np.testing.assert_allclose(ours.bbox_visible, theirs.bbox_visible, atol=1)


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["std", "bop"])
def test_it_can_be_exported(written, tmp_path, layout) -> None:
    sidecar = export_scene(Scene.open(written), layout, tmp_path / layout, jobs=SERIAL)
    assert len(sidecar.frames) == 4
    assert sidecar.left_out == []


@pytest.fixture(scope="module")
def followed(tmp_path_factory) -> Path:
    """Six frames whose pictures show the objects, labels of colour's size."""
    out = tmp_path_factory.mktemp("followed") / "arc"
    scene = make_scene(name="arc", frames=6, seed=3)
    with toolkit_scene(out, scene) as writer:
        for frame in followed_frames(scene):
            writer.add(frame)
    return out


@pytest.mark.slow
def test_the_check_passes(followed) -> None:
    scene = Scene.open(followed)
    assert scene.camera(scene.frames[0]) == COLOR
    report = run_check(scene, jobs=SERIAL)
    assert report.passed, report.verdict
    values = {g.key: g.value for g in report.gates if g.status == "pass"}
    assert {"registered", "labelled", "edges", "depth"} <= set(values)
    assert report.summary.truth_frames == 6
    opaque = [o for o in report.objects if o.material != "transparent"]
    assert len(opaque) == 5
    assert max(o.value("edge_px") for o in opaque) < 0.6
    assert values["shift"] < 0.5
    # The sensor of the test reads 1 % too far; the bias is that of labels minus sensor.
    assert report.summary.depth_bias == pytest.approx(-0.01, abs=0.002)


@pytest.mark.slow
def test_the_check_would_see_a_wrong_pose(followed, tmp_path) -> None:
    scene = Scene.open(shutil.copytree(followed, tmp_path / "wrong"))
    shift = SE3(np.eye(3), np.array([0.012, 0.0, 0.0]))
    moved = [
        type(x)(
            object=x.object,
            frame=0,
            T_cam_obj=x.T_cam_obj,
            T_world_obj=(shift @ SE3.from_matrix(x.T_world_obj)).flat(),
        )
        for x in scene.labels.labels
    ]
    scene.save_labels(Labels(labels=moved))
    assert not run_check(scene, jobs=SERIAL).passed


def test_a_scene_appears_whole_or_not_at_all(simulated, written, tmp_path) -> None:
    scene, frames = simulated
    out = tmp_path / "new" / "scene"
    with pytest.raises(ToolkitError, match="3 of 4 frames"), toolkit_scene(out, scene) as writer:
        writer.add(frames[0])
        assert not out.exists()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ToolkitError, match="already"), toolkit_scene(written, scene):
        pass


def test_the_same_frames_give_the_same_bytes(simulated, written, tmp_path) -> None:
    scene, frames = simulated
    with toolkit_scene(tmp_path / "arc", scene) as writer:
        for frame in frames[::-1]:
            writer.add(frame)
    files = sorted(p.relative_to(tmp_path / "arc") for p in (tmp_path / "arc").rglob("*.*"))
    assert len(files) > 40
    for name in files:
        if (tmp_path / "arc" / name).is_file():
            assert (tmp_path / "arc" / name).read_bytes() == (written / name).read_bytes(), name


def test_two_sizes_of_one_asset_are_two_models() -> None:
    scene = make_scene()
    small = replace(scene.objects[1], instance_id=2)
    large = replace(small, instance_id=3, scale_m=small.scale_m * 1.2)
    pair = replace(scene, objects=[scene.objects[0], small, large])
    things = metric_objects(pair)
    assert len({t.model.id for t in things}) == 3
    ratio = things[2].model.diameter_m / things[1].model.diameter_m
    assert ratio == pytest.approx(1.2)
    assert things[0].model.id == scene.objects[0].asset_id


def test_symmetries_grow_with_the_object() -> None:
    turn = SE3(so3_exp([0, np.pi, 0]), np.array([0.1, 0, 0.2]))
    unit = Symmetry((tuple(turn.flat()),), (((0.0, 1.0, 0.0), (0.0, 0.0, 0.5)),))
    metric = metric_symmetry(unit, 0.2).symmetry()
    mesh = make_objects()[2].mesh
    for T_unit, T_metric in zip(unit.transforms(8), metric.transforms(8), strict=True):
        np.testing.assert_allclose(
            0.2 * (T_unit @ mesh.vertices), T_metric @ (0.2 * mesh.vertices), atol=1e-12
        )
