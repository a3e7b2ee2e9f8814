"""Long trajectories, and the order of quaternions in rows without a header."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.options import KnownCameras
from std_toolkit.poses.camera_file import read_cameras
from std_toolkit.poses.known_cameras import read_known_poses
from std_toolkit.scene import Frame

ROWS = 20_000
# Reading makes 12 to 30 calls a row; a pose of its own for each row would be 76 more.
MOST_CALLS = 50


def poses(count: int) -> list[SE3]:
    rng = np.random.default_rng(1)
    return [SE3.exp(xi) for xi in rng.normal(size=(count, 6))]


def tum(T: SE3, i: int) -> str:
    w, x, y, z = T.quat()
    return " ".join([f"{1e9 + i / 30:.6f}", *(f"{v:.12g}" for v in (*T.t, x, y, z, w))])


def csv_row(T: SE3, i: int) -> str:
    return ",".join([f"{i:06d}.png", *(f"{v:.12g}" for v in (*T.t, *T.quat()))])


def matrix(T: SE3, i: int) -> str:
    return " ".join(f"{v:.12g}" for v in T.matrix()[:3].ravel())


@pytest.mark.parametrize(
    ("name", "row", "head"),
    [("t.txt", tum, ""), ("t.csv", csv_row, "name,x,y,z,qw,qx,qy,qz\n"), ("m.txt", matrix, "")],
)
def test_long_trajectories_are_read_at_once(name: str, row, head: str, tmp_path: Path) -> None:
    some = poses(200)
    lines = [row(some[i % 200], i) for i in range(ROWS)]
    path = tmp_path / name
    path.write_text(head + "\n".join(lines) + "\n")
    calls = 0

    def count(_frame: object, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        filed = read_cameras(path)
    finally:
        sys.setprofile(before)
    assert ROWS < calls < MOST_CALLS * ROWS
    truth = np.array([T.matrix() for T in some])
    assert filed.matrices.shape == (ROWS, 4, 4)
    assert np.abs(filed.matrices.reshape(-1, 200, 4, 4) - truth).max() < 1e-8
    lines[ROWS - 2] = lines[ROWS - 2].replace("0", "x")
    path.write_text(head + "\n".join(lines) + "\n")
    with pytest.raises(ToolkitError, match=rf"line {ROWS - 1 + bool(head)}: not a number"):
        read_cameras(path)


def test_the_first_wrong_row_is_named(tmp_path: Path) -> None:
    rows = [tum(T, i).split() for i, T in enumerate(poses(6))]
    rows[1][4:] = ["nan"] * 4
    rows[3][4:] = ["1", "1", "1", "1"]
    rows[4][4:] = ["2", "2", "2", "2"]
    (tmp_path / "t.txt").write_text("\n".join(map(" ".join, rows)))
    with pytest.raises(ToolkitError, match=r"line 4: a rotation quaternion .* length 1"):
        read_cameras(tmp_path / "t.txt")
    blocks = [T.matrix() for T in poses(6)]
    blocks[2] = np.zeros((4, 4))
    blocks[4][:3, :3] *= 1.1
    np.savetxt(tmp_path / "m.txt", np.reshape(blocks, (6, 16)))
    with pytest.raises(ToolkitError, match=r"line 5: this is not a rotation matrix"):
        read_cameras(tmp_path / "m.txt")
    turns = [[*T.t, *(400.0 if i == 2 else 0.1 for _ in range(3))] for i, T in enumerate(poses(4))]
    rows = [",".join([f"{i}.png", *map(str, v)]) for i, v in enumerate(turns)]
    (tmp_path / "v.csv").write_text("name,x,y,z,rx,ry,rz\n" + "\n".join(rows))
    with pytest.raises(ToolkitError, match=r"line 4: a rotation vector is in radians"):
        read_cameras(tmp_path / "v.csv")


STAMPS = [1403636579763555584 + 33_333_333 * i for i in range(5)]
FRAMES = [Frame(id=i, name=str(s), color=f"color/{s}.png") for i, s in enumerate(STAMPS)]


def write(path: Path, order: str, *, sep: str, stamp: str = "{}", more: int = 0) -> list[SE3]:
    some = poses(len(STAMPS))
    rows = []
    for s, T in zip(STAMPS, some, strict=True):
        w, x, y, z = T.quat()
        q = (w, x, y, z) if order == "wxyz" else (x, y, z, w)
        cells = [stamp.format(s), *(f"{v:.15g}" for v in (*T.t, *q, *[0.01] * more))]
        rows.append(sep.join(cells))
    path.write_text("\n".join(rows))
    return some


def found(path: Path, frames: list[Frame] = FRAMES, **options: object) -> Array:
    known = read_known_poses(KnownCameras(cameras=path, **options), frames)  # type: ignore[arg-type]
    return np.array([T.matrix() for T in known.poses().values()])


@pytest.mark.parametrize(
    ("order", "sep", "stamp", "more", "says"),
    [
        ("wxyz", ",", "{}", 0, "qw qx qy qz .*as EuRoC"),
        ("wxyz", ", ", "{}", 9, "qw qx qy qz .*as EuRoC"),  # with velocity and biases
        ("wxyz", ",", "{}", 3, "qw qx qy qz .*as EuRoC"),  # of VINS
        ("xyzw", " ", "{}.000000", 0, "qx qy qz qw .*as ORB-SLAM3"),
    ],
)
def test_the_order_of_nanoseconds(
    order: str, sep: str, stamp: str, more: int, says: str, tmp_path: Path, caplog
) -> None:
    path = tmp_path / "t.csv"
    some = write(path, order, sep=sep, stamp=stamp, more=more)
    frames = FRAMES
    if "." in stamp:
        frames = [
            Frame(id=f.id, name=f"{f.name}.000000", color=f"color/{f.name}.000000.png")
            for f in FRAMES
        ]
    with caplog.at_level("INFO", logger="std_toolkit"):
        assert np.abs(found(path, frames) - [T.matrix() for T in some]).max() < 1e-9
    (line,) = [r.getMessage() for r in caplog.records if "quaternions" in r.getMessage()]
    assert str(path) in line
    assert re.search(says, line)


def test_seconds_are_of_tum_and_the_option_is_obeyed(tmp_path: Path, caplog) -> None:
    some = poses(3)
    path = tmp_path / "t.txt"
    path.write_text("\n".join(tum(T, i) for i, T in enumerate(some)))
    frames = [
        Frame(id=i, name=str(i), color=f"color/{i}.png", timestamp=1e9 + i / 30) for i in range(3)
    ]
    with caplog.at_level("INFO", logger="std_toolkit"):
        assert np.abs(found(path, frames) - [T.matrix() for T in some]).max() < 1e-9
    assert "qx qy qz qw (as TUM files them)" in caplog.text
    for order in ("xyzw", "wxyz"):
        some = write(path, order, sep=",")
        got = found(path, cameras_quaternion=order)
        assert np.abs(got - [T.matrix() for T in some]).max() < 1e-9


def test_nanoseconds_find_images_of_the_same_time(tmp_path: Path) -> None:
    some = write(tmp_path / "t.csv", "wxyz", sep=",")
    near = [
        Frame(id=i, name=str(s + 3_000_000), color=f"color/{s + 3_000_000}.png")
        for i, s in enumerate(STAMPS)
    ]
    assert np.abs(found(tmp_path / "t.csv", near) - [T.matrix() for T in some]).max() < 1e-9


def test_an_open_order_asks_for_the_option(tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    some = write(path, "wxyz", sep=" ")
    with pytest.raises(ToolkitError, match="give --cameras-quaternion wxyz or xyzw"):
        found(path)
    got = found(path, cameras_quaternion="wxyz")
    assert np.abs(got - [T.matrix() for T in some]).max() < 1e-9
    # A first pose that is the identity in one of the orders tells it.
    lines = path.read_text().splitlines()
    lines[0] = f"{STAMPS[0]} 0 0 0 1 0 0 0"
    path.write_text("\n".join(lines))
    assert np.abs(found(path)[1:] - [T.matrix() for T in some[1:]]).max() < 1e-9


def test_a_comment_states_the_order_of_nanoseconds(tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    some = write(path, "xyzw", sep=",")
    path.write_text("# timestamp, tx, ty, tz, qx, qy, qz, qw\n" + path.read_text())
    assert np.abs(found(path) - [T.matrix() for T in some]).max() < 1e-9


def test_names_of_nanoseconds_before_matrices_are_no_euroc(tmp_path: Path) -> None:
    some = poses(len(STAMPS))
    rows = [",".join([str(s), *map(repr, T.flat())]) for s, T in zip(STAMPS, some, strict=True)]
    (tmp_path / "t.csv").write_text("\n".join(rows))
    assert np.abs(found(tmp_path / "t.csv") - [T.matrix() for T in some]).max() < 1e-9


def test_the_option_without_effect_is_refused(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "m.txt", np.array([T.flat() for T in poses(5)]))
    with pytest.raises(ToolkitError, match="no quaternions whose order is open"):
        found(tmp_path / "m.txt", cameras_quaternion="wxyz")


def stray(path: Path, *, lens: bool = False, first: int = 0) -> list[SE3]:
    """odometry.csv of Stray Scanner, whose header has spaces."""
    some = poses(5)
    more = ", fx, fy, cx, cy, distortion_center_x" if lens else ""
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw" + more]
    for i, T in enumerate(some):
        w, x, y, z = T.quat()
        cells = [
            f"{100 + i / 60:.6f}",
            f"{i + first:06d}",
            *(f"{v:.15g}" for v in (*T.t, x, y, z, w)),
        ]
        rows.append(
            ", ".join([*cells, *((f"{1600 + i}.0", "1600.0", "960", "720", "") if lens else ())])
        )
    path.write_text("\n".join(rows) + "\n")
    return some


def numbered(first: int = 0, stamps: list[float] | None = None) -> list[Frame]:
    return [
        Frame(
            id=i, name=f"{i + first:06d}", color=f"color/{i + first:06d}.png",
            timestamp=stamps[i] if stamps else None,
        )
        for i in range(5)
    ]  # fmt: skip


@pytest.mark.parametrize("stamps", [None, [5.0 + i / 60 for i in range(5)]])
def test_odometry_of_stray_scanner_belongs_by_its_frames(stamps, tmp_path: Path) -> None:
    """The images have no time, or that of another clock."""
    truth = stray(tmp_path / "odometry.csv")
    got = found(tmp_path / "odometry.csv", numbered(stamps=stamps))
    np.testing.assert_allclose(got, [T.matrix() for T in truth], atol=1e-9)
    with pytest.raises(ToolkitError, match=r"images counted from 1.*--cameras-first 0"):
        found(tmp_path / "odometry.csv", numbered(1))
    late = found(tmp_path / "odometry.csv", numbered(1), cameras_first=0)
    np.testing.assert_allclose(late, got)


def test_intrinsics_of_each_row_are_read(tmp_path: Path, caplog) -> None:
    stray(tmp_path / "odometry.csv", lens=True)
    with caplog.at_level("INFO", "std_toolkit"):
        filed = read_cameras(tmp_path / "odometry.csv")
    assert [x.fx for x in filed.lenses if x] == [1600, 1601, 1602, 1603, 1604]
    assert "columns that are not read: distortion_center_x" in caplog.text


@pytest.mark.parametrize(
    "stamps",
    [
        ["1305031102", "1305031102.5", "1305031103", "1305031103.5", "1305031104"],
        ["1305031102", "1305031103", "1305031104", "1305031105", "1305031106"],
        ["3", "4", "5", "6", "7"],
    ],
)
@pytest.mark.parametrize("head", ["timestamp,x,y,z,qx,qy,qz,qw\n", ""])
def test_whole_seconds_are_times(stamps: list[str], head: str, tmp_path: Path) -> None:
    if not head and stamps[0] == "3":
        return  # without a header these are indices
    some, rows = poses(5), []
    for s, T in zip(stamps, some, strict=True):
        w, x, y, z = T.quat()
        rows.append([s, *(f"{v:.15g}" for v in (*T.t, x, y, z, w))])
    sep = "," if head else " "
    (tmp_path / "t.csv").write_text(head + "\n".join(map(sep.join, rows)))
    frames = numbered(stamps=[float(s) + 0.004 for s in stamps])
    np.testing.assert_allclose(
        found(tmp_path / "t.csv", frames), [T.matrix() for T in some], atol=1e-9
    )


@pytest.mark.parametrize(
    ("head", "unit", "angle"),
    [
        ("name,x [mm],y [mm],z [mm],rx,ry,rz", 0.001, 1.0),
        ("name,x_cm,y_cm,z_cm,rx(deg),ry(deg),rz(deg)", 0.01, np.pi / 180),
        ("name,x(m),y(m),z(m),rx_rad,ry_rad,rz_rad", 1.0, 1.0),
    ],
)
def test_units_of_a_header(head: str, unit: float, angle: float, tmp_path: Path) -> None:
    rows = [f"{i:06d}.png,{10 * i},0,5,0.1,0.2,{0.3 * i}" for i in range(5)]
    (tmp_path / "t.csv").write_text("\n".join([head, *rows]))
    got = found(tmp_path / "t.csv", numbered())
    for i, T in enumerate(got):
        turn = SE3.exp(np.array([0, 0, 0, 0.1, 0.2, 0.3 * i]) * angle).R
        np.testing.assert_allclose(T[:3, :3], turn, atol=1e-9)
        np.testing.assert_allclose(T[:3, 3], np.array([10 * i, 0, 5]) * unit, atol=1e-9)
    for odd in ("name,x [in],y [in],z [in],rx,ry,rz", "name,x [mm],y [m],z [m],rx,ry,rz"):
        (tmp_path / "t.csv").write_text("\n".join([odd, *rows]))
        with pytest.raises(ToolkitError, match=r"x, y, z: columns in .*known units"):
            read_cameras(tmp_path / "t.csv")


def test_poses_of_a_packed_array_and_of_another_scale(tmp_path: Path, caplog) -> None:
    matrices = np.array([T.matrix() for T in poses(5)])
    np.savez(tmp_path / "t.npz", poses=matrices)
    np.testing.assert_allclose(read_cameras(tmp_path / "t.npz").matrices, matrices, atol=1e-12)
    np.savez(tmp_path / "two.npz", a=matrices, b=matrices)
    with pytest.raises(ToolkitError, match="several arrays"):
        read_cameras(tmp_path / "two.npz")
    frames = [
        {"file_path": f"{i}.png", "transform_matrix": M.tolist()} for i, M in enumerate(matrices)
    ]
    (tmp_path / "transforms.json").write_text(json.dumps({"applied_scale": 0.5, "frames": frames}))
    read_cameras(tmp_path / "transforms.json")
    assert "applied_scale is 0.5" in caplog.text
