from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.entry.posefile import read_pose

POSE = SE3.exp(np.array([0.05, -0.02, 0.7, 0.4, -0.8, 1.1]))
M = POSE.matrix()
WXYZ = POSE.quat()
MM = (1000 * POSE.t).tolist()
BOP_ROW = {"obj_id": 3, "cam_R_m2c": POSE.R.ravel().tolist(), "cam_t_m2c": MM}
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def same(pose: SE3) -> bool:
    return bool(np.allclose(pose.matrix(), M, atol=1e-6))


@pytest.mark.parametrize(
    ("name", "content", "arguments"),
    [
        ("a.txt", "\n".join(" ".join(f"{x:.9f}" for x in row) for row in M), {}),
        ("a.csv", ",".join(f"{x:.9f}" for x in M.ravel()), {}),
        ("a.json", M.tolist(), {}),
        ("a.json", M[:3].ravel().tolist(), {}),
        ("a.json", {"T_cam_obj": M.ravel().tolist()}, {}),
        ("bom.json", "\ufeff" + json.dumps(M.tolist()), {}),
        ("a.json", {"pose": (M * [1, 1, 1, 1000])[:3].tolist()}, {"unit": "mm"}),
        ("a.json", (FLIP @ M).tolist(), {"convention": "opengl"}),
        ("a.json", {"quaternion_wxyz": WXYZ.tolist(), "translation_m": POSE.t.tolist()}, {}),
        ("a.json", {"quaternion_xyzw": np.roll(WXYZ, -1).tolist(), "translation_mm": MM}, {}),
        ("scene_gt.json", {"0": [{**BOP_ROW, "obj_id": 1}], "7": [BOP_ROW]}, {"frame": "000007"}),
        ("scene_gt.json", {"7": [BOP_ROW, {**BOP_ROW, "obj_id": 4}]}, {"item": "3"}),
        ("scene_gt.json", {"7": [{**BOP_ROW, "obj_id": 3}, BOP_ROW]}, {"item": "#1"}),
        (
            "poses.json",
            {
                "000001.jpg": [
                    {"obj": "mug.obj", "id": "x", "R": BOP_ROW["cam_R_m2c"], "t": POSE.t.tolist()}
                ]
            },
            {"frame": "000001", "item": "mug"},
        ),
        (
            "0000000001_poses.yaml",
            "mug:\n  label: 2\n  num_pixels: 9\n  pose: " + str([POSE.t.tolist(), WXYZ.tolist()]),
            {"item": "mug"},
        ),
    ],
)
def test_every_format(tmp_path, name, content, arguments):
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    assert same(read_pose(path, **arguments))


def test_npy_without_pickle(tmp_path):
    np.save(tmp_path / "a.npy", M)
    assert same(read_pose(tmp_path / "a.npy"))
    (tmp_path / "b.npy").write_bytes(pickle.dumps(M))
    with pytest.raises(ToolkitError, match="not a numpy array"):
        read_pose(tmp_path / "b.npy")
    np.save(tmp_path / "c.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ToolkitError, match="not a numpy array"):
        read_pose(tmp_path / "c.npy")


@pytest.mark.parametrize(
    ("name", "content", "arguments", "message"),
    [
        ("a.json", (M * [1, 1, 1, 1000])[:3].tolist(), {}, "millimetres"),
        ("a.json", (FLIP @ M).tolist(), {}, "behind the camera"),
        ("a.json", np.linalg.inv(M).tolist(), {}, "behind the camera|implausible"),
        ("a.json", (M * [[2], [2], [2], [1]]).tolist(), {}, "not a rotation"),
        ("a.json", {"quaternion": [1, 0, 0, 0], "t": [0, 0, 1]}, {}, "must be given"),
        ("a.json", {"quaternion_wxyz": [1, 0, 0, 0, 0], "translation_m": [0, 0, 1]}, {}, "4 . 3"),
        ("a.json", {"0": [BOP_ROW], "1": [BOP_ROW]}, {}, "several images"),
        ("a.json", {"0": [BOP_ROW, BOP_ROW]}, {"item": "3"}, "several such objects"),
        ("a.json", {"0": [BOP_ROW]}, {"item": "5"}, "no such object"),
        ("a.json", {"0": [BOP_ROW]}, {"unit": "m"}, "this format uses mm"),
        ("a.json", {"0": [{**BOP_ROW, "cam_t_m2c": "x"}]}, {}, "9 . 3 numbers"),
        ("a.json", {"hello": 1}, {}, "known form"),
        ("a.json", [[1, 2], [3]], {}, "not a matrix"),
        ("a.txt", "1 2 three", {}, "12 or 16 numbers"),
        ("a.txt", "nan " * 16, {}, "finite"),
        ("a.txt", "", {}, "4x4"),
        ("a.txt", "1 0 0 0 0 0 1", {}, "quaternion_wxyz"),
        ("a.json", M.T.tolist(), {}, "transposed"),
        ("a.json", "{", {}, "not valid JSON"),
        ("a.pkl", "x", {}, "are not read"),
        ("a.yaml", "mug: [", {}, "not valid YAML"),
        ("a.yaml", "mug: {pose: 3}", {}, r"\[\[x, y, z\]"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, name, content, arguments, message):
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(ToolkitError, match=message) as error:
        read_pose(path, **arguments)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
