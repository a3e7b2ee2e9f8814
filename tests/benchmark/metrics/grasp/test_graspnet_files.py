"""Files of grasps as GraspNet has them."""

from pathlib import Path

import numpy as np
import pytest

from benchmark.metrics.grasp.grasp import DumpKey, Grasps, dumped, read_grasps, write_grasps
from std_toolkit.errors import ToolkitError


def three_grasps() -> Grasps:
    R = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    return Grasps.make(
        np.tile(R, (3, 1, 1)), np.arange(9).reshape(3, 3) / 10, widths=0.05, depths=0.02,
        scores=[1, 2, 3], object_ids=[4, -1, 0],
    )  # fmt: skip


def test_a_dump_is_read_as_it_was_written(tmp_path: Path) -> None:
    keys = [DumpKey(100, "realsense", 3), DumpKey(7, "realsense", 255), DumpKey(7, "kinect", 0)]
    for key in keys:
        write_grasps(key.path(tmp_path), three_grasps())
    (tmp_path / "scene_0007" / "realsense" / "notes.txt").write_text("not grasps")
    assert keys[0].path(tmp_path) == tmp_path / "scene_0100" / "realsense" / "0003.npy"
    assert list(dumped(tmp_path, camera="realsense")) == [keys[1], keys[0]]
    assert list(dumped(tmp_path, camera="kinect")) == [keys[2]]
    again = read_grasps(keys[0].path(tmp_path))
    assert np.array_equal(again.to_array(), three_grasps().to_array())


def test_other_programs_write_float32(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", three_grasps().to_array().astype(np.float32))
    assert np.allclose(read_grasps(tmp_path / "a.npy").to_array(), three_grasps().to_array())
    write_grasps(tmp_path / "none.npy", Grasps.empty())
    assert len(read_grasps(tmp_path / "none.npy")) == 0


def test_what_is_no_file_of_grasps_is_refused(tmp_path: Path) -> None:
    (tmp_path / "torn.npy").write_bytes(b"\x93NUMPY\x01\x00v\x00{'descr'")
    np.save(tmp_path / "objects.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    np.save(tmp_path / "narrow.npy", np.zeros((3, 7)))
    np.save(tmp_path / "text.npy", np.array(["a"]))
    np.savez(tmp_path / "zip.npz", a=np.zeros(3))
    names = ("torn.npy", "objects.npy", "narrow.npy", "text.npy", "zip.npz", "absent.npy")
    for name in names:
        with pytest.raises(ToolkitError) as told:
            read_grasps(tmp_path / name)
        assert name in str(told.value) and "\n" not in str(told.value)
    with pytest.raises(ToolkitError, match="not there"):
        list(dumped(tmp_path / "nowhere", camera="kinect"))
    with pytest.raises(ToolkitError, match="realsense"):
        list(dumped(tmp_path, camera="d415"))
