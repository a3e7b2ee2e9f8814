"""The render step: files, resume, staleness, faults, engines, occlusion policies."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import trimesh

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import write_document
from std_toolkit.io.images import write_depth_png16
from std_toolkit.jobs import JobOptions
from std_toolkit.options import RenderOptions
from std_toolkit.rendering.choose import get_renderer
from std_toolkit.rendering.frame import hidden_by_depth
from std_toolkit.rendering.ground_truth import (
    info_path,
    map_paths,
    read_ground_truth,
    rendered_frames,
)
from std_toolkit.rendering.maps import object_silhouette
from std_toolkit.rendering.placements import current_truths, frame_placements, truth_is_current
from std_toolkit.rendering.render_step import render_ground_truth
from std_toolkit.scene.model import Frames, Labels
from std_toolkit.scene.scene import Scene

SERIAL = JobOptions(engine="serial", progress=False)
MODELS = RenderOptions(renderer="raycast", policy="models")
MakeScene = Callable[..., Scene]


def digests(root: Path) -> dict[str, str]:
    return {
        p.relative_to(root).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted((root / "gt").rglob("*"))
        if p.is_file()
    }


def test_maps_and_numbers_belong_together(make_scene: MakeScene) -> None:
    scene = make_scene()
    report = render_ground_truth(scene, MODELS, jobs=SERIAL)
    assert report.results == {"0": "done", "1": "done", "2": "done"}
    assert rendered_frames(scene) == [0, 1, 2]
    for frame in scene.frames:
        truth = read_ground_truth(scene, frame.id)
        camera = scene.camera(frame)
        assert truth.info.policy == "models"
        assert truth.info.delta_m is None
        assert truth.depth.dtype == np.float32
        assert np.array_equal(truth.depth > 0, truth.mask > 0)
        assert np.array_equal(truth.normals.any(axis=2), truth.mask > 0)
        assert set(np.unique(truth.mask)) <= {0, 1, 7}
        for row in truth.info.objects:
            seen = truth.mask == row.object
            assert row.px_visible == np.count_nonzero(seen)
            assert row.px_all >= row.px_valid >= row.px_visible
            assert row.visible_fraction == pytest.approx(row.px_visible / row.px_all)
            v, u = np.nonzero(seen)
            assert row.bbox_visible == [u.min(), v.min(), u.max(), v.max()]
            # NOCS, depth and pose tell the same point.
            mesh = scene.mesh(scene.objects.object(row.object).model)
            local = (truth.nocs[seen].astype(float) - 0.5) * np.linalg.norm(mesh.extents)
            points = row.pose @ (local + mesh.bounds.mean(axis=0))
            expected = camera.rays()[seen] * truth.depth[seen][:, None]
            assert np.abs(points - expected).max() < 2e-5


def test_finished_frames_are_kept_and_stale_ones_redone(make_scene: MakeScene) -> None:
    scene = make_scene()
    render_ground_truth(scene, MODELS, jobs=SERIAL)
    before = digests(scene.root)
    again = render_ground_truth(scene, MODELS, jobs=SERIAL)
    assert set(again.results.values()) == {"kept"}

    map_paths(scene.root, 1)["nocs"].unlink()  # lost
    map_paths(scene.root, 2)["mask"].write_bytes(b"rot")  # damaged
    again = render_ground_truth(scene, MODELS, jobs=SERIAL)
    assert again.results == {"0": "kept", "1": "done", "2": "done"}
    assert digests(scene.root) == before

    label = scene.labels.labels[0]
    moved = SE3.from_matrix(label.T_world_obj) @ SE3(np.eye(3), np.array([0, 0, 0.01]))
    scene.save_labels(
        scene.labels.with_label(
            msgspec.structs.replace(label, T_world_obj=moved.matrix().ravel().tolist())
        )
    )
    again = render_ground_truth(scene, MODELS, jobs=SERIAL)
    assert set(again.results.values()) == {"done"}
    assert digests(scene.root) != before
    flat = replace(MODELS, smooth_normals=False)
    assert set(render_ground_truth(scene, flat, jobs=SERIAL).results.values()) == {"done"}


def test_ground_truth_of_frames_without_labels_is_removed(make_scene: MakeScene) -> None:
    scene = make_scene()
    render_ground_truth(scene, MODELS, jobs=SERIAL)
    poses = scene.poses
    assert poses is not None
    lost = [
        msgspec.structs.replace(p, status="unregistered", T_world_cam=None) if p.frame == 2 else p
        for p in poses.frames
    ]
    scene.save_poses(msgspec.structs.replace(poses, frames=lost))
    render_ground_truth(scene, MODELS, jobs=SERIAL)
    assert rendered_frames(scene) == [0, 1]
    assert not any(p.exists() for p in map_paths(scene.root, 2).values())
    with pytest.raises(ToolkitError, match="no ground truth"):
        read_ground_truth(scene, 2)


def test_the_annotated_frame_alone_is_enough(make_scene: MakeScene) -> None:
    """A label that was not propagated, in a scene without camera poses."""
    scene = make_scene()
    (scene.root / "poses.json").unlink()
    scene = Scene.open(scene.root)
    labels = [msgspec.structs.replace(x, T_world_obj=None) for x in scene.labels.labels]
    scene.save_labels(Labels(labels=labels))
    report = render_ground_truth(scene, replace(MODELS, policy="auto"), jobs=SERIAL)
    assert list(report.results) == ["0"]
    assert read_ground_truth(scene, 0).info.policy == "sensor"


def test_a_pose_annotated_in_another_view_is_used_there(make_scene: MakeScene) -> None:
    """Without camera poses a label has the poses of the frames in which it was annotated."""
    scene = make_scene()
    (scene.root / "poses.json").unlink()
    scene = Scene.open(scene.root)
    first, *others = scene.labels.labels
    moved = SE3.exp([0.01, 0, 0, 0, 0, 0.1]) @ SE3.from_matrix(first.T_cam_obj)
    seen_twice = msgspec.structs.replace(first, T_world_obj=None, views={"2": moved.flat()})
    others = [msgspec.structs.replace(x, T_world_obj=None) for x in others]
    scene.save_labels(Labels(labels=[seen_twice, *others]))
    assert list(frame_placements(scene, 2)) == [first.object]
    assert np.allclose(frame_placements(scene, 2)[first.object].matrix(), moved.matrix())
    assert frame_placements(scene, 1) == {}


def test_pixels_with_sensor_depth_are_counted(make_scene: MakeScene) -> None:
    scene = make_scene(frames=1)
    frame = scene.frames[0]
    depth = scene.read_depth(frame)
    assert depth is not None
    depth[::2] = 0
    scale = scene.info.depth_scale
    assert scale is not None
    write_depth_png16(scene.root / str(frame.depth), depth, scale=scale)
    scene = Scene.open(scene.root)
    render_ground_truth(scene, MODELS, jobs=SERIAL)
    truth = read_ground_truth(scene, 0)
    mesh = {row.id: scene.mesh(row.model) for row in scene.objects.objects}
    for row in truth.info.objects:
        T = SE3.from_matrix(row.T_cam_obj)
        whole = object_silhouette(
            get_renderer(truth.info.renderer), scene.camera(frame), mesh[row.object], T
        ).image_mask(scene.camera(frame))
        assert 0 < row.px_valid == np.count_nonzero(whole & (depth > 0)) < row.px_all


def test_a_bad_frame_is_listed_and_ends_nothing(make_scene: MakeScene) -> None:
    scene = make_scene()
    render_ground_truth(scene, MODELS, jobs=SERIAL)
    depth = scene.root / str(scene.frame(1).depth)
    depth.write_bytes(depth.read_bytes()[:200])
    report = render_ground_truth(scene, MODELS, jobs=SERIAL)
    assert sorted(report.results) == ["0", "2"]
    assert "000001.png" in report.failed["1"]
    assert not info_path(scene.root, 1).exists()  # stale ground truth is none
    command = ["render", str(scene.root), "--renderer", "raycast", "--engine", "serial"]
    assert main([*command, "--policy", "models"]) == 1


@pytest.mark.slow
def test_engines_and_runs_give_the_same_bytes(make_scene: MakeScene) -> None:
    scene = make_scene(frames=9, board=True)
    options = RenderOptions(renderer="raycast", policy="fused", force=True)
    render_ground_truth(scene, options, jobs=SERIAL)
    before = digests(scene.root)
    assert "gt/occluders.ply" in before
    (scene.root / ".std" / "records" / "render-occluders.json").unlink()
    render_ground_truth(scene, options, jobs=JobOptions(workers=2, progress=False))
    assert digests(scene.root) == before


def test_nothing_labelled_is_one_clear_error(make_scene: MakeScene) -> None:
    scene = make_scene()
    scene.save_labels(Labels())
    with pytest.raises(ToolkitError, match="no frame has a labelled object"):
        render_ground_truth(scene, MODELS, jobs=SERIAL)
    with pytest.raises(ToolkitError, match="policy"):
        RenderOptions(policy="guess")  # type: ignore[arg-type]
    with pytest.raises(ToolkitError, match="delta_m"):
        RenderOptions(delta_m=15.0)


def test_policies_need_their_data(make_scene: MakeScene) -> None:
    scene = make_scene(depth=False)
    for policy in ("sensor", "fused"):
        with pytest.raises(ToolkitError, match="use --policy models"):
            render_ground_truth(scene, replace(MODELS, policy=policy), jobs=SERIAL)
    render_ground_truth(scene, replace(MODELS, policy="auto"), jobs=SERIAL)
    truth = read_ground_truth(scene, 0)
    assert truth.info.policy == "models"
    assert all(row.px_valid == row.px_all for row in truth.info.objects)


@pytest.mark.slow
@pytest.mark.parametrize("material", ["diffuse", "transparent"])
def test_what_nobody_labelled_hides(make_scene: MakeScene, material: str) -> None:
    """A board stands in front of the ball in the middle frames."""
    scene = make_scene(frames=13, board=True, material=material)
    fraction = {}
    for policy in ("models", "sensor", "fused"):
        render_ground_truth(scene, replace(MODELS, policy=policy), jobs=SERIAL)
        truth = read_ground_truth(scene, 6)
        assert truth.info.policy == policy
        fraction[policy] = truth.info.of(1).visible_fraction
        others = [read_ground_truth(scene, i).info.of(7).visible_fraction for i in range(6, 13)]
        assert min(others) == 1.0  # the block, which nothing hides, stays whole
    assert fraction["models"] == 1.0
    assert 0.4 < fraction["sensor"] < 0.8
    assert fraction["fused"] == pytest.approx(fraction["sensor"], abs=0.15)
    render_ground_truth(scene, replace(MODELS, policy="auto"), jobs=SERIAL)
    assert read_ground_truth(scene, 6).info.policy == "fused"


@pytest.mark.slow
def test_invented_sensor_surfaces_hide_no_glass(make_scene: MakeScene) -> None:
    """Readings 40 mm in front of a glass ball: the policy sensor is fooled, fused is not."""
    from std_toolkit.io.images import write_depth_png16

    scene = make_scene(frames=9, material="transparent")
    render_ground_truth(scene, MODELS, jobs=SERIAL)
    for frame in scene.frames:
        depth = scene.read_depth(frame)
        assert depth is not None
        ball = read_ground_truth(scene, frame.id).mask == 1
        depth[ball] -= 0.04
        write_depth_png16(scene.root / str(frame.depth), depth, scale=0.0001)
    render_ground_truth(scene, replace(MODELS, policy="sensor"), jobs=SERIAL)
    assert read_ground_truth(scene, 4).info.of(1).visible_fraction < 0.1
    render_ground_truth(scene, replace(MODELS, policy="fused"), jobs=SERIAL)
    assert read_ground_truth(scene, 4).info.of(1).visible_fraction == 1.0


def test_distances_are_compared_not_z(make_scene: MakeScene) -> None:
    """12 mm of z towards the corner is more than 15 mm of distance only off the axis."""
    camera = make_scene(frames=1).info.cameras["color"].camera()
    wide = replace(camera, fx=100.0, fy=100.0)
    depth = np.full((wide.height, wide.width), 0.7, np.float32)
    hidden = hidden_by_depth(depth, depth - np.float32(0.012), wide, delta_m=0.015)
    assert hidden[0, 0]
    assert not hidden[119, 161]
    assert not hidden_by_depth(depth, 0 * depth, wide, delta_m=0.015).any()


def test_the_command(make_scene: MakeScene, capsys: pytest.CaptureFixture[str]) -> None:
    scene = make_scene()
    command = ["render", str(scene.root), "--renderer", "raycast", "--engine", "serial"]
    assert main([*command, "--policy", "sensor", "--delta-mm", "20"]) == 0
    assert "3 frames rendered, 0 kept, 0 failed" in capsys.readouterr().out
    assert read_ground_truth(scene, 0).info.delta_m == 0.02
    assert main([*command, "--frames", "9"]) == 1
    assert "no such frame" in capsys.readouterr().err


def test_a_frame_without_what_the_policy_needs_says_so(make_scene) -> None:
    scene = make_scene()
    frames = [msgspec.structs.replace(f, depth=None) if f.id == 0 else f for f in scene.frames]
    write_document(scene.root / "frames.json", Frames(frames=frames))
    scene = Scene.open(scene.root)
    render_ground_truth(scene, replace(MODELS, policy="sensor"), jobs=SERIAL).raise_if_failed()
    told = [read_ground_truth(scene, f.id).info for f in scene.frames]
    assert [(t.policy, t.delta_m) for t in told[:2]] == [("models", None), ("sensor", 0.015)]


@pytest.mark.parametrize("change", ["mesh", "camera", "depth correction"])
def test_ground_truth_of_other_inputs_is_not_current(make_scene: MakeScene, change: str) -> None:
    scene = make_scene(frames=1)
    render_ground_truth(scene, MODELS, jobs=SERIAL)
    truth = read_ground_truth(scene, scene.frames[0].id).info
    assert truth_is_current(scene, truth) and current_truths(scene, [truth.frame]) == 1
    if change == "mesh":
        path = scene.mesh_path(scene.objects.model("ball"))
        trimesh.creation.icosphere(subdivisions=2, radius=0.03).export(path)
    elif change == "camera":
        cameras = {
            key: msgspec.structs.replace(camera, fx=camera.fx * 1.01)
            for key, camera in scene.info.cameras.items()
        }
        scene.save_info(msgspec.structs.replace(scene.info, cameras=cameras))
    else:
        scene.save_info(msgspec.structs.replace(scene.info, depth_correction=0.98))
    changed = Scene.open(scene.root)
    assert not truth_is_current(changed, truth) and current_truths(changed, [truth.frame]) == 0


@pytest.mark.parametrize(("shift", "turn"), [(0, 0), (9e-7, 0), (2e-6, 0), (0, 9e-7), (0, 2e-6)])
def test_frames_are_counted_as_each_is_judged(
    make_scene: MakeScene, shift: float, turn: float
) -> None:
    scene = make_scene(frames=3)
    render_ground_truth(scene, MODELS, jobs=SERIAL)
    moved = SE3.exp([shift, 0, 0, 0, turn, 0])
    labels = [
        msgspec.structs.replace(
            label,
            T_world_obj=(SE3.from_matrix(label.T_world_obj) @ moved).matrix().ravel().tolist(),
        )
        for label in scene.labels.labels
    ]
    scene.save_labels(msgspec.structs.replace(scene.labels, labels=labels))
    scene = Scene.open(scene.root)
    frames = [f.id for f in scene.frames]
    each = sum(truth_is_current(scene, read_ground_truth(scene, i).info) for i in frames)
    assert current_truths(scene, frames) == each == (0 if max(shift, turn) > 1e-6 else 3)
    # A label that is not propagated counts in its own frame only.
    alone = [msgspec.structs.replace(label, T_world_obj=None) for label in labels]
    scene.save_labels(msgspec.structs.replace(scene.labels, labels=alone))
    scene = Scene.open(scene.root)
    each = sum(truth_is_current(scene, read_ground_truth(scene, i).info) for i in frames)
    assert current_truths(scene, frames) == each < 3


@pytest.mark.slow
def test_a_map_that_is_missing_is_named(make_scene: MakeScene) -> None:
    scene = make_scene(frames=1)
    render_ground_truth(scene)
    path = map_paths(scene.root, 0)["mask"]
    path.unlink()
    with pytest.raises(ToolkitError, match=rf"{path.name}: map is missing"):
        read_ground_truth(scene, 0)


def test_a_damaged_record_of_a_frame_is_not_finished(make_scene: MakeScene) -> None:
    scene = make_scene(frames=1)
    render_ground_truth(scene)
    assert render_ground_truth(scene).results == {"0": "kept"}
    info_path(scene.root, 0).write_text("{")
    assert render_ground_truth(scene).results == {"0": "done"}
