"""CompactDR: its encoder, the continuation of surfaces, and what it answers before any training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from network_cases import frames
from torch import nn
from torch.nn.functional import conv2d, pad, relu6

from benchmark.data.frame import BACKGROUND, Material
from benchmark.methods.depth.compactdr import (
    DEPTH_PARTS,
    MASK_PARTS,
    PRESETS,
    CompactDRConfig,
    CompactDRNetwork,
)
from benchmark.methods.depth.continuation import continued, main_plane
from benchmark.methods.depth.full_size import sensor_view, working_size
from benchmark.methods.efficientnet import CHANNELS, EfficientNetLite, load_imagenet
from benchmark.methods.weights import save_weights
from benchmark.restoring.restorer import Restorer
from benchmark.training.augmentation.holes import cut_holes
from benchmark.training.depth.compactdr_training import (
    WITHIN,
    CompactDRLoss,
    calibrate,
    compactdr_step,
)
from benchmark.training.step import ModelInput, StepInfo
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

STEPS = 80
SMALL = CompactDRConfig(
    depth_channels=(8, 8, 8, 8, 8), channels=(8, 8, 8, 8, 8), group=4, longest=448
)


def test_size_of_the_network():
    with torch.device("meta"):
        network = CompactDRNetwork(PRESETS["compact"])
    assert sum(p.numel() for p in network.parameters()) < 10e6
    assert not any(isinstance(m, nn.modules.batchnorm._BatchNorm) for m in network.modules())


# ---------------------------------------------------------------------------- encoder


def published(seed: int = 0) -> dict[str, torch.Tensor]:
    """Random weights with the keys of the published file, normalisation apart."""
    torch.manual_seed(seed)
    state: dict[str, torch.Tensor] = {}

    def norm(name: str, channels: int) -> None:
        state[f"{name}.weight"] = torch.rand(channels) + 0.5
        state[f"{name}.bias"] = 0.1 * torch.randn(channels)
        state[f"{name}.running_mean"] = 0.1 * torch.randn(channels)
        state[f"{name}.running_var"] = torch.rand(channels) + 0.5
        state[f"{name}.num_batches_tracked"] = torch.tensor(3)

    encoder = EfficientNetLite()
    state["_conv_stem.weight"] = torch.randn(32, 3, 3, 3) / 5
    norm("_bn0", 32)
    for number, block in enumerate(encoder.blocks):
        for name, layer, own in (
            ("_expand_conv", block.expand, "_bn0"),
            ("_depthwise_conv", block.depthwise, "_bn1"),
            ("_project_conv", block.project, "_bn2"),
        ):
            if layer is not None:
                shape = layer.weight.shape
                state[f"_blocks.{number}.{name}.weight"] = (
                    torch.randn(shape) / shape[1:].numel() ** 0.5
                )
                norm(f"_blocks.{number}.{own}", shape[0])
    state["_conv_head.weight"] = torch.zeros(1280, 320, 1, 1)
    norm("_bn1", 1280)
    state["_fc.weight"], state["_fc.bias"] = torch.zeros(1000, 1280), torch.zeros(1000)
    return state


def reference(state: dict[str, torch.Tensor], color: torch.Tensor) -> torch.Tensor:
    """The last level, computed from the published form layer by layer."""

    def normed(x: torch.Tensor, name: str) -> torch.Tensor:
        mean, var = state[f"{name}.running_mean"], state[f"{name}.running_var"]
        x = (x - mean[:, None, None]) / (var[:, None, None] + 1e-3).sqrt()
        return x * state[f"{name}.weight"][:, None, None] + state[f"{name}.bias"][:, None, None]

    def same(x: torch.Tensor, weight: torch.Tensor, stride: int, groups: int) -> torch.Tensor:
        kernel, sizes = weight.shape[-1], x.shape[-1:-3:-1]
        total = [max((-(-n // stride) - 1) * stride + kernel - n, 0) for n in sizes]
        around = [part for t in total for part in (t // 2, t - t // 2)]
        return conv2d(pad(x, around), weight, stride=stride, groups=groups)

    strides = {1: 2, 3: 2, 5: 2, 11: 2}  # of blocks by number
    x = relu6(normed(same((255 * color - 127) / 128, state["_conv_stem.weight"], 2, 1), "_bn0"))
    for number in range(16):
        key, before = f"_blocks.{number}", x
        if f"{key}._expand_conv.weight" in state:
            x = relu6(normed(conv2d(x, state[f"{key}._expand_conv.weight"]), f"{key}._bn0"))
        weight = state[f"{key}._depthwise_conv.weight"]
        x = relu6(normed(same(x, weight, strides.get(number, 1), len(weight)), f"{key}._bn1"))
        x = normed(conv2d(x, state[f"{key}._project_conv.weight"]), f"{key}._bn2")
        if x.shape == before.shape:
            x = x + before
    return x


def test_published_weights_give_the_published_answer(tmp_path):
    state = published()
    torch.save(state, tmp_path / "lite0.pth")
    encoder = EfficientNetLite().eval()
    load_imagenet(encoder, tmp_path / "lite0.pth")
    color = torch.rand(2, 3, 64, 96)
    with torch.inference_mode():
        levels, wanted = encoder(color), reference(state, color)
    assert [level.shape[1] for level in levels] == list(CHANNELS)
    assert [level.shape[2:] for level in levels] == [(64 >> k, 96 >> k) for k in range(1, 6)]
    torch.testing.assert_close(levels[-1], wanted, rtol=1e-3, atol=1e-4 * float(wanted.abs().max()))


def test_another_network_is_refused(tmp_path):
    state = {key: t for key, t in published().items() if not key.startswith("_blocks.15")}
    torch.save(state, tmp_path / "cut.pth")
    with pytest.raises(ToolkitError, match=r"cut\.pth"):
        load_imagenet(EfficientNetLite(), tmp_path / "cut.pth")


# ---------------------------------------------------------------------------- continuation


def table(w: int, h: int) -> torch.Tensor:
    v, u = torch.meshgrid(torch.arange(h) / h, torch.arange(w) / w, indexing="ij")
    return (1 / (1.6 + 0.9 * (v - 0.5) + 0.3 * (u - 0.5)))[None, None]


def disc(w: int, h: int, diameter: float, at: tuple[float, float] = (0.5, 0.6)) -> torch.Tensor:
    v, u = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    return (u - at[0] * w) ** 2 + (v - at[1] * h) ** 2 < (diameter * w / 2) ** 2


@pytest.mark.parametrize("size", [(224, 126), (320, 240), (126, 224)])
@pytest.mark.parametrize("at", [(0.5, 0.6), (0.0, 0.5), (1.0, 1.0)])
def test_a_plane_goes_on_exactly(size, at):
    depth, hole = table(*size), disc(*size, 0.2, at)
    found = continued(depth.masked_fill(hole, 0.0), torch.ones_like(depth))
    assert (found - depth).abs().max() < 5e-4


def test_a_plane_goes_on_under_objects_that_are_not_trusted():
    depth = table(160, 120)
    thing = disc(160, 120, 0.3)
    seen = torch.where(thing, depth - 0.1, depth)
    found = continued(seen, (~thing).float()[None, None])
    assert (found - depth)[0, 0][thing].abs().max() < 5e-4
    # The plane is that of the table where an object is trusted.
    plane = main_plane(1 / seen, torch.ones_like(seen))
    assert (1 / plane - depth)[0, 0][~thing].abs().median() < 0.002


def test_nothing_to_continue():
    nothing = torch.zeros(1, 1, 40, 60)
    assert torch.equal(continued(nothing, torch.ones_like(nothing)), torch.ones_like(nothing))
    flat = torch.full((1, 1, 40, 60), 0.7)
    found = continued(flat, torch.zeros_like(flat))
    assert found.isfinite().all() and (found > 0).all()


def test_the_continuation_learns_whom_to_trust():
    depth = table(64, 48)
    seen = depth.masked_fill(disc(64, 48, 0.3), 0.0)
    seen[..., 20:24, 40:44] += 0.3
    weight = torch.full_like(depth, 0.5, requires_grad=True)
    (continued(seen, weight) - depth).abs().mean().backward()
    assert weight.grad is not None and weight.grad.isfinite().all()
    assert (weight.grad[..., 21:23, 41:43] > 0).all()  # less trust there is better


# ---------------------------------------------------------------------------- network


@pytest.mark.parametrize("size", [(224, 126), (160, 120), (90, 160)])
def test_a_hole_in_a_table_stays_a_table(size):
    torch.manual_seed(0)
    network = CompactDRNetwork(SMALL).eval()
    depth, hole = table(*size), disc(*size, 0.2)
    with torch.inference_mode():
        found = network(torch.rand(1, 3, *size[::-1]), depth.masked_fill(hole, 0.0))
    assert found.depth.shape == depth.shape
    assert (found.depth - depth).abs().max() < 0.005


def batch_of(depth: torch.Tensor, truth: torch.Tensor) -> dict[str, torch.Tensor]:
    """What the sensor has wrong is glass above, and metal below."""
    b, _, h, w = truth.shape
    wrong = ((depth - truth).abs() > 0.01)[:, 0]
    lower = torch.arange(h)[:, None] >= h // 2
    mask = torch.where(wrong, 1 + lower.int(), BACKGROUND).to(torch.uint8)
    materials = torch.full((b, 256), 255, dtype=torch.uint8)
    materials[:, 1], materials[:, 2] = Material.TRANSPARENT, Material.SPECULAR
    K = torch.tensor([[80.0, 0, w / 2], [0, 80, h / 2], [0, 0, 1]]).expand(b, 3, 3)
    return {"true": truth[:, 0], "mask": mask, "materials": materials, "K": K}


def test_every_parameter_learns():
    torch.manual_seed(0)
    network = CompactDRNetwork(SMALL).train()
    found = compactdr_step(network, CompactDRLoss(), learning_inputs(), StepInfo())
    assert found.total.isfinite() and len(found.parts) == 10
    found.total.backward()
    for key, parameter in network.named_parameters():
        assert parameter.grad is not None and parameter.grad.any(), key


def learning_inputs() -> ModelInput:
    color, depth, truth = frames(4)
    return ModelInput(color, depth, batch_of(depth, truth))


def test_two_thirds_of_the_errors_lie_within_one_spread():
    torch.manual_seed(1)
    network, inputs = CompactDRNetwork(SMALL), learning_inputs()
    noise = 0.002 * torch.randn_like(inputs.depth) * (inputs.depth > 0)
    inputs = inputs._replace(depth=inputs.depth + noise)
    batch = dict(inputs.batch) | {
        "color": (255 * inputs.color).byte().permute(0, 2, 3, 1), "raw": inputs.depth[:, 0]
    }  # fmt: skip
    calibrate(network, [batch])
    network.eval()
    with torch.inference_mode():
        looked = network.look(inputs.color, cut_holes(inputs, 1.0))
    true = inputs.batch["true"][:, None]
    within = (looked.depth - true).abs() <= 2**0.5 * looked.spread
    assert float(within[true > 0].float().mean()) == pytest.approx(WITHIN, abs=0.08)
    with torch.inference_mode():  # training sees what the network itself says
        assert not torch.equal(
            network.train().look(inputs.color, inputs.depth).spread, looked.spread
        )


@pytest.mark.parametrize("phase", ["mask", "encoder", "depth"])
def test_phases_train_their_parts(phase):
    network = CompactDRNetwork(SMALL)
    found = compactdr_step(network, CompactDRLoss(), learning_inputs(), StepInfo(phase, 0, 1))
    found.total.backward()
    learning = {n.split(".")[0] for n, p in network.named_parameters() if p.grad is not None}
    assert ("encoder" in learning) == (phase == "encoder")
    assert ("mask_at" in learning) == (phase != "depth")
    assert ("last" in learning) == (phase == "depth")
    every = [name for name, _ in network.named_children()]
    assert sorted(every) == sorted(("encoder", *MASK_PARTS, *DEPTH_PARTS))


@pytest.mark.long
def test_four_frames_are_learned_by_their_colour():
    torch.manual_seed(0)
    network = CompactDRNetwork(replace(SMALL, channels=(16, 16, 16, 16, 16))).train()
    color, depth, truth = frames(4)
    inputs = ModelInput(color, depth, batch_of(depth, truth))
    optimizer = torch.optim.AdamW(network.parameters(), 2e-3, weight_decay=0)
    for _ in range(STEPS):
        optimizer.zero_grad()
        compactdr_step(network, CompactDRLoss(), inputs, StepInfo()).total.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
    network.eval()
    with torch.inference_mode():
        found = (network(color, depth).depth - truth).abs().mean()
        noise = (network(torch.rand_like(color), depth).depth - truth).abs().mean()
    assert found < 0.4 * (continued(depth, torch.ones_like(depth)) - truth).abs().mean()
    assert found < 0.7 * noise


def test_any_size_goes_in_and_comes_out(tmp_path):
    torch.manual_seed(0)
    save_weights(CompactDRNetwork(SMALL), tmp_path / "small.safetensors")
    settings = {"depth_channels": "8,8,8,8,8", "channels": "8,8,8,8,8", "group": "4"}
    restorer = Restorer.load(
        "compactdr", preset="compact", weights=tmp_path / "small.safetensors",
        settings=settings | {"longest": "160"},
    )  # fmt: skip
    for width, height in ((120, 90), (320, 240), (180, 320)):
        depth, hole = table(width, height)[0, 0], disc(width, height, 0.1)
        raw = depth.masked_fill(hole, 0.0).numpy()
        color = np.full((height, width, 3), 90, np.uint8)
        found = restorer.restore(color, raw, (width, width, width / 2, height / 2))
        assert found.depth.shape == (height, width)
        assert np.abs(found.depth - depth.numpy()).max() < 0.005
    assert working_size(restorer.method, (180, 320)) == (90, 160)
    view = sensor_view(color, raw, Camera(width, height, width, width, width / 2, height / 2))
    (answer,) = restorer.method.restore([view])
    assert answer.spread is not None and answer.spread.shape == (height, width)
    assert (answer.spread > 0).all()
