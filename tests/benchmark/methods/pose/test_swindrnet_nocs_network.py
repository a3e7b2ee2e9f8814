"""SwinDRNet's pose network: sizes as published, what its fusion does, whose weights fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from safetensors.torch import save_file

from benchmark.methods.depth.swindrnet.fusion_decoder import UPerHead
from benchmark.methods.depth.swindrnet.swindrnet_network import SwinDRNetConfig, SwinDRNetwork
from benchmark.methods.network import parameter_count
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs import (
    begin_pose_network,
    load_pose_weights,
    segments_of,
)
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import (
    PRESETS,
    AttendingFusion,
    SwinNOCSConfig,
    SwinNOCSNetwork,
)
from benchmark.methods.protocol import PoseView
from benchmark.methods.registry import MethodOptions, make_pose_method
from benchmark.methods.torch_camera import points_of
from benchmark.methods.weights import save_weights
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

TINY = SwinNOCSConfig(
    channels=8, depths=(2, 1, 1, 1), heads=(2, 1, 1, 1), head_channels=8, input_size=(32, 32)
)
SETTINGS = {
    "channels": "8",
    "depths": "2,1,1,1",
    "heads": "2,1,1,1",
    "head_channels": "8",
    "input_size": "32,32",
}


def a_network(config: SwinNOCSConfig = TINY, seed: int = 0) -> SwinNOCSNetwork:
    torch.manual_seed(seed)
    return SwinNOCSNetwork(config).eval()


def test_the_published_network_has_as_many_parameters_as_the_authors():
    """234,220,311 are published; two decoders, for depth and confidence, are left away here."""
    with torch.device("meta"):
        network = SwinNOCSNetwork(PRESETS["published"])
        unused = [UPerHead((96, 192, 384, 768), 512, n, (1, 2, 3, 6), 0.1) for n in (1, 2)]
        compact = SwinNOCSNetwork(PRESETS["compact"])
    assert parameter_count(network) + sum(map(parameter_count, unused)) == 234_220_311
    assert parameter_count(network) == 171_377_940
    assert parameter_count(compact) < 15_000_000


def test_as_many_parameters_are_idle_as_in_the_authors():
    """72.6 million, the two decoders of 62.84 included."""
    fusion = AttendingFusion(8, 2, 2, 7)
    tokens = torch.rand(2, 1, 7, 7, 8)
    fusion(tokens[0], tokens[1]).square().sum().backward()
    idle = {name for name, p in fusion.named_parameters() if p.grad is None}
    first, second = "cross_attn_layer.blocks.0", "cross_attn_layer.blocks.1"
    assert {name for name in idle if name.startswith(second)} == {
        f"{second}.attn.{name}"
        for name in ("relative_position_bias_table_2", "proj_branch_2.weight", "proj_branch_2.bias")
    }
    assert {name.removeprefix(first)[:6] for name in idle if name.startswith(first)} == {
        ".attn.",
        ".norm1",
    }
    total = 0
    for channels, heads, blocks in ((96, 3, 2), (192, 6, 2), (384, 12, 6), (768, 24, 2)):
        with torch.device("meta"):
            full = dict(AttendingFusion(channels, 2, heads, 7).named_parameters())
        total += blocks // 2 * sum(full[name].numel() for name in idle)
    assert total + 62_842_371 == pytest.approx(72.6e6, abs=0.05e6)


def test_only_shifted_blocks_attend_and_only_to_colour():
    """In an unshifted block a pixel depends on no other; in a shifted one on colours around it,
    and on points only through its own query."""
    torch.manual_seed(0)
    color, points = torch.randn(2, 1, 14, 14, 8)
    for blocks, spreads in ((1, False), (2, True)):
        fusion = AttendingFusion(8, blocks, 2, 7).eval()
        with torch.no_grad():
            plain = fusion(color, points)
            for which, far in (("color", spreads), ("points", False)):
                changed = {"color": color.clone(), "points": points.clone()}
                changed[which][0, 5, 5] += 1
                moved = (fusion(changed["color"], changed["points"]) != plain).any(dim=-1)[0]
                assert moved[5, 5]
                assert bool(moved.sum() > 1) == far


@pytest.mark.parametrize(("fusion", "details"), [("released", 0), ("paper", 0), ("paper", 1)])
def test_any_size_of_image_goes_through(fusion, details):
    network = a_network(replace(TINY, fusion=fusion, details=bool(details)))
    with torch.no_grad():
        answer = network(torch.rand(1, 3, 50, 38), torch.rand(1, 3, 50, 38))
    assert answer.classes.shape == (1, 9, 50, 38)
    assert answer.nocs.shape == (1, 3, 50, 38)


def as_the_authors_save_it(network: SwinNOCSNetwork) -> dict[str, torch.Tensor]:
    """Other names of decoders, two decoders more, masks of windows, before all of it `module.`"""
    names = {"decode_head_classes": "head_a", "decode_head_nocs": "head_b"}
    state = {}
    for key, tensor in network.state_dict().items():
        head, _, rest = key.partition(".")
        state[f"module.{names.get(head, head)}.{rest}"] = tensor.clone()
    inputs, width = network.config.fused_channels, network.config.head_channels
    for name, outputs in (("decode_head_depth_restoration", 1), ("decode_head_confidence", 2)):
        head = UPerHead(inputs, width, outputs, network.config.pool_scales, 0.1)
        state |= {f"module.{name}.{key}": t.clone() for key, t in head.state_dict().items()}
    state["module.cross_attention_0.cross_attn_layer.blocks.1.attn_mask"] = torch.zeros(4, 49, 49)
    return state


@pytest.mark.slow
def test_weights_of_the_authors_are_known_and_their_z_is_turned(tmp_path):
    network = a_network()
    torch.save({"state_dict": as_the_authors_save_it(network)}, tmp_path / "authors.pth")
    save_weights(network, tmp_path / "own.safetensors")
    other = a_network(seed=1)
    assert load_pose_weights(other, tmp_path / "authors.pth") is True
    assert load_pose_weights(a_network(seed=2), tmp_path / "own.safetensors") is False
    for key, tensor in network.state_dict().items():
        assert torch.equal(other.state_dict()[key], tensor), key

    images = torch.rand(2, 3, 32, 32)
    found = []
    for name in ("authors.pth", "own.safetensors"):
        options = MethodOptions(weights=tmp_path / name, settings={**SETTINGS, "least_pixels": "1"})
        method = make_pose_method("swindrnet-nocs", options)
        with torch.no_grad():
            found.append(method.found(network(images[:1], images[1:]))[0].coordinates)
    assert np.allclose(found[0][..., :2], found[1][..., :2])
    assert np.allclose(found[0][..., 2], 1 - found[1][..., 2], atol=1e-6)


def test_weights_of_other_networks_are_refused_by_name(tmp_path):
    small = {"channels": 8, "depths": (1, 1, 1, 1), "heads": (1, 1, 1, 1), "head_channels": 8}
    save_weights(SwinDRNetwork(SwinDRNetConfig(**small)), tmp_path / "depth.safetensors")
    with pytest.raises(ToolkitError, match="look like those of SwinDRNet"):
        load_pose_weights(a_network(), tmp_path / "depth.safetensors")
    save_weights(a_network(), tmp_path / "pose.safetensors")
    from benchmark.methods.weights import load_weights

    with pytest.raises(ToolkitError, match="look like those of SwinDRNet's pose network"):
        load_weights(SwinDRNetwork(SwinDRNetConfig(**small)), tmp_path / "pose.safetensors")
    state = as_the_authors_save_it(a_network())
    save_file(state, tmp_path / "authors.safetensors")
    with pytest.raises(ToolkitError, match="SwinDRNet's pose network"):
        load_weights(SwinDRNetwork(SwinDRNetConfig(**small)), tmp_path / "authors.safetensors")


@pytest.mark.slow
def test_it_begins_with_streams_and_fusion_of_swindrnet(tmp_path):
    small = {
        "channels": 8,
        "depths": (2, 1, 1, 1),
        "heads": (2, 1, 1, 1),
        "head_channels": 8,
        "fusion": "paper",
        "details": True,
    }
    torch.manual_seed(1)
    restorer = SwinDRNetwork(SwinDRNetConfig(relative=True, **small)).eval()
    save_weights(restorer, tmp_path / "depth.safetensors")
    network = a_network(SwinNOCSConfig(**small))
    decoders = {k: v.clone() for k, v in network.state_dict().items() if k.startswith("decode")}
    begin_pose_network(network, tmp_path / "depth.safetensors")
    color, points = torch.rand(2, 1, 3, 48, 64)
    points[:, :, 5:20, 5:20] = 0
    with torch.no_grad():
        theirs = restorer.features(color, points[:, 2:])
        ours = network.features_of(network._images(color, points))
    assert all(torch.equal(a, b) for a, b in zip(ours.levels, theirs.levels, strict=True))
    assert all(torch.equal(a, b) for a, b in zip(ours.details, theirs.details, strict=True))
    assert all(torch.equal(network.state_dict()[k], v) for k, v in decoders.items())

    save_weights(network, tmp_path / "pose.safetensors")
    other = a_network(SwinNOCSConfig(**small), seed=2)
    begin_pose_network(other, tmp_path / "pose.safetensors")
    for key, tensor in network.state_dict().items():
        assert torch.equal(other.state_dict()[key], tensor), key
    wider = a_network(SwinNOCSConfig(**{**small, "channels": 16}))
    with pytest.raises(ToolkitError, match=r"SwinDRNet, but of another size"):
        begin_pose_network(wider, tmp_path / "depth.safetensors")


def test_nothing_begins_with_weights_that_say_z_the_other_way(tmp_path):
    network = a_network()
    save_file(as_the_authors_save_it(network), tmp_path / "authors.safetensors")
    with pytest.raises(ToolkitError, match="weights of another network"):
        begin_pose_network(network, tmp_path / "authors.safetensors")


def test_points_are_those_of_the_camera():
    camera = Camera(8, 6, 7.0, 6.5, 3.3, 2.6)
    depth = torch.rand(1, 1, 6, 8) + 0.3
    depth[0, 0, 2, 3] = 0
    found = points_of(depth, torch.from_numpy(camera.K)[None].float())[0].permute(1, 2, 0)
    expected = camera.rays() * depth[0, 0, :, :, None].numpy()
    assert np.allclose(found.numpy(), expected, atol=1e-6)


def test_segments_are_classes_or_their_pieces():
    chances = np.full((9, 10, 12), 0.01, np.float32)
    chances[8] = 0.5
    chances[2, 1:4, 1:4] = 0.9  # two bowls
    chances[2, 6:9, 6:11] = 0.7
    chances[5, 0, 11] = 0.95  # a speck
    chances[0, 5:, 0] = 0.9  # of no class
    whole = segments_of(chances, SwinNOCSConfig(least_pixels=2))
    assert whole.class_ids.tolist() == [2]
    assert whole.masks[0].sum() == 24
    assert whole.scores[0] == pytest.approx((9 * 0.9 + 15 * 0.7) / 24)
    pieces = segments_of(chances, SwinNOCSConfig(least_pixels=1, instances="piece"))
    assert pieces.class_ids.tolist() == [5, 2, 2]
    assert pieces.masks.sum(axis=(1, 2)).tolist() == [1, 9, 15]
    none = segments_of(np.eye(9, dtype=np.float32)[8][:, None, None] + chances * 0, TINY)
    assert len(none) == 0
    assert none.masks.shape == (0, 10, 12)


def test_a_view_without_depth_has_objects_and_no_pose(tmp_path):
    network = a_network()
    with torch.no_grad():
        network.decode_head_classes.conv_seg.bias[3] += 100  # everything is a camera
    save_weights(network, tmp_path / "w.safetensors")
    method = make_pose_method(
        "swindrnet-nocs", MethodOptions(weights=tmp_path / "w.safetensors", settings=SETTINGS)
    )
    nothing = np.zeros((32, 32), np.float32)
    view = PoseView(
        np.zeros((32, 32, 3), np.uint8), nothing, nothing, Camera(32, 32, 30, 30, 15.5, 15.5)
    )
    found = method.estimate([view])[0]
    assert found.prediction.class_ids.shape == (0,)
    assert found.masks.shape == (0, 32, 32)
    assert method.segment([view])[0].class_ids.tolist() == [3]
    paper = {**SETTINGS, "fit": "paper"}
    method = make_pose_method(
        "swindrnet-nocs", MethodOptions(weights=tmp_path / "w.safetensors", settings=paper)
    )
    assert np.array_equal(method.estimate([view])[0].prediction.RT[0], np.eye(4))
