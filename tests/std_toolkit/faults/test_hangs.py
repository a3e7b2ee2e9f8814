"""Small files that ask for endless time or memory: refused in 2 s and 500 MB, with their names."""

from __future__ import annotations

import io
import json
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.io.foreign_files import read_npy, read_yaml
from std_toolkit.labels.entry.pnp import read_correspondences
from std_toolkit.labels.entry.posefile import read_pose
from std_toolkit.poses.camera_file import read_cameras

SECONDS, BYTES = 2.0, 500 * 1024 * 1024


def header_of(shape: tuple[int, ...]) -> bytes:
    """A .npy file of 64 numbers whose header announces another shape."""
    text = repr({"descr": "<f8", "fortran_order": False, "shape": shape}).encode()
    text += b" " * (63 - (len(text) + 10) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(512)


def alias_bomb() -> str:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 10)]
    return "\n".join(lines)


def packed(count: int) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, K=np.zeros(count))
    return file.getvalue()


NUMBER = "1" * 400
MEGABYTE = 1024 * 1024 - 100
MATRIX = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]]

CASES: dict[str, tuple[str, str | bytes, Callable[[Path], object]]] = {
    "newlines": ("k.yaml", "\n" * MEGABYTE + "fx", lambda p: read_intrinsics(str(p))),
    "spaces": ("k.yaml", " \n" * (MEGABYTE // 2) + "x", lambda p: read_intrinsics(str(p))),
    "open lists": ("k.yaml", "a: [\n" * (MEGABYTE // 5), lambda p: read_intrinsics(str(p))),
    "camera dump": (
        "k.txt",
        'Intrinsic of "Color" / 640x480 / {RGB8}\n' + "\n \n".join(["x"] * 200_000),
        lambda p: read_intrinsics(str(p), size=(640, 480)),
    ),
    "long integer in K": (
        "k.json",
        f'{{"fx": {NUMBER}, "fy": 1, "cx": 1, "cy": 1}}',
        lambda p: read_intrinsics(str(p)),
    ),
    "deep JSON": ("k.json", "[" * 100_000, lambda p: read_intrinsics(str(p))),
    "alias bomb": ("p.yaml", alias_bomb(), read_pose),
    "deep YAML": ("p.yaml", "[" * 20_000 + "]" * 20_000, read_pose),
    "large YAML": ("p.yaml", "- 1\n" * 400_000, read_pose),
    "key twice": ("p.yaml", "a: 1\nb: {c: 1, c: 2}\n", read_yaml),
    "terabyte": ("p.npy", header_of((10**12,)), read_pose),
    "more than 64 bits": ("p.npy", header_of((2**40, 2**40)), read_pose),
    "cameras of a terabyte": ("c.npy", header_of((10**11, 4, 4)), read_cameras),
    "cut array": ("p.npy", header_of((10, 7)), read_npy),
    "a million numbers": ("k.npz", packed(10**6), lambda p: read_intrinsics(str(p))),
    "long integer in a pose": (
        "p.json",
        json.dumps({"pose": MATRIX}).replace("[1, 0", f"[{NUMBER}, 0"),
        read_pose,
    ),
    "long field": (
        "c.csv",
        "u,v,x,y,z\n" + "1" * 200_000 + ",1,1,1,1\n",
        lambda p: read_correspondences(p),
    ),
    "long field of cameras": ("c.csv", "name,x,y,z,qw,qx,qy,qz\n" + "a" * 200_000, read_cameras),
    "long integer of a correspondence": (
        "c.json",
        f"[[{NUMBER}, 1, 1, 1, 1]]",
        lambda p: read_correspondences(p),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_it_is_refused_at_once(name: str, tmp_path: Path) -> None:
    file, content, read = CASES[name]
    path = tmp_path / file
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    with pytest.raises(ToolkitError) as caught:
        read(path)
    assert time.process_time() - began < SECONDS
    assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) < BYTES
    message = str(caught.value)
    assert file in message and "\n" not in message and len(message) < 500


def test_arrays_that_are_whole_are_read(tmp_path: Path) -> None:
    for array in (np.eye(4), np.zeros((3, 4), np.float32, order="F"), np.array(2.0)):
        np.save(tmp_path / "a.npy", array)
        np.testing.assert_array_equal(read_npy(tmp_path / "a.npy"), array)


def test_camera_files_of_ros_and_opencv_are_read(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(
        "%YAML:1.0\n---\nimage_width: 640 # pixels\nimage_height: 480\n"
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 600., 0., 320.,\n       0., 601., 240., 0., 0., 1. ]\n"
        "distortion_coefficients:\n  rows: 1\n  data: [0.1, -0.2, 0, 0, 0]\n"
    )
    found = read_intrinsics(str(path))
    assert (found.fx, found.fy, found.cx, found.cy) == (600, 601, 320, 240)
    assert found.distortion[:2] == (0.1, -0.2) and found.size == (640, 480)
