"""Hand-eye calibrations of common tools."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.poses.hand_eye import read_transform

TRUE = SE3(Rotation.from_euler("xyz", [0.1, -0.2, 1.5]).as_matrix(), np.array([0.01, 0.02, 0.05]))
W, X, Y, Z = (float(v) for v in TRUE.quat())
T = {"x": 0.01, "y": 0.02, "z": 0.05}
Q = {"x": X, "y": Y, "z": Z, "w": W}
QXYZW = f"  qx: {X}\n  qy: {Y}\n  qz: {Z}\n  qw: {W}\n"
EASY = "transformation:\n  x: 0.01\n  y: 0.02\n  z: 0.05\n" + QXYZW
MOVE = [0.01, 0.02, 0.05]
M = TRUE.matrix()


def opencv(name: str, values: np.ndarray) -> str:
    rows, columns = values.shape
    return (
        f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
        f"   data: {values.ravel().tolist()}\n"
    )


FILES = {
    "easy.yaml": EASY,
    "easy_full.yaml": "parameters:\n  eye_on_hand: true\n  robot_base_frame: base\n" + EASY,
    "bom.yaml": "\ufeff" + EASY,
    "moveit.json": json.dumps({"pose": {"position": T, "orientation": Q}}),
    "echo.yaml": json.dumps({"header": {}, "transform": {"translation": T, "rotation": Q}}),
    "named.json": json.dumps({"quaternion_wxyz": [W, X, Y, Z], "translation_m": MOVE}),
    "xyzw.json": json.dumps({"quaternion_xyzw": [X, Y, Z, W], "translation": MOVE}),
    "opencv.yml": "%YAML:1.0\n---\n" + opencv("R_cam2gripper", M[:3, :3])
    + opencv("t_cam2gripper", M[:3, 3:]),
    "matrix.yaml": f"T_flange_cam: {M.tolist()}\n",
    "matrix.json": json.dumps({"hand_eye": M.tolist()}),
    "bare.json": json.dumps(M.tolist()),
    "opencv_4x4.yml": "%YAML:1.0\n" + opencv("HandEye", M),
    "text.txt": "\n".join(" ".join(map(repr, row)) for row in M.tolist()),
    "inverse.json": json.dumps({"T_cam_gripper": TRUE.inverse().matrix().tolist()}),
    "easy2.yaml": "parameters:\n  calibration_type: eye_in_hand\n" + EASY,
    "echo_camera.yaml": json.dumps({
        "header": {"frame_id": "camera_color_optical_frame"}, "child_frame_id": "tool0",
        "transform": {"translation": dict(zip("xyz", TRUE.inverse().t.tolist(), strict=True)),
                      "rotation": {**{c: -Q[c] for c in "xyz"}, "w": W}}}),
    "gripper2cam.yml": "%YAML:1.0\n" + opencv("R_gripper2cam", TRUE.inverse().R)
    + opencv("t_gripper2cam", TRUE.inverse().t[:, None]),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_read(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(FILES[name], encoding="utf-8")
    found = read_transform(tmp_path / name, unit_in_m=1.0)
    assert np.allclose(found.matrix(), M, atol=1e-9)
    assert np.allclose(read_transform(tmp_path / name, unit_in_m=0.001).t, TRUE.t / 1000)


REFUSED = {
    "order.json": (json.dumps({"rotation": [X, Y, Z, W], "translation": [1, 2, 3]}), "order"),
    "seven.txt": ("0.01 0.02 0.05 0 0 0 1\n", "seven numbers.*order"),
    "base.yaml": ("parameters:\n  eye_on_hand: false\n" + EASY, "eye_on_hand"),
    "base2.yaml": ("parameters:\n  calibration_type: eye_on_base\n" + EASY, "calibration_type"),
    "base_frame.yaml": (
        "header:\n  frame_id: base_link\nchild_frame_id: camera\n" + EASY,
        "frame_id",
    ),
    "base.json": (json.dumps({"base_T_cam": M.tolist()}), "base_T_cam.*does not move"),
    "cam2base.json": (json.dumps({"cam2base": M.tolist()}), "cam2base.*does not move"),
    "mm.json": (
        json.dumps({"T": (M + 50 * np.eye(4, 4, 3)).tolist()}),
        "50.* m.*--hand-eye-unit mm",
    ),
    "other.yaml": ("a: 1\nb: 2\n", "not a hand-eye calibration.*easy_handeye"),
    "two.json": (json.dumps({"a": M.tolist(), "b": np.eye(4).tolist()}), "several transforms"),
    "words.txt": ("take the usual one\n", "not a hand-eye calibration.*easy_handeye"),
    "scaled.json": (json.dumps({"X": (2 * M).tolist()}), "not a rotation|last row"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str, tmp_path: Path) -> None:
    text, words = REFUSED[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(ToolkitError, match=words) as error:
        read_transform(tmp_path / name, unit_in_m=1.0)
    assert name in str(error.value) and "\n" not in str(error.value)
