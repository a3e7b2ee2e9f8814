"""Packs with NOCS and classes, and those made before there were any."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from training_set import SIDE, SPLIT, packed, write_scenes

from benchmark.cli.train import main
from benchmark.data.frame import resize_nearest
from benchmark.data.splits import open_split
from benchmark.training.packed_frames import PackedFrames
from tests.dreds_on_disk import BALLS, write_dreds_scene

SIZE = (SIDE, SIDE)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("nocs_data"), scenes=2)


def test_nocs_and_classes_are_those_of_the_data_set(data, tmp_path):
    frames = PackedFrames([packed(tmp_path / "p", data, nocs=True)])
    assert frames.has_nocs
    batch = frames[list(range(6))]
    for i in range(6):
        source = open_split(SPLIT, data).load(i, nocs=True)
        expected = resize_nearest(source.nocs, SIZE)
        assert np.abs(batch["nocs"][i].numpy() / 255 - expected).max() <= 0.5 / 255 + 1e-6
        mask = resize_nearest(source.mask, SIZE)
        assert not batch["nocs"][i].numpy()[mask == 255].any()
        of_pixels = batch["classes"][i].numpy()[mask]
        for ball in BALLS:
            assert (of_pixels[mask == ball.mask_id] == ball.class_id).all()
        assert (of_pixels[mask == 255] == 255).all()


def test_a_frame_comes_back_with_nocs_and_classes(data, tmp_path):
    frame = PackedFrames([packed(tmp_path / "p", data, nocs=True)]).frame(2)
    source = open_split(SPLIT, data).load(2, nocs=True)
    classes = {i.mask_id: i.class_id for i in frame.instances}
    assert classes == {i.mask_id: i.class_id for i in source.instances}
    assert np.abs(frame.nocs - resize_nearest(source.nocs, SIZE)).max() < 0.0021


def test_packs_of_before_are_read_and_gone_on_with(data, tmp_path):
    """A pack.json of an earlier version has no field `nocs`."""
    folder = packed(tmp_path / "p", data)
    setup = json.loads((folder / "pack.json").read_text())
    assert setup.pop("nocs") is False
    (folder / "pack.json").write_text(json.dumps(setup))
    frames = PackedFrames([folder])
    assert not frames.has_nocs
    assert "nocs" not in frames[[0, 1]]
    assert frames.frame(0).nocs is None
    packed(folder, data)  # nothing left to do, and no other pack


def test_a_pack_without_nocs_beside_one_with_gives_none(data, tmp_path):
    other = write_scenes(tmp_path / "other", scenes=1, seed=9)
    folders = [packed(tmp_path / "a", data, nocs=True), packed(tmp_path / "b", other)]
    frames = PackedFrames(folders)
    assert not frames.has_nocs
    assert frames[[0, 7]].keys() == PackedFrames([folders[1]])[[0]].keys()


def test_frames_without_nocs_are_told_and_left_out(tmp_path, capsys):
    folder = tmp_path / "data" / "DREDS-CatKnown" / "train"
    write_dreds_scene(folder / "00000", frames=2)
    write_dreds_scene(folder / "00001", frames=1)
    (folder / "00000" / "0001_coord.png").unlink()
    command = ["pack", str(tmp_path / "p"), "--split", SPLIT, "--data", str(tmp_path / "data")]
    command += ["--engine", "serial", "--size", "32", "32", "--nocs"]
    assert main(command) == 1
    told = capsys.readouterr()
    assert "00000/0001" in told.err
    assert f"{tmp_path / 'p'}: 2 frames" in told.out
