"""SwinDRNet's transformer, fusion and windows by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from network_cases import TINY_SWIN

from benchmark.methods.depth.swindrnet.fusion_decoder import (
    DetailDecoder,
    DetailEncoder,
    PaperFusion,
)
from benchmark.methods.depth.swindrnet.swin import (
    Swin,
    drop_path,
    from_windows,
    padded,
    relative_index,
    shift_mask,
    to_windows,
)
from benchmark.methods.depth.swindrnet.swindrnet import load_imagenet
from benchmark.methods.depth.swindrnet.swindrnet_network import SwinDRNetwork, blended
from benchmark.methods.weights import save_weights
from std_toolkit.errors import ToolkitError


def test_windows_there_and_back():
    tokens = torch.rand(2, 14, 21, 5)
    windows = to_windows(tokens, 7)
    assert windows.shape == (12, 49, 5)
    torch.testing.assert_close(windows[1], tokens[0, :7, 7:14].reshape(49, 5))
    torch.testing.assert_close(from_windows(windows, 7, 14, 21), tokens)


def test_padding_is_zeros_behind():
    tokens = torch.rand(1, 8, 14, 3)
    more = padded(tokens, 7)
    assert more.shape == (1, 14, 14, 3)
    assert torch.equal(more[:, :8], tokens) and not more[:, 8:].any()
    assert padded(more, 7) is more


def test_relative_index_is_by_offset_alone():
    index = relative_index(3)
    assert index.shape == (9, 9) and index.min() == 0 and index.max() == 24
    assert set(index.diagonal().tolist()) == {12}
    offsets = {}
    for i in range(9):
        for j in range(9):
            offset = (i // 3 - j // 3, i % 3 - j % 3)
            assert offsets.setdefault(offset, index[i, j].item()) == index[i, j].item()
    assert len(set(offsets.values())) == 25
    assert offsets[(-2, -2)] == 0 and offsets[(-2, -1)] == 1 and offsets[(-1, -2)] == 5


def test_shifted_windows_keep_the_edges_of_the_image_apart():
    side, shift, size = 4, 2, 8
    mask = shift_mask(size, size, side, shift, torch.device("cpu"))
    at = torch.arange(size * size).reshape(1, size, size, 1)
    rolled = to_windows(torch.roll(at, (-shift, -shift), (1, 2)), side)[..., 0]
    y, x = rolled // size, rolled % size
    near = (abs(y[:, :, None] - y[:, None]) < side) & (abs(x[:, :, None] - x[:, None]) < side)
    assert torch.equal(mask == 0, near)


def test_a_level_halves_and_doubles():
    levels = Swin(16, (1, 1, 1, 1), (1, 2, 4, 8))(torch.rand(2, 3, 96, 128))
    shapes = [tuple(level.shape) for level in levels]
    assert shapes == [(2, 24, 32, 16), (2, 12, 16, 32), (2, 6, 8, 64), (2, 3, 4, 128)]


@pytest.mark.slow
@pytest.mark.parametrize("size", [(224, 224), (256, 240)])
def test_against_the_swin_of_transformers(tmp_path, size):
    transformers = pytest.importorskip("transformers")
    config = transformers.SwinConfig(
        embed_dim=24,
        depths=[2, 2, 2, 2],
        num_heads=[1, 2, 4, 8],
        drop_path_rate=0.0,
        image_size=224,
    )
    torch.manual_seed(0)
    theirs = transformers.SwinModel(config).eval()
    with torch.no_grad():
        for name, parameter in theirs.named_parameters():
            if name.endswith("relative_position_bias_table") or parameter.dim() == 1:
                parameter.add_(torch.randn_like(parameter) * 0.1)
    theirs.save_pretrained(tmp_path)
    ours = SwinDRNetwork(
        replace(TINY_SWIN, channels=24, heads=(1, 2, 4, 8), depths=(2, 2, 2, 2))
    ).eval()
    load_imagenet(ours, tmp_path / "model.safetensors")
    image = torch.rand(1, 3, *size)
    with torch.inference_mode():
        expected = theirs(image, output_hidden_states=True, interpolate_pos_encoding=True)
        for stream in (ours.backbone_rgb_branch, ours.backbone_xyz_branch):
            tokens = stream.patch_embed(image)
            for index, stage in enumerate(stream.layers):
                # Where a level is no larger than a window, theirs does not shift.
                if min(tokens.shape[1:3]) <= 7:
                    stage.blocks[1].shift = 0
                whole, tokens = stage(tokens)
                if index < 3:
                    found = tokens.permute(0, 3, 1, 2)
                    there = expected.reshaped_hidden_states[index + 1]
                    torch.testing.assert_close(found, there, rtol=1e-4, atol=1e-4)
            torch.testing.assert_close(
                whole.flatten(1, 2), expected.hidden_states[-1], rtol=1e-4, atol=1e-4
            )


def test_imagenet_weights_under_the_published_keys(tmp_path):
    torch.manual_seed(1)
    donor = Swin(16, (2, 2, 2, 2), (1, 2, 4, 8))
    state = {k: v for k, v in donor.state_dict().items() if not k.startswith("norm")}
    state |= {"head.weight": torch.zeros(9, 128), "norm.weight": torch.zeros(128)}
    state |= {"layers.0.blocks.1.attn_mask": torch.zeros(4, 49, 49)}
    torch.save({"model": state}, tmp_path / "swin.pth")
    network = SwinDRNetwork(TINY_SWIN)
    load_imagenet(network, tmp_path / "swin.pth")
    for stream in (network.backbone_rgb_branch, network.backbone_xyz_branch):
        for key, tensor in stream.state_dict().items():
            assert torch.equal(tensor, donor.state_dict()[key]), key
    single = SwinDRNetwork(replace(TINY_SWIN, fusion="none", confidence=False))
    load_imagenet(single, tmp_path / "swin.pth")
    weight = single.backbone.patch_embed.proj.weight
    assert torch.equal(weight[:, :3], donor.patch_embed.proj.weight)
    torch.testing.assert_close(weight[:, 3], donor.patch_embed.proj.weight.mean(dim=1))


def test_imagenet_weights_of_another_size(tmp_path):
    save_weights(Swin(24, (2, 2, 2, 2), (1, 2, 4, 8)), tmp_path / "swin.safetensors")
    with pytest.raises(ToolkitError, match=r"patch_embed.proj.weight 24x3x4x4 instead of 16x3x4x4"):
        load_imagenet(SwinDRNetwork(TINY_SWIN), tmp_path / "swin.safetensors")


def by_hand(queries, keys, values):
    scores = queries @ keys.T / np.sqrt(queries.shape[1])
    shares = np.exp(scores - scores.max(axis=1, keepdims=True))
    return shares / shares.sum(axis=1, keepdims=True) @ values


def test_the_papers_fusion_is_its_formula():
    torch.manual_seed(0)
    fusion = PaperFusion(6, heads=1, window=None)
    color, depth = torch.randn(1, 3, 5, 6), torch.randn(1, 3, 5, 6)
    with torch.inference_mode():
        fusion.color_qkv.weight.normal_()
        fusion.depth_qkv.weight.normal_()
        found = fusion(color, depth)[0].reshape(15, 24).double().numpy()
        q_c, k_c, v_c = (
            fusion.color_qkv(color)
            .reshape(15, 18)
            .double()
            .numpy()
            .reshape(15, 3, 6)
            .transpose(1, 0, 2)
        )
        q_d, k_d, v_d = (
            fusion.depth_qkv(depth)
            .reshape(15, 18)
            .double()
            .numpy()
            .reshape(15, 3, 6)
            .transpose(1, 0, 2)
        )
    np.testing.assert_allclose(found[:, :6], by_hand(q_c, k_d, v_d), atol=1e-5)
    np.testing.assert_allclose(found[:, 6:12], by_hand(q_d, k_c, v_c), atol=1e-5)
    np.testing.assert_array_equal(found[:, 12:18], color.reshape(15, 6).double())
    np.testing.assert_array_equal(found[:, 18:], depth.reshape(15, 6).double())


def test_the_papers_fusion_sees_far_and_in_windows_near():
    color, depth = torch.randn(1, 16, 10, 8), torch.randn(1, 16, 10, 8)
    for window, reach in ((None, 160), (4, 16)):
        fusion = PaperFusion(8, heads=2, window=window)
        with torch.inference_mode():
            before = fusion(color, depth)
            other = depth.clone()
            other[0, 0, 0] += 1
            changed = (fusion(color, other)[..., :8] != before[..., :8]).any(dim=-1)
        assert changed.sum() == reach


def test_blending():
    depth, initial = torch.full((1, 1, 2, 2), 2.0), torch.full((1, 1, 2, 2), 1.0)
    logits = torch.tensor([0.0, np.log(3)]).reshape(1, 2, 1, 1).expand(1, 2, 2, 2).float()
    found = blended(depth, initial, logits)
    torch.testing.assert_close(found.confidence, torch.full((1, 1, 2, 2), 0.25))
    torch.testing.assert_close(found.depth, torch.full((1, 1, 2, 2), 1.25))


def test_a_relative_network_trusts_no_hole():
    torch.manual_seed(0)
    network = SwinDRNetwork(replace(TINY_SWIN, fusion="paper", relative=True)).train()
    depth = 0.5 + torch.rand(2, 1, 64, 64)
    hole = torch.zeros_like(depth, dtype=torch.bool)
    hole[..., 20:40, 10:50] = True
    found = network(torch.rand(2, 3, 64, 64), depth.masked_fill(hole, 0.0))
    assert (found.confidence[hole] == 0).all() and (found.confidence[~hole] > 0).all()
    assert torch.equal(found.depth[hole], found.initial[hole])
    found.depth.mean().backward()
    assert all(p.grad is None or p.grad.isfinite().all() for p in network.parameters())


@pytest.mark.parametrize("size", [(64, 64), (90, 61), (33, 47)])
def test_details_lead_back_to_every_pixel(size):
    encoder, decoder = DetailEncoder(3).eval(), DetailDecoder(8, 1, 2).eval()
    h, w = size
    details = encoder(torch.rand(1, 3, h, w))
    halves = [(h, w), (-(-h // 2), -(-w // 2)), (-(-h // 4), -(-w // 4))]
    assert [tuple(d.shape[-2:]) for d in details] == halves
    coarse = torch.rand(1, 8, -(-h // 8), -(-w // 8))
    with torch.inference_mode():
        before = decoder(coarse, details)
        assert before.shape == (1, 2, h, w)
        details[0][..., h // 2, w // 2] += 1
        changed = (decoder(coarse, details) != before).any(dim=1).nonzero()[:, 1:]
    assert abs(changed - torch.tensor([h // 2, w // 2])).max() == 1  # one pixel's edge stays sharp


def test_drop_path_keeps_the_mean():
    torch.manual_seed(0)
    tokens = torch.ones(4000, 3)
    dropped = drop_path(tokens, 0.25, training=True)
    torch.testing.assert_close(dropped.unique(), torch.tensor([0, 4 / 3]))
    assert (dropped.std(dim=1) == 0).all()
    assert abs(dropped.mean() - 1) < 0.05
    assert drop_path(tokens, 0.25, training=False) is tokens
