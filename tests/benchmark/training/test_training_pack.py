"""Packs: what is in them, and what becomes of interruptions and damage."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader
from training_set import SIDE, SPLIT, packed, write_scenes

from benchmark.cli.train import main
from benchmark.data.splits import open_split
from benchmark.data.torch_dataset import DepthDataset
from benchmark.training import pack as pack_module
from benchmark.training.options import PackOptions
from benchmark.training.pack import pack_split
from benchmark.training.packed_frames import PackedFrames
from std_toolkit.errors import ToolkitError

SIZE = (SIDE, SIDE)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("pack_data"))


def test_packed_frames_are_those_of_the_data_set(data, tmp_path):
    """Against the data set of tensors, which resizes with torch."""
    frames = PackedFrames([packed(tmp_path / "p", data, color="nearest")])
    direct = DepthDataset(open_split(SPLIT, data), SIZE, color="nearest")
    assert len(frames) == len(direct) == 12
    batch = frames[list(range(12))]
    for i in range(12):
        item = direct[i]
        assert torch.equal(batch["color"][i].permute(2, 0, 1).float() / 255, item["color"])
        assert torch.equal(batch["raw"][i], item["depth_raw"][0])
        assert torch.equal(batch["true"][i], item["depth_true"][0])
        assert torch.equal(batch["mask"][i], item["mask"])
        assert torch.equal(batch["materials"][i][batch["mask"][i].long()], item["material"])
        assert torch.equal(batch["K"][i], item["K"])
        assert frames.key(i) == f"p: {item['key']}"
        assert batch["index"][i] == i


@pytest.mark.parametrize("way", ["cubic", "area"])
def test_colour_is_resized_as_asked(way, data, tmp_path):
    frames = PackedFrames([packed(tmp_path / "p", data, color=way)])
    color = open_split(SPLIT, data).load(3).color
    flag = {"cubic": cv2.INTER_CUBIC, "area": cv2.INTER_AREA}[way]
    expected = cv2.resize(color, SIZE, interpolation=flag)
    assert np.array_equal(frames[[3]]["color"][0].numpy(), expected)


def test_cut_depth_is_exact_where_a_sensor_measures(data, tmp_path):
    cut = PackedFrames([packed(tmp_path / "cut", data, raw="cut")])
    sensed = PackedFrames([packed(tmp_path / "sensed", data)])
    assert [setup.raw for setup in cut.setups + sensed.setups] == ["cut", "sensor"]
    batch, other = cut[list(range(12))], sensed[list(range(12))]
    for name in ("color", "true", "mask", "materials", "K"):
        assert torch.equal(batch[name], other[name])
    for i in range(12):
        material = batch["materials"][i][batch["mask"][i].long()]
        hard = (material == 2) | (material == 3)
        assert 0 < hard.sum() < hard.numel()
        assert (batch["raw"][i][hard] == 0).all()
        assert torch.equal(batch["raw"][i][~hard], batch["true"][i][~hard])


def test_half_floats_round_by_a_quarter_of_a_millimetre_at_most(data, tmp_path):
    whole = PackedFrames([packed(tmp_path / "whole", data)])
    half = PackedFrames([packed(tmp_path / "half", data, depth="float16")])
    one, other = whole[[0, 5, 11]], half[[0, 5, 11]]
    assert other["true"].dtype == torch.float32
    assert 0 < (one["true"] - other["true"]).abs().max() <= 0.00025
    sizes = [(tmp_path / n / "shard-00000.npy").stat().st_size for n in ("half", "whole")]
    assert sizes[0] < 0.7 * sizes[1]


def test_a_frame_comes_back_whole(data, tmp_path):
    frame = PackedFrames([packed(tmp_path / "p", data)]).frame(4)
    source = open_split(SPLIT, data).load(4)
    assert frame.key == source.key
    assert {(i.mask_id, i.material) for i in frame.instances} == {
        (i.mask_id, i.material) for i in source.instances
    }
    assert frame.camera.size == SIZE
    assert frame.camera.fx == pytest.approx(source.camera.resized(*SIZE).fx, rel=1e-6)


def test_several_packs_are_one_set(data, tmp_path):
    other = write_scenes(tmp_path / "other", scenes=1, seed=50)
    folders = [packed(tmp_path / "a", data), packed(tmp_path / "b", other)]
    frames = PackedFrames(folders)
    assert len(frames) == 15
    assert frames.key(12) == "b: 00000/0000"
    assert frames.scene(0) != frames.scene(12)  # another data set's 00000
    with pytest.raises(ToolkitError, match="several sizes"):
        PackedFrames([folders[0], packed(tmp_path / "c", other, size=(16, 16))])


def test_processes_map_for_themselves(data, tmp_path):
    frames = PackedFrames([packed(tmp_path / "p", data)])
    first = frames[[0, 1]]
    assert len(pickle.dumps(frames)) < 10_000
    loader = DataLoader(frames, sampler=[[0, 1], [7]], batch_size=None, num_workers=1)
    batches = list(loader)
    assert torch.equal(batches[0]["color"], first["color"])
    assert batches[1]["index"].tolist() == [7]


def test_packing_goes_on_and_repeats_nothing(data, tmp_path, monkeypatch):
    folder = tmp_path / "p"
    whole = packed(tmp_path / "whole", data)
    plain, done = pack_module.record_of, []

    def dies(frame, setup):
        if len(done) == 7:
            raise KeyboardInterrupt
        done.append(frame.key)
        return plain(frame, setup)

    monkeypatch.setattr(pack_module, "record_of", dies)
    with pytest.raises(KeyboardInterrupt):
        packed(folder, data)
    with pytest.raises(ToolkitError, match=r"not finished: shard-00001\.json is missing"):
        PackedFrames([folder])
    stamp = (folder / "shard-00000.npy").stat().st_mtime_ns
    (folder / ".shard-00001.0123456789ab.tmp.npy").write_bytes(b"left by a killed writer")
    monkeypatch.setattr(pack_module, "record_of", plain)
    packed(folder, data)
    assert (folder / "shard-00000.npy").stat().st_mtime_ns == stamp
    assert sorted(p.name for p in folder.iterdir()) == sorted(p.name for p in whole.iterdir())
    for path in whole.glob("shard-*"):
        assert path.read_bytes() == (folder / path.name).read_bytes()


def test_a_damaged_frame_is_told_left_out_and_tried_again(tmp_path, capsys):
    root = write_scenes(tmp_path / "data", scenes=2)
    damaged = root / "DREDS-CatKnown" / "train" / "00001" / "0001_simDepthImage.exr"
    content = damaged.read_bytes()
    damaged.write_bytes(content[:200])
    folder = tmp_path / "p"
    command = ["pack", str(folder), "--split", SPLIT, "--data", str(root), "--engine", "serial"]
    command += ["--size", "32", "32"]
    assert main(command) == 1
    told = capsys.readouterr()
    assert f"{folder}: 5 frames" in told.out
    assert "00001/0001" in told.err
    assert "0001_simDepthImage.exr" in told.err
    frames = PackedFrames([folder])
    assert [frames.key(i) for i in range(5)][3:] == ["p: 00001/0000", "p: 00001/0002"]
    damaged.write_bytes(content)
    assert main(command) == 0
    assert len(PackedFrames([folder])) == 6


@pytest.mark.parametrize("harm", ["cut", "missing", "pickle", "header", "other"])
def test_a_damaged_shard_is_told(harm, data, tmp_path):
    folder = packed(tmp_path / "p", data)
    shard = folder / "shard-00001.npy"
    content = shard.read_bytes()
    if harm == "cut":
        shard.write_bytes(content[: len(content) // 2])
    elif harm == "missing":
        shard.unlink()
    elif harm == "pickle":
        np.save(shard, np.array([{}, {}], object), allow_pickle=True)
    elif harm == "header":
        shard.write_bytes(content.replace(b"'shape': (", b"'shape': (\xff\xff", 1))
    else:
        np.save(shard, np.zeros(3))
    frames = PackedFrames([folder])
    assert len(frames[[0, 4]]["index"]) == 2
    with pytest.raises(ToolkitError, match=r"shard-00001\.npy: the shard .*std-train pack"):
        frames[[5]]


def test_another_pack_is_not_mixed_in(data, tmp_path):
    folder = packed(tmp_path / "p", data)
    with pytest.raises(ToolkitError, match=r"size: this pack was begun with \(32, 32\)"):
        packed(folder, data, size=(16, 16))
    more = write_scenes(tmp_path / "more", scenes=5)
    with pytest.raises(ToolkitError, match="root: this pack was begun with"):
        packed(folder, more)
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "mine.txt").touch()
    with pytest.raises(ToolkitError, match=r"contains files but no pack\.json"):
        packed(tmp_path / "x", data)
    with pytest.raises(ToolkitError, match=r"is no folder of packed frames.*std-train pack"):
        PackedFrames([tmp_path / "x"])


@pytest.mark.parametrize("wrong", [{"size": (0, 5)}, {"shard": 0}])
def test_impossible_options(wrong):
    with pytest.raises(ToolkitError):
        PackOptions(**wrong)


def test_worker_processes_write_the_same_files(data, tmp_path):
    from std_toolkit.jobs import JobOptions

    alone = packed(tmp_path / "alone", data)
    options = PackOptions(size=SIZE, shard=5)
    pack_split(tmp_path / "many", SPLIT, data, options, JobOptions(workers=2, progress=False))
    for path in alone.glob("shard-*"):
        assert path.read_bytes() == (tmp_path / "many" / path.name).read_bytes()


def test_a_pack_with_zeroed_bytes_is_refused_and_packed_again(data, tmp_path, capsys):
    folder = packed(tmp_path / "p", data)
    shard = folder / "shard-00001.npy"
    whole = shard.read_bytes()
    shard.write_bytes(whole[:-500] + bytes(500))
    frames = PackedFrames([folder])
    with pytest.raises(ToolkitError, match=r"shard-00001\.npy: the packed frame is not the one"):
        frames.check(range(len(frames)))
    words = ["--method", "dfnet", "--data", str(folder), "--out", str(tmp_path / "run")]
    assert main([*words, "--steps", "2", "--accelerator", "cpu"]) == 1
    assert "size" in capsys.readouterr().err  # of the network; damage is looked for behind it
    packed(folder, data)
    assert shard.read_bytes() == whole
    frames = PackedFrames([folder])
    frames.check(range(len(frames)))


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("pack.json", '{"split": 3}', "pack.json"),
        ("shard-00000.json", '{"scenes":["a"],"names":[],"digests":[],"failed":{}}', "lengths"),
    ],
)
def test_a_damaged_index_is_one_line(data, tmp_path, name, text, words):
    folder = packed(tmp_path / "p", data)
    (folder / name).write_text(text)
    with pytest.raises(ToolkitError, match=words):
        PackedFrames([folder])
