"""Frames with NOCS that are moved, and objects that are put into other frames."""

from __future__ import annotations

import pytest
import torch

from benchmark.training.augmentation import frames as augmentation
from benchmark.training.augmentation.frames import copy_paste, moved
from benchmark.training.step import ModelInput

H, W = 24, 32


def two_frames() -> ModelInput:
    """A frame with a bottle (id 1) at 0.6 m, and one with a mug (2) at 0.5 m where the bottle is
    and a car (3) elsewhere; the tables are at 1 m and at 2 m, and depth counts from there."""
    mask = torch.full((2, H, W), 255, dtype=torch.uint8)
    true = torch.ones(2, H, W)
    true[1] = 2.0
    mask[0, 4:12, 4:12], true[0, 4:12, 4:12] = 1, 0.6
    mask[1, 4:12, 8:16], true[1, 4:12, 8:16] = 2, 1.0  # 0.5 m after division
    mask[1, 14:20, 4:12], true[1, 14:20, 4:12] = 3, 1.8
    classes = torch.full((2, 256), 255, dtype=torch.uint8)
    classes[0, 1], classes[1, 2], classes[1, 3] = 1, 6, 5
    nocs = torch.zeros(2, H, W, 3, dtype=torch.uint8)
    nocs[mask != 255] = torch.tensor([60, 100, 140], dtype=torch.uint8)
    color = torch.zeros(2, 3, H, W)
    color[1] = 1.0
    batch = {
        "true": true, "mask": mask, "classes": classes, "nocs": nocs,
        "materials": classes.clone(), "index": torch.arange(2),
        "K": torch.tensor([[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]]).expand(2, 3, 3),
    }  # fmt: skip
    return ModelInput(color, true[:, None].clone(), batch)


def test_pasted_objects_stand_in_front_of_what_is_farther(monkeypatch):
    monkeypatch.setattr(augmentation, "_TAKEN", 1.0)
    torch.manual_seed(0)
    seen = two_frames()
    found = copy_paste(seen, 1.0)
    mask = found.batch["mask"]
    mug, car = 2 + 127, 3 + 127
    assert (mask[0, 4:12, 8:16] == mug).all()  # in front of a part of the bottle
    assert (mask[0, 4:12, 4:8] == 1).all()
    assert (mask[0, 14:20, 4:12] == car).all()
    assert found.batch["true"][0, 5, 10] == pytest.approx(0.5, abs=0.02)
    assert found.depth[0, 0, 15, 5] == pytest.approx(0.9, abs=0.02)
    inside = (mask[0] == mug) | (mask[0] == car)
    assert torch.equal(found.color[0, 0] == 1, inside)
    assert found.batch["classes"][0, [1, mug, car]].tolist() == [1, 6, 5]
    # The bottle, at 1.2 m there, is behind the mug and stands beside it.
    assert (mask[1, 4:12, 8:16] == 2).all()
    assert (mask[1, 4:12, 4:8] == 1 + 127).all()
    assert (found.batch["nocs"][1, 5, 5] == torch.tensor([60, 100, 140])).all()
    # What was given stays as it was.
    assert (seen.batch["mask"][0, 14:20, 4:12] == 255).all()


def test_nothing_is_pasted_into_a_share_of_0_or_from_a_single_frame(monkeypatch):
    monkeypatch.setattr(augmentation, "_TAKEN", 1.0)
    seen = two_frames()
    assert torch.equal(copy_paste(seen, 0.0).batch["mask"], seen.batch["mask"])
    one = ModelInput(seen.color[:1], seen.depth[:1], {k: v[:1] for k, v in seen.batch.items()})
    assert torch.equal(copy_paste(one, 1.0).batch["mask"], one.batch["mask"])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_coordinates_of_mirrored_frames_are_those_of_mirrored_objects(monkeypatch, side):
    def motions(count):
        motion = torch.diag(torch.tensor([side, 1.0]))
        return motion.expand(count, 2, 2), torch.ones(count)

    monkeypatch.setattr(augmentation, "_motions", motions)
    seen = two_frames()
    batch = moved(seen).batch
    mirrored = side < 0
    expected = {1: (195, 100, 140), 2: (60, 100, 115), 3: (195, 100, 140)}  # mug: across z
    for frame, number in ((0, 1), (1, 2), (1, 3)):
        there = batch["mask"][frame] == number
        assert there.sum() == (seen.batch["mask"][frame] == number).sum()
        value = expected[number] if mirrored else (60, 100, 140)
        assert (batch["nocs"][frame][there] == torch.tensor(value)).all()
    assert not batch["nocs"][batch["mask"] == 255].any()
    assert torch.equal(batch["classes"], seen.batch["classes"])
