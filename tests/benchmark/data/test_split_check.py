"""What `check_split` says of complete, incomplete and absent sets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dreds_on_disk import write_cleargrasp_real, write_dreds_scene, write_equal, write_std_scene

from benchmark.data.check import check_split
from std_toolkit.errors import ToolkitError


@pytest.fixture
def std(tmp_path: Path) -> Path:
    for scene in ("test_8", "train_3"):
        write_std_scene(tmp_path / "STD-CatKnown" / scene, frames=2)
    return tmp_path


def test_a_complete_set_that_is_smaller_than_published(std: Path) -> None:
    report = check_split(std, "std-catknown")
    assert report.is_complete
    assert (report.frames, len(report.scenes), report.missing) == (4, 2, {})
    assert report.sizes == {
        "colour": ((128, 72),),
        "raw depth": ((128, 72),),
        "ground truth": ((64, 36),),
    }
    text = report.text()
    assert "4 frames in 2 scenes, 2 each" in text
    assert "published by the paper: 22500 frames in 25 scenes (-22496 here)" in text
    assert "published by the README: 27000 frames in 25 scenes (-26996 here)" in text
    assert "contradict each other" in text
    assert "is the download complete?" in text


def test_missing_files_are_counted_and_some_named(std: Path) -> None:
    folder = std / "STD-CatKnown/test_8"
    (folder / "0000_mask.png").unlink()
    (folder / "0001_mask.png").unlink()
    (std / "STD-CatKnown/train_3/0001_meta.txt").unlink()
    report = check_split(std, "std-catknown")
    assert not report.is_complete
    assert report.missing == {
        "mask": ["test_8/0000_mask.png", "test_8/0001_mask.png"],
        "meta file": ["train_3/0001_meta.txt"],
    }
    assert report.unreadable == ()
    text = report.text()
    assert "no mask: 2 of the frames, as test_8/0000_mask.png, test_8/0001_mask.png" in text
    assert "https://mirrors.pku.edu.cn/dl-release/DREDS_ECCV2022/data/STD-CatKnown/" in text


def test_only_some_of_many_missing_files_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "DREDS-CatNovel/00029"
    write_dreds_scene(folder, frames=6, truth="_depth_0.exr")
    for path in folder.glob("*_color.png"):
        path.unlink()
    text = check_split(tmp_path, "dreds-catnovel").text()
    assert "no colour: 6 of the frames, as 00029/0000_color.png, " in text
    assert "00029/0002_color.png, ..." in text
    assert "0003_color" not in text


def test_other_truth_than_the_first_counts_as_there(tmp_path: Path) -> None:
    write_dreds_scene(tmp_path / "DREDS-CatNovel/00029", truth="_depth_0.exr")
    assert check_split(tmp_path, "dreds-catnovel").missing == {}


def test_damaged_frames_among_those_tried_are_told(std: Path) -> None:
    path = std / "STD-CatKnown/train_3/0001_gt_depth.exr"
    path.write_bytes(path.read_bytes()[:500])
    report = check_split(std, "std-catknown")
    assert not report.is_complete
    assert len(report.unreadable) == 1
    assert str(path) in report.unreadable[0]
    assert "cannot be read: " in report.text()


def test_several_sizes_are_all_told(std: Path) -> None:
    for scene in ("test_8", "train_3"):
        folder = std / "STD-CatKnown" / scene
        write_equal(folder / "0000_depth_415.exr", np.full((36, 64), 0.7, np.float32))
    report = check_split(std, "std-catknown")
    assert report.sizes["raw depth"] == ((64, 36), (128, 72))
    assert "raw depth: 64x36, 128x72" in report.text()


def test_scenes_of_unequal_length_are_told(std: Path) -> None:
    write_std_scene(std / "STD-CatKnown/train_4-1", frames=3)
    assert (
        "7 frames in 3 scenes: 2 in 2 of them; train_4-1 3"
        in check_split(std, "std-catknown").text()
    )


def test_nothing_there_says_where_it_is(tmp_path: Path) -> None:
    for root in (tmp_path, tmp_path / "nowhere"):
        report = check_split(root, "dreds-catknown-test")
        assert not report.is_complete
        assert report.frames == 0
        text = report.text()
        assert "nothing found" in text
        assert "expected: ROOT/DREDS-CatKnown/test/<scene>/0000_simDepthImage.exr" in text
        assert "page: https://pku-epic.github.io/DREDS/" in text
        assert "download: https://mirrors.pku.edu.cn" in text


def test_training_counts_are_of_training_and_validation(tmp_path: Path) -> None:
    write_dreds_scene(tmp_path / "DREDS-CatKnown/val/01162", frames=1)
    text = check_split(tmp_path, "dreds-catknown-val").text()
    assert "100200 frames in 3340 scenes (training and validation together)" in text
    assert "fewer than" not in text


def test_counts_as_published_are_said_to_fit(tmp_path: Path) -> None:
    """173 captures, of which only the first and the last few are real files."""
    folder = tmp_path / "real-val/d435"
    write_cleargrasp_real(folder, frames=1)
    for i in range(1, 173):
        for suffix in (
            "-transparent-rgb-img.jpg",
            "-transparent-depth-img.exr",
            "-opaque-depth-img.exr",
            "-mask.png",
        ):
            (folder / f"{i:09d}{suffix}").symlink_to(folder / f"000000000{suffix}")
    report = check_split(tmp_path, "cleargrasp-real-known")
    assert report.is_complete
    assert "published by the paper: 173 frames (as found)" in report.text()
    assert "expected:" not in report.text()


def test_an_unknown_split(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="known: dreds-catknown-train"):
        check_split(tmp_path, "std")
