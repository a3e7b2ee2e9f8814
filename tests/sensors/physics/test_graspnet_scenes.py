"""Arrangements in the layout of GraspNet-1Billion, written by the test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from dropped import check_settled

from sensors.physics import GraspNetScenes
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, rotation_angle, so3_exp

pytest.importorskip("mujoco", reason="needs the extra [sim]")

IMAGE = 3
# A camera that looks down at the table at an angle.
T_WORLD_CAM0 = SE3(so3_exp([np.pi - 0.5, 0, 0]), np.array([0.0, -0.3, 0.6]))
T_CAM0_CAM = SE3(so3_exp([0.1, 0.2, -0.1]), np.array([0.05, -0.02, 0.03]))
# Two boxes and a ring, their model frames away from their centres.
MODELS = {
    5: trimesh.creation.box((0.08, 0.06, 0.04)),
    17: trimesh.creation.box((0.1, 0.1, 0.02)),
    60: trimesh.creation.annulus(0.03, 0.05, 0.03, sections=24),
}
ORIGIN = np.array([0.01, -0.02, 0.3])
# Model 5 is 3 mm deep in model 17, which hovers by 2 mm.
PLACED = {
    17: SE3(np.eye(3), np.array([0.0, 0.0, 0.012])),
    5: SE3(so3_exp([0, 0, 0.4]), np.array([0.0, 0.0, 0.039])),
    60: SE3(so3_exp([0, 0, 1.0]), np.array([0.15, 0.05, 0.0155])),
}


def write_data_set(root: Path) -> None:
    folder = root / "scenes" / "scene_0042" / "realsense"
    (folder / "annotations").mkdir(parents=True)
    np.save(folder / "cam0_wrt_table.npy", T_WORLD_CAM0.matrix())
    cameras = np.stack([np.eye(4)] * IMAGE + [T_CAM0_CAM.matrix()])
    np.save(folder / "camera_poses.npy", cameras)
    rows = []
    for number, T_world_centre in PLACED.items():
        T_world_model = SE3(T_world_centre.R, T_world_centre @ -ORIGIN)
        T = (T_WORLD_CAM0 @ T_CAM0_CAM).inverse() @ T_world_model
        t, q = (" ".join(f"{x:.4f}" for x in v) for v in (T.t, T.quat()))
        rows.append(
            f"<obj><obj_id>{number}</obj_id><obj_name>{number}.ply</obj_name>"
            f"<obj_path>models/{number}.ply</obj_path><pos_in_world>{t}</pos_in_world>"
            f"<ori_in_world>{q}</ori_in_world></obj>"
        )
    text = '<?xml version="1.0" ?>\n<scene>\n' + "\n".join(rows) + "\n</scene>\n"
    (folder / "annotations" / f"{IMAGE:04d}.xml").write_text(text)
    for number, mesh in MODELS.items():
        model = mesh.copy()
        model.apply_translation(ORIGIN)
        (root / "models" / f"{number:03d}").mkdir(parents=True)
        model.export(root / "models" / f"{number:03d}" / "nontextured.ply")


def test_poses_are_read_into_the_table_frame(tmp_path: Path) -> None:
    write_data_set(tmp_path)
    scenes = GraspNetScenes(tmp_path)
    assert scenes.scenes() == [42]
    placed = scenes.placed(42, image=IMAGE)
    assert [p.model for p in placed] == list(PLACED)
    for p in placed:
        expected = PLACED[p.model]
        # Four decimals in the file, 0.3 m from the model's origin to the object.
        assert np.linalg.norm(p.T_world_model @ ORIGIN - expected.t) < 2e-4
        assert rotation_angle(p.T_world_model.R.T @ expected.R) < 3e-4


@pytest.mark.slow
def test_arrangements_come_to_rest_near_where_they_were(tmp_path: Path) -> None:
    write_data_set(tmp_path)
    objects, poses = GraspNetScenes(tmp_path).arrangement(42, image=IMAGE)
    check_settled(objects, poses)
    for thing, number, pose in zip(objects, PLACED, poses, strict=True):
        assert thing.asset.id == f"graspnet-{number:03d}"
        assert thing.diagonal_m == pytest.approx(np.linalg.norm(MODELS[number].extents), abs=1e-5)
        assert np.linalg.norm(pose.t - PLACED[number].t) < 0.004
        assert np.degrees(rotation_angle(pose.R.T @ PLACED[number].R)) < 1
    # The upper box ends on the lower one: 20 mm, then half of 40 mm.
    assert poses[1].t[2] == pytest.approx(0.04, abs=3e-4)


def test_missing_parts_are_told(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="holds no folder"):
        GraspNetScenes(tmp_path)
    write_data_set(tmp_path)
    with pytest.raises(ToolkitError, match="camera"):
        GraspNetScenes(tmp_path, camera="d415")
    scenes = GraspNetScenes(tmp_path)
    with pytest.raises(ToolkitError, match="No such file"):
        scenes.placed(7)
    with pytest.raises(ToolkitError, match="no camera pose"):
        scenes.placed(42, image=99)
    with pytest.raises(ToolkitError, match="no annotation"):
        scenes.placed(42, image=0)
    with pytest.raises(ToolkitError, match="has none of"):
        scenes.model(88)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</scene>", "", "not an annotation"),
        ("<obj_id>5</obj_id>", "<obj_id>five</obj_id>", r"obj\[1\].obj_id.*1 numbers"),
        ("<obj_id>5</obj_id>", "<obj_id>-5</obj_id>", "not an object number"),
        ("<ori_in_world>", "<ori_in_world>3 ", "4 numbers"),
        ("<pos_in_world>", "<pos_in_world>nan ", "3 numbers"),
        ("obj>", "thing>", "names no object"),
    ],
)
def test_damaged_annotations_are_told(tmp_path: Path, old: str, new: str, message: str) -> None:
    write_data_set(tmp_path)
    (file,) = tmp_path.rglob("*.xml")
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(ToolkitError, match=message) as caught:
        GraspNetScenes(tmp_path).placed(42, image=IMAGE)
    assert file.name in str(caught.value)


def test_damaged_arrays_are_told(tmp_path: Path) -> None:
    write_data_set(tmp_path)
    (file,) = tmp_path.rglob("cam0_wrt_table.npy")
    np.save(file, np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(ToolkitError, match="not a rotation"):
        GraspNetScenes(tmp_path).placed(42, image=IMAGE)
    file.write_bytes(b"nothing")
    with pytest.raises(ToolkitError, match="not a numpy array"):
        GraspNetScenes(tmp_path).placed(42, image=IMAGE)
