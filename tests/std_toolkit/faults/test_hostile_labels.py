"""Labels that cannot be right are refused, and the scene keeps those it has."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

GOOD = np.eye(4)
GOOD[2, 3] = 0.6


def text(matrix: object) -> bytes:
    return "\n".join(" ".join(map(str, row)) for row in np.asarray(matrix)).encode()


def changed(row: int, column: int, value: object) -> np.ndarray:
    matrix = GOOD.astype(object)
    matrix[row, column] = value
    return matrix


POSES = {
    "empty.txt": b"",
    "words.txt": b"put it on the table",
    "nan.txt": text(changed(0, 3, "nan")),
    "inf.txt": text(changed(2, 3, "inf")),
    "scaled.txt": text(GOOD * [[2], [2], [2], [1]]),
    "mirrored.txt": text(GOOD * [[1], [-1], [1], [1]]),
    "three_rows_short.txt": text(GOOD[:1]),
    "fifteen.txt": text(GOOD).rsplit(b" ", 1)[0],
    "last_row.txt": text(changed(3, 0, 5)),
    "zeros.txt": text(np.zeros((4, 4))),
    "behind.txt": text(changed(2, 3, -0.6)),
    "in_millimetres.txt": text(changed(2, 3, 600.0)),
    "binary.npy": b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (1,)}",
    "pickle.npy": b"\x80\x04\x95\x0b\x00\x00\x00\x00\x00\x00\x00\x8c\x02os\x94.",
    "truncated.json": b'{"T": [[1, 0, 0',
    "deep.json": b"[" * 100_000,
    "nan.json": b"[[1,0,0,NaN],[0,1,0,0],[0,0,1,0.6],[0,0,0,1]]",
    "bad_quaternion.json": json.dumps({"q": [2, 0, 0, 0], "t": [0, 0, 0.6]}).encode(),
}


@pytest.mark.parametrize("name", POSES)
def test_poses_that_are_none_are_refused(
    root: Path, tmp_path: Path, refuse: Any, name: str
) -> None:
    path = tmp_path / name
    path.write_bytes(POSES[name])
    line = refuse("label", root, "--object", "box_1", "--frame", "0", "--pose", path, names="")
    assert name in line or "box_1" in line


@pytest.mark.parametrize("name", ["behind.txt", "in_millimetres.txt", "scaled.txt"])
def test_a_wrong_pose_enters_no_new_object(
    root: Path, tmp_path: Path, refuse: Any, name: str
) -> None:
    """The object would be there without the label that it came for."""
    (tmp_path / name).write_bytes(POSES[name])
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "mug.ply")
    refuse(
        *("label", root, "--object", "mug", "--mesh", tmp_path / "mug.ply"),
        *("--material", "diffuse", "--frame", "0", "--pose", tmp_path / name),
        names="",
    )


def test_a_pipe_in_place_of_a_pose_does_not_block(root: Path, tmp_path: Path, refuse: Any) -> None:
    os.mkfifo(tmp_path / "pipe.txt")
    refuse(
        *("label", root, "--object", "box_1", "--frame", "0", "--pose", tmp_path / "pipe.txt"),
        names="pipe.txt",
    )


@pytest.mark.parametrize("frame", ["7", "-1"])
def test_frames_that_are_not_there_are_refused(
    root: Path, tmp_path: Path, refuse: Any, frame: str
) -> None:
    (tmp_path / "pose.txt").write_bytes(text(GOOD))
    refuse(
        *("label", root, "--object", "box_1", f"--frame={frame}"),
        *("--pose", tmp_path / "pose.txt"),
        names=frame,
    )


def test_an_unknown_object_needs_its_mesh(root: Path, tmp_path: Path, refuse: Any) -> None:
    (tmp_path / "pose.txt").write_bytes(text(GOOD))
    refuse(
        *("label", root, "--object", "mug", "--frame", "0", "--pose", tmp_path / "pose.txt"),
        names="mug",
    )


@pytest.mark.parametrize("name", ["../mug", "/etc/passwd", ".mug", "m ug", "m\nug", ""])
def test_objects_whose_name_is_no_name_are_refused(
    root: Path, tmp_path: Path, refuse: Any, name: str
) -> None:
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "mug.ply")
    (tmp_path / "pose.txt").write_bytes(text(GOOD))
    refuse(
        *("label", root, f"--object={name}", "--mesh", tmp_path / "mug.ply"),
        *("--material", "diffuse", "--frame", "0", "--pose", tmp_path / "pose.txt"),
        names="name",
    )


MESHES = {
    "millimetres.ply": trimesh.creation.box((100, 60, 30)).export(file_type="ply"),
    "too_small.ply": trimesh.creation.box((1e-4, 1e-4, 1e-4)).export(file_type="ply"),
    "empty.ply": b"",
    "text.obj": b"not a mesh",
    "no_faces.obj": b"v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\n",
    "bad_face.obj": b"v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 9\n",
    "nan.obj": b"v nan 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n",
    "picture.png": b"\x89PNG\r\n\x1a\n",
}


@pytest.mark.parametrize("name", MESHES)
def test_meshes_that_cannot_be_right_are_refused(
    root: Path, tmp_path: Path, refuse: Any, name: str
) -> None:
    (tmp_path / name).write_bytes(MESHES[name])
    (tmp_path / "pose.txt").write_bytes(text(GOOD))
    refuse(
        *("label", root, "--object", "mug", "--mesh", tmp_path / name),
        *("--material", "diffuse", "--frame", "0", "--pose", tmp_path / "pose.txt"),
        names=name,
    )


def test_a_mesh_that_reads_files_outside_brings_none_of_them_along(
    root: Path, tmp_path: Path, run: Any
) -> None:
    (tmp_path / "secret.txt").write_text("secret")
    mesh = tmp_path / "in" / "mug.obj"
    mesh.parent.mkdir()
    mesh.write_text(
        "mtllib ../secret.txt\nv 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\n"
    )
    (tmp_path / "pose.txt").write_bytes(text(GOOD))
    outcome = run(
        *("label", root, "--object", "mug", "--mesh", mesh, "--material", "diffuse"),
        *("--frame", "0", "--pose", tmp_path / "pose.txt"),
    )
    assert "a defect of" not in outcome.err
    copied = [p for p in root.rglob("*") if p.is_file() and p.read_bytes() == b"secret"]
    assert not copied
