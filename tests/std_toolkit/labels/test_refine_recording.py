"""Labels on the synthetic recording: clutter, glass, steel, textured table, biased depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sensors.output.recording_writer import Truth, read_truth
from sensors.synthetic.truth import annotate_first_frame, label_errors
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.labels.entry.label import add_model, add_object, set_pose
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.options import PropagateOptions
from std_toolkit.scene import CameraPoses, Frame, FramePose, Frames, Scene, SceneInfo

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording(synthetic_table: Path) -> tuple[Path, Truth]:
    return synthetic_table, read_truth(synthetic_table)


def make_scene(root: Path, recording: tuple[Path, Truth], *, scale: float = 1.0) -> Scene:
    """The recording as a scene with its true camera poses, in a wrong scale if asked."""
    folder, truth = recording
    root.mkdir()
    for part in ("color", "depth"):
        (root / part).symlink_to(folder / part)
    frames = [
        Frame(id=i, name=n, color=f"color/{n}.png", depth=f"depth/{n}.png")
        for i, n in enumerate(truth.frames)
    ]
    info = SceneInfo(
        name="synthetic", cameras={"color": truth.camera}, depth_scale=truth.depth_scale
    )
    scene = Scene.create(root, info, Frames(frames=frames))
    poses = []
    for i in range(len(frames)):
        T = truth.camera_pose(i)
        poses.append(
            FramePose(frame=i, status="registered", T_world_cam=SE3(T.R, scale * T.t).flat())
        )
    scene.save_poses(CameraPoses(frames=poses, source="truth"))
    for item in truth.objects:
        model = add_model(scene, folder / item.mesh, category=item.category, symmetry=item.symmetry)
        add_object(scene, item.name, model=model.id, material=item.material)
    return scene


def annotate(scene: Scene, recording: tuple[Path, Truth], poses: dict[str, SE3]) -> None:
    for item in recording[1].objects:
        set_pose(scene, item.name, 0, poses[item.name])


def first_frame(recording: tuple[Path, Truth], seed: int = 0) -> dict[str, SE3]:
    folder, truth = recording
    extents = {o.name: float(load_mesh(folder / o.mesh).extents.min()) for o in truth.objects}
    return annotate_first_frame(truth, extents_m=extents, seed=seed)


@pytest.mark.long
def test_a_wrong_scale_of_the_camera_poses_is_mended(tmp_path, recording):
    scene = make_scene(tmp_path / "scene", recording, scale=0.985)
    annotate(scene, recording, first_frame(recording, seed=1))
    propagate_labels(scene, PropagateOptions(refine=True, refine_scale=True))
    errors = label_errors(scene, recording[0])
    assert errors.percentile_mm(50) < 2.0, errors.table()
    assert errors.percentile_mm(95) < 3.0, errors.table()
    label = scene.labels.labels[0]
    assert label.refined and label.covariance is not None and "object axis" in label.weak_direction
    assert scene.poses.scale.chosen == "objects"
    factor = scene.T_world_cam(8).t / recording[1].camera_pose(8).t
    assert np.allclose(factor, 1, atol=0.003)


def test_a_rough_annotation_is_enough(tmp_path, recording):
    """Up to 30 mm and 15 degrees off, as a newcomer leaves it before pressing refine."""
    rng = np.random.default_rng(5)
    truth = recording[1]
    rough = {}
    for item in truth.objects:
        exact = truth.camera_pose(0).inverse() @ SE3.from_matrix(item.T_world_obj)
        shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        turn = so3_exp(axis * np.deg2rad(rng.uniform(0, 15)))
        rough[item.name] = SE3(exact.R @ turn, exact.t + shift * rng.uniform(0, 0.03))
    scene = make_scene(tmp_path / "scene", recording)
    annotate(scene, recording, rough)
    propagate_labels(scene, PropagateOptions(refine=True))
    errors = label_errors(scene, recording[0])
    opaque = [o.name for o in truth.objects if o.material == "diffuse"]
    clear = [o.name for o in truth.objects if o.material != "diffuse"]
    for names, limit_mm, limit_deg in ((opaque, 1.5, 0.7), (clear, 2.5, 1.0)):
        shift = np.median(np.concatenate([errors.mssd_m[n] for n in names]))
        turn = np.median(np.concatenate([errors.rotation_rad[n] for n in names]))
        assert 1000 * shift < limit_mm, errors.table()
        assert np.rad2deg(turn) < limit_deg, errors.table()
