"""Bad files: an error names the file, what is wrong with it, and what to do."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from dreds_on_disk import (
    BALLS,
    LABEL_SIZE,
    write_cleargrasp_real,
    write_cleargrasp_synthetic,
    write_dreds_scene,
    write_equal,
    write_std_scene,
)

from benchmark.data.splits import DepthSource, open_split
from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import write_color, write_png


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "DREDS-CatKnown/test/00000"
    write_dreds_scene(folder, frames=2)
    return folder


def opened(folder: Path) -> DepthSource:
    return open_split("dreds-catknown-test", folder.parents[2])


def message(folder: Path, index: int = 0) -> str:
    with pytest.raises(ToolkitError) as error:
        opened(folder).load(index)
    return str(error.value)


@pytest.mark.parametrize(
    ("suffix", "what"),
    [
        ("_color.png", "colour"),
        ("_simDepthImage.exr", "raw depth"),
        ("_depth_120.exr", "ground-truth depth"),
        ("_mask.exr", "mask"),
        ("_meta.txt", "meta file"),
    ],
)
def test_a_missing_file_is_named(folder: Path, suffix: str, what: str) -> None:
    (folder / f"0000{suffix}").unlink()
    told = message(folder)
    assert f"{folder / f'0000{suffix}'}: the frame has no {what}" in told
    assert "std-bench check-data" in told
    assert opened(folder).load(1).name == "0001"


@pytest.mark.parametrize("suffix", ["_simDepthImage.exr", "_depth_120.exr", "_mask.exr"])
@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "text"])
def test_a_damaged_exr_is_named(folder: Path, suffix: str, damage: str, capfd) -> None:
    path = folder / f"0000{suffix}"
    data = bytearray(path.read_bytes())
    if damage == "cut":
        data = data[: len(data) * 2 // 3]
    elif damage == "flipped":
        data[-len(data) // 4] ^= 0x10
    else:
        data = bytearray() if damage == "empty" else bytearray(b"not an image")
    path.write_bytes(data)
    assert str(path) in message(folder)


@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_a_damaged_png_is_named(folder: Path, damage: str) -> None:
    path = folder / "0000_color.png"
    data = bytearray(path.read_bytes())
    if damage == "cut":
        data = data[: len(data) // 2]
    else:
        data[len(data) // 2] ^= 0x10
    path.write_bytes(data)
    assert f"{path}: the PNG file is" in message(folder)


def test_mask_ids_that_are_not_in_the_meta_file(folder: Path) -> None:
    meta = folder / "0000_meta.txt"
    meta.write_text("".join(meta.read_text().splitlines(keepends=True)[:2]))
    told = message(folder)
    assert f"{folder / '0000_mask.exr'}: mask: " in told
    assert "[3, 4]" in told
    assert "_meta.txt" in told


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("1 2\n", "13 fields, or 3"),
        ("1 2 seven\n", "13 fields, or 3"),
        ("1 1 7\n", "material 0..3"),
        ("255 1 2\n", "id 0..254"),
        ("1 1 2\n1 2 2\n", "an id appears twice"),
        ("\N{SNOWMAN}\n", "cannot read the meta file"),
    ],
)
def test_a_meta_file_that_is_none(folder: Path, line: str, problem: str) -> None:
    (folder / "0000_meta.txt").write_text(line, encoding="utf-8")
    told = message(folder)
    assert str(folder / "0000_meta.txt") in told
    assert problem in told


def test_a_mask_of_another_size(folder: Path) -> None:
    write_equal(folder / "0000_mask.exr", np.ones((18, 32), np.float32))
    told = message(folder)
    assert "0000_mask.exr: the mask has another size" in told
    assert "64x36 (got '32x18')" in told


@pytest.mark.parametrize("suffix", ["_color.png", "_simDepthImage.exr"])
def test_images_of_other_proportions(folder: Path, suffix: str) -> None:
    path = folder / f"0000{suffix}"
    if suffix.endswith("png"):
        write_color(path, np.zeros((48, 64, 3), np.uint8))
    else:
        write_equal(path, np.ones((48, 64), np.float32))
    told = message(folder)
    assert f"{path}: has other proportions" in told
    assert "64x48" in told


def test_labels_of_proportions_whose_camera_nobody_knows(tmp_path: Path) -> None:
    folder = tmp_path / "DREDS-CatKnown/test/00000"
    write_dreds_scene(folder, frames=1, color_size=(64, 48), label_size=(64, 48))
    told = message(folder)
    assert "0000_depth_120.exr: images of this layout are 640:360" in told


@pytest.mark.parametrize("suffix", ["_simDepthImage.exr", "_depth_120.exr"])
def test_depth_in_millimetres(folder: Path, suffix: str) -> None:
    write_equal(folder / f"0000{suffix}", np.full(LABEL_SIZE[::-1], 700, np.float32))
    told = message(folder)
    assert "not to be in metres" in told
    assert f"0000{suffix}" in told


def test_a_picture_in_the_place_of_depth(folder: Path) -> None:
    from std_toolkit.io.exr import write_exr

    values = np.random.default_rng(0).random((3, *LABEL_SIZE[::-1]), np.float32)
    write_exr(folder / "0000_depth_120.exr", dict(zip("RGB", values, strict=True)))
    assert "0000_depth_120.exr: the EXR file is a picture" in message(folder)


@pytest.mark.parametrize("value", [-0.5, 2.0, np.nan])
def test_a_mask_that_holds_no_ids(folder: Path, value: float) -> None:
    mask = np.ones(LABEL_SIZE[::-1], np.float32)
    mask[3, 4] = value
    write_equal(folder / "0000_mask.exr", mask)
    assert "0000_mask.exr: a mask in EXR holds id/255" in message(folder)


@pytest.mark.parametrize("kind", ["colours", "16 bits"])
def test_a_png_mask_that_is_none(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "STD-CatKnown/test_8"
    write_std_scene(folder, frames=1)
    if kind == "colours":
        image = np.random.default_rng(0).integers(0, 255, (*LABEL_SIZE[::-1], 3), dtype=np.uint8)
    else:
        image = np.ones(LABEL_SIZE[::-1], np.uint16)
    write_png(folder / "0000_mask.png", image)
    with pytest.raises(ToolkitError, match=r"0000_mask\.png: a mask"):
        open_split("std-catknown", tmp_path).load(0)


def test_a_coordinate_picture_of_another_size(folder: Path) -> None:
    write_png(folder / "0000_coord.png", np.zeros((18, 32, 3), np.uint8))
    with pytest.raises(ToolkitError, match=r"0000_coord\.png"):
        opened(folder).load(0, nocs=True)
    opened(folder).load(0)


def test_a_number_that_no_frame_has(folder: Path) -> None:
    for index in (-1, 2):
        with pytest.raises(IndexError):
            opened(folder).load(index)


def test_errors_reach_another_process(folder: Path) -> None:
    (folder / "0000_mask.exr").unlink()
    with pytest.raises(ToolkitError) as error:
        opened(folder).load(0)
    assert str(pickle.loads(pickle.dumps(error.value))) == str(error.value)


def test_faults_of_cleargrasp(tmp_path: Path) -> None:
    real = tmp_path / "real-val/d435"
    write_cleargrasp_real(real, frames=2)
    (real / "000000000-opaque-depth-img.exr").unlink()
    write_png(real / "000000001-mask.png", np.zeros((36, 64), np.uint8))
    source = open_split("cleargrasp-real-known", tmp_path)
    with pytest.raises(ToolkitError, match=r"000000000-opaque-depth-img\.exr: the frame has no"):
        source.load(0)
    with pytest.raises(ToolkitError, match=r"000000001-mask\.png: the mask has another size"):
        source.load(1)


def test_faults_of_rendered_cleargrasp(tmp_path: Path) -> None:
    folder = tmp_path / "synthetic-val/cup-val"
    write_cleargrasp_synthetic(folder, frames=2)
    (folder / "json-files/000000000-masks.json").write_text('{"camera": {}}')
    (folder / "segmentation-masks/000000001-segmentation-mask.png").unlink()
    source = open_split("cleargrasp-synthetic", tmp_path)
    with pytest.raises(ToolkitError, match=r"000000000-masks\.json: camera\.field_of_view"):
        source.load(0)
    with pytest.raises(ToolkitError, match=r"nor 000000001-mask\.png"):
        source.load(1)


def test_intrinsics_of_another_size(tmp_path: Path) -> None:
    real = tmp_path / "real-val"
    write_cleargrasp_real(real, frames=1)
    (real / "camera_intrinsics.yaml").write_text(
        "xres: 640\nyres: 480\nfx: 600\nfy: 600\ncx: 320\ncy: 240\n"
    )
    with pytest.raises(ToolkitError, match="intrinsics are for 640x480"):
        open_split("cleargrasp-real-known", tmp_path).load(0)


def test_objects_that_nobody_sees_are_no_fault(folder: Path) -> None:
    frame = opened(folder).load(0)
    assert len(frame.instances) == len(BALLS)
    write_equal(folder / "0000_mask.exr", np.ones(LABEL_SIZE[::-1], np.float32))
    empty = opened(folder).load(0)
    assert not empty.mask_of().any()
