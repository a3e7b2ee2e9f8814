"""Frames as tensors: what they hold, and that worker processes can make them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from dreds_on_disk import BALLS, Drawn, write_dreds_scene, write_std_scene

from benchmark.data.splits import open_split
from std_toolkit.errors import ToolkitError

torch = pytest.importorskip("torch")

from torch.utils.data import DataLoader  # noqa: E402

from benchmark.data.torch_dataset import DepthDataset  # noqa: E402

SIZE = (24, 20)


@pytest.fixture(scope="module")
def std(tmp_path_factory) -> tuple[Path, list[Drawn]]:
    top = tmp_path_factory.mktemp("std")
    return top, write_std_scene(top / "STD-CatKnown/test_8", frames=5)


def nearest(image: np.ndarray) -> np.ndarray:
    """floor(i * in / out), in every axis on its own."""
    rows = np.arange(SIZE[1]) * image.shape[0] // SIZE[1]
    columns = np.arange(SIZE[0]) * image.shape[1] // SIZE[0]
    return image[rows][:, columns]


def test_an_item_holds_the_frame_at_the_size_asked_for(std) -> None:
    top, drawn = std
    source = open_split("std-catknown", top)
    item = DepthDataset(source, SIZE, nocs=True)[2]
    one = drawn[2]
    np.testing.assert_array_equal(
        item["color"].numpy(), nearest(one.color).transpose(2, 0, 1).astype(np.float32) / 255
    )
    np.testing.assert_array_equal(item["depth_raw"].numpy(), nearest(one.raw)[None])
    np.testing.assert_array_equal(item["depth_true"].numpy(), nearest(one.true)[None])
    np.testing.assert_array_equal(item["mask"].numpy(), nearest(one.mask))
    frame = source.load(2, nocs=True)
    np.testing.assert_array_equal(item["nocs"].numpy(), nearest(frame.nocs).transpose(2, 0, 1))
    np.testing.assert_allclose(item["K"].numpy(), one.camera.resized(*SIZE).K, rtol=1e-6)
    assert (item["index"], item["key"]) == (2, "test_8/0002")
    assert item["depth_raw"].dtype == torch.float32


def test_materials_and_classes_are_those_of_the_pixels(std) -> None:
    top, drawn = std
    item = DepthDataset(open_split("std-catknown", top), SIZE)[0]
    ids = nearest(drawn[0].mask)
    for ball in BALLS[:3]:
        seen = ids == ball.mask_id
        assert seen.any()
        assert set(item["material"].numpy()[seen]) == {ball.material}
        assert set(item["class_id"].numpy()[seen]) == {ball.class_id}
    assert set(item["material"].numpy()[ids == 255]) == {255}
    assert set(item["class_id"].numpy()[ids == 255]) == {255}


def test_colour_may_be_cubic(std) -> None:
    top, drawn = std
    item = DepthDataset(open_split("std-catknown", top), SIZE, color="cubic")[0]
    expected = cv2.resize(drawn[0].color, SIZE, interpolation=cv2.INTER_CUBIC)
    np.testing.assert_array_equal(
        item["color"].numpy(), expected.transpose(2, 0, 1).astype(np.float32) / 255
    )
    np.testing.assert_array_equal(item["depth_raw"].numpy(), nearest(drawn[0].raw)[None])


@pytest.mark.parametrize("start", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_make_the_same_batches(std, start: str) -> None:
    data = DepthDataset(open_split("std-catknown", std[0]), SIZE)
    batches = list(DataLoader(data, batch_size=2, num_workers=2, multiprocessing_context=start))
    assert [len(b["key"]) for b in batches] == [2, 2, 1]
    for batch in batches:
        for row, index in enumerate(batch["index"]):
            item = data[int(index)]
            for name in ("color", "depth_raw", "depth_true", "mask", "material", "K"):
                assert torch.equal(batch[name][row], item[name])


def test_a_bad_frame_is_named_out_of_a_worker(tmp_path: Path) -> None:
    folder = tmp_path / "DREDS-CatKnown/train/00001"
    write_dreds_scene(folder, frames=2)
    (folder / "0001_mask.exr").unlink()
    data = DepthDataset(open_split("dreds-catknown-train", tmp_path), SIZE)
    with pytest.raises(ToolkitError, match=r"0001_mask\.exr"):
        list(DataLoader(data, num_workers=1))


def test_coordinates_that_a_set_does_not_have(tmp_path: Path) -> None:
    write_dreds_scene(tmp_path / "DREDS-CatNovel/00029", frames=1, short_meta=True)
    data = DepthDataset(open_split("dreds-catnovel", tmp_path), SIZE, nocs=True)
    with pytest.raises(ToolkitError, match="00029/0000: the frame has no NOCS map"):
        data[0]


def test_an_impossible_size(std) -> None:
    with pytest.raises(ToolkitError, match="size: must be positive"):
        DepthDataset(open_split("std-catknown", std[0]), (0, 10))


def test_loading_and_checking_need_no_torch() -> None:
    """Methods without learning run where it is not installed."""
    modules = "benchmark.data.check, benchmark.data.known_splits, benchmark.data.frame"
    code = f"import sys, {modules}; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
