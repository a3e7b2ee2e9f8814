"""Poses of images that a tracker lost, and poses that count from another number than the images."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.poses.camera_file import read_cameras
from std_toolkit.poses.frame_matching import match_frames
from std_toolkit.scene import Frame

LOST: dict[str, object] = {
    "nan": np.full((4, 4), np.nan),
    "inf": np.full((4, 4), -np.inf),
    "zeros": np.zeros((4, 4)),
    "zeros with a last row": np.diag([0.0, 0, 0, 1]),
}


def frames(count: int, first: int = 0) -> list[Frame]:
    return [
        Frame(id=i, name=f"{i + first:06d}", color=f"color/{i + first:06d}.png", camera="color")
        for i in range(count)
    ]


def poses(lost: object) -> list[object]:
    found: list[object] = []
    for i in range(4):
        T = np.eye(4)
        T[0, 3] = 0.02 * i
        found.append(T)
    found[2] = lost
    return found


def check(path: Path) -> None:
    """Frames 0, 1 and 3 have their own poses, frame 2 has none."""
    filed = read_cameras(path)
    row = match_frames(filed, frames(4))
    assert sorted(row) == [0, 1, 3]
    assert [filed.matrices[row[i]][0, 3] for i in (0, 1, 3)] == pytest.approx([0, 0.02, 0.06])


@pytest.mark.parametrize("kind", LOST)
@pytest.mark.parametrize("layout", ["folder", "npy", "rows", "named rows", "list", "transforms"])
def test_lost_frames_have_no_pose(kind: str, layout: str, tmp_path: Path) -> None:
    matrices = poses(LOST[kind])
    path = tmp_path / "poses"
    if layout == "folder":
        path.mkdir()
        for i, T in enumerate(matrices):
            np.savetxt(path / f"{i:06d}.txt", T)
    elif layout == "npy":
        path = tmp_path / "poses.npy"
        np.save(path, np.array(matrices))
    elif layout in ("rows", "named rows"):
        names = [f"{i:06d}.png " if "named" in layout else "" for i in range(4)]
        lines = [n + " ".join(map(str, np.ravel(T))) for n, T in zip(names, matrices, strict=True)]
        path.write_text("\n".join(lines))
    elif layout == "list":
        path = tmp_path / "poses.json"
        path.write_text(json.dumps([np.asarray(T).tolist() for T in matrices]))
    else:
        rows = [
            {"file_path": f"{i:06d}.png", "transform_matrix": np.asarray(T).tolist()}
            for i, T in enumerate(matrices)
        ]
        path = tmp_path / "transforms.json"
        path.write_text(json.dumps({"frames": rows}))
    check(path)


@pytest.mark.parametrize("blank", [None, [], [[None] * 4] * 4, [["nan"] * 4] * 4])
def test_null_in_json(blank: object, tmp_path: Path) -> None:
    rows = [x.tolist() if isinstance(x, np.ndarray) else x for x in poses(blank)]
    (tmp_path / "a.json").write_text(json.dumps(rows))
    check(tmp_path / "a.json")
    named = {f"{i:06d}": {"pose": row} for i, row in enumerate(rows)}
    (tmp_path / "b.json").write_text(json.dumps(named))
    check(tmp_path / "b.json")


def test_blank_files_and_rows(tmp_path: Path) -> None:
    for i, T in enumerate(poses(None)):
        path = tmp_path / f"pose/{i:06d}.txt"
        path.parent.mkdir(exist_ok=True)
        path.write_text("" if T is None else "\n".join(" ".join(map(str, r)) for r in np.array(T)))
    check(tmp_path / "pose")
    table = "name,tx,ty,tz,qx,qy,qz,qw\n" + "".join(
        f"{i:06d},{0.02 * i},0,0,0,0,0,{0 if i == 2 else 1}\n" for i in range(4)
    )
    (tmp_path / "a.csv").write_text(table)
    check(tmp_path / "a.csv")


@pytest.mark.parametrize("row", ["nan nan nan nan nan nan nan", "0 0 0 0 0 0 0", "0 0 0 0 0 0 inf"])
def test_lost_frames_of_tum(row: str, tmp_path: Path) -> None:
    lines = [f"{i:06d}.png {0.02 * i} 0 0 0 0 0 1" for i in range(4)]
    lines[2] = f"000002.png {row}"
    (tmp_path / "a.txt").write_text("\n".join(lines))
    check(tmp_path / "a.txt")


def test_a_file_of_lost_frames_alone_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((3, 4, 4), np.nan))
    with pytest.raises(ToolkitError, match="all are not finite or zero"):
        read_cameras(tmp_path / "a.npy")


def numbered(folder: Path, first: int, count: int = 5, name: str = "frame_{:05d}.png") -> Path:
    rows = []
    for i in range(count):
        T = np.eye(4)
        T[0, 3] = i
        rows.append({"file_path": name.format(i + first), "transform_matrix": T.tolist()})
    path = folder / "transforms.json"
    path.write_text(json.dumps({"frames": rows}))
    return path


@pytest.mark.parametrize("name", ["images/frame_{:05d}.png", "{:06d}", "{}.png"])
def test_poses_that_count_from_one_are_named(name: str, tmp_path: Path) -> None:
    filed = read_cameras(numbered(tmp_path, 1, name=name))
    with pytest.raises(ToolkitError, match=r"last number, 5, has no image.*counted from 1\?"):
        match_frames(filed, frames(5))
    assert match_frames(filed, frames(5), first_number=1) == {i: i for i in range(5)}
    assert match_frames(filed, frames(5), first_number=0) == {i: i - 1 for i in range(1, 5)}


@pytest.mark.parametrize(("first", "count"), [(0, 5), (1, 4), (1, 9)])
def test_other_poses_are_taken_by_their_numbers(first: int, count: int, tmp_path: Path) -> None:
    row = match_frames(read_cameras(numbered(tmp_path, first, count)), frames(5))
    assert all(first + r == frame for frame, r in row.items()) and len(row) >= 4


def test_images_that_count_from_one_too(tmp_path: Path) -> None:
    row = match_frames(read_cameras(numbered(tmp_path, 1)), frames(5, first=1))
    assert row == {i: i for i in range(5)}
