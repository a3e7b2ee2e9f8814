"""SwinDRNet's pose network on the frozen depth restorer, and objects told apart by middles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from safetensors.torch import save_file

from benchmark.methods.network import parameter_count
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs import (
    grouped,
    load_pose_weights,
    segments_of,
)
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import (
    PRESETS,
    SwinNOCSConfig,
)
from benchmark.methods.pose.swindrnet_nocs.trunk_network import TrunkNOCSNetwork
from benchmark.methods.registry import MethodOptions, make_pose_method, shipped_weights
from benchmark.methods.weights import read_weights, save_weights
from benchmark.training.pose.nocs_losses import PoseTarget, SwinNOCSLoss, to_middles
from std_toolkit.errors import ToolkitError

SMALL = replace(PRESETS["small"], input_size=(64, 64))


@pytest.fixture(scope="module")
def network() -> TrunkNOCSNetwork:
    torch.manual_seed(0)
    return TrunkNOCSNetwork(SMALL)


@pytest.fixture(scope="module")
def other_trunk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped restorer with one number changed."""
    state = read_weights(shipped_weights("swindrnet", "compact"))
    name = next(iter(state))
    state[name] = state[name].clone()
    state[name].view(-1)[0] += 1
    path = tmp_path_factory.mktemp("trunk") / "other.safetensors"
    save_file(state, path)
    return path


def test_the_file_holds_the_heads_alone(network, tmp_path):
    save_weights(network, tmp_path / "heads.safetensors")
    state = read_weights(tmp_path / "heads.safetensors")
    assert not [name for name in state if "backbone" in name or "attention" in name]
    assert parameter_count(network) < 2_200_000  # 4.4 MB in half precision
    assert parameter_count(network.trunk) > 10_000_000
    assert len(state["trunk_sha256"]) == 32


def test_a_training_step_leaves_the_trunk_as_it_is(network):
    before = {k: v.clone() for k, v in network.trunk.state_dict().items()}
    network.train()
    color, points = torch.rand(2, 3, 64, 64), torch.rand(2, 3, 64, 64) + 0.3
    mask = torch.full((2, 64, 64), 255, dtype=torch.uint8)
    mask[:, 10:30, 10:40] = 1
    classes = torch.where(mask == 1, 3, 8)
    target = PoseTarget(classes, torch.rand(2, 3, 64, 64), mask == 1, mask)
    loss = SwinNOCSLoss()(network(color, points), target)
    assert set(loss.parts) == {"classes", "smooth", "distance", "middles"}
    loss.total.backward()
    assert all(p.grad is not None and p.grad.any() for p in network.decode_head.parameters())
    assert all(p.grad is None for p in network.trunk.parameters())
    after = network.trunk.state_dict()
    assert all(torch.equal(before[k], after[k]) for k in before)
    assert not network.trunk.training
    network.zero_grad()
    network.eval()


def test_the_trunk_moves_with_the_network():
    network = TrunkNOCSNetwork(SMALL).double()
    assert {p.dtype for p in network.trunk.parameters()} == {torch.float64}


def test_weights_of_another_trunk_are_refused(network, other_trunk, tmp_path):
    save_weights(network, tmp_path / "heads.safetensors")
    settings = {"trunk_weights": str(other_trunk), "input_size": "64,64"}
    options = MethodOptions(
        preset="small", weights=tmp_path / "heads.safetensors", settings=settings
    )
    with pytest.raises(ToolkitError) as caught:
        make_pose_method("swindrnet-nocs", options)
    told = str(caught.value)
    assert "trained on the features of another SwinDRNet" in told
    assert str(other_trunk) in told and "--set trunk_weights=FILE" in told
    right = replace(options, settings={"input_size": "64,64"})
    assert make_pose_method("swindrnet-nocs", right).input_size == (64, 64)
    assert load_pose_weights(TrunkNOCSNetwork(SMALL), tmp_path / "heads.safetensors") is False


def test_weights_of_another_network_are_refused(network):
    with pytest.raises(ToolkitError, match="weights of another network"):
        load_pose_weights(network, shipped_weights("swindrnet", "compact"))


def test_touching_objects_of_a_class_are_split_by_their_middles():
    """Two mugs side by side, of which a few pixels look like a bowl."""
    mask = np.full((40, 80), 255, np.uint8)
    mask[10:30, 10:40], mask[10:30, 40:70] = 1, 2
    middles = to_middles(torch.from_numpy(mask)[None])[0].numpy()
    assert middles[:, 10, 10] == pytest.approx((14.5, 9.5))
    chances = np.full((9, 40, 80), 0.01, np.float32)
    chances[8, mask == 255] = 0.9
    chances[6, mask != 255] = 0.9
    chances[[6, 2], 12:16, 12:16] = [[[0.05]], [[0.9]]]
    noise = np.random.default_rng(0).normal(0, 2, middles.shape).astype(np.float32)
    config = SwinNOCSConfig(instances="middle", least_pixels=20, apart=10)
    found = segments_of(chances, config, middles + noise)
    assert found.class_ids.tolist() == [6, 6]
    assert found.scores[0] > found.scores[1] > 0.8
    assert found.chances is not None and found.chances.sum(axis=1) == pytest.approx(1)
    for each, number in zip(found.masks, (2, 1), strict=True):
        both = (each & (mask == number)).sum()
        assert both / (each | (mask == number)).sum() > 0.95
    assert len(segments_of(chances, replace(config, instances="piece"))) == 1  # of both


def test_objects_that_are_likely_of_no_class_are_left_out():
    chances = np.zeros((9, 20, 20), np.float32)
    chances[0], chances[4] = 0.7, 0.3
    middles = to_middles(torch.zeros(1, 20, 20, dtype=torch.uint8))[0].numpy()
    config = SwinNOCSConfig(instances="middle", apart=10, other=0.6)
    assert len(segments_of(chances, config, middles)) == 0
    found = segments_of(chances, replace(config, other=0.8), middles)
    assert (found.class_ids.tolist(), found.scores.tolist()) == (
        [4],
        [pytest.approx(0.3, rel=1e-4)],
    )


def test_nothing_is_no_object():
    nothing = np.eye(9, dtype=np.float32)[8][:, None, None] + np.zeros((9, 6, 8), np.float32)
    config = SwinNOCSConfig(instances="middle")
    found = segments_of(nothing, config, np.zeros((2, 6, 8), np.float32))
    assert len(found) == 0 and found.masks.shape == (0, 6, 8)
    assert (grouped(nothing[8] < 0, np.zeros((2, 6, 8), np.float32), 5.0) == -1).all()


def test_middles_need_a_network_that_says_them():
    with pytest.raises(ToolkitError, match="does not say where the middles"):
        segments_of(np.ones((9, 6, 8), np.float32), SwinNOCSConfig(instances="middle"))
