"""NLSPN's propagation against sums written out, and its sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from network_cases import CASES, frames
from torch import nn

from benchmark.methods.depth.nlspn import (
    PRESETS,
    NLSPNetwork,
    Propagation,
    load_imagenet,
    sample,
    sampling_places,
)
from benchmark.methods.network import parameter_count
from benchmark.methods.resnet import residual_layer
from std_toolkit.errors import ToolkitError

AROUND = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]


def bilinear(image: np.ndarray, y: float, x: float) -> float:
    """The image between its pixels, zero beyond them."""
    total = 0.0
    for row in (int(np.floor(y)), int(np.floor(y)) + 1):
        for column in (int(np.floor(x)), int(np.floor(x)) + 1):
            if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
                total += (1 - abs(y - row)) * (1 - abs(x - column)) * image[row, column]
    return total


def written_out(layer: Propagation, initial, guidance, confidence, sensor) -> np.ndarray:
    """The propagation pixel by pixel."""
    with torch.no_grad():
        numbers = layer.conv_offset_aff(guidance)[0].double().numpy()
    gamma = layer.aff_scale_const.item() + 1e-8
    h, w = initial.shape[-2:]
    depth, trust = initial[0, 0].double().numpy(), confidence[0, 0].double().numpy()
    given = sensor[0, 0].double().numpy()
    for _ in range(layer.steps):
        if layer.preserve_input:
            depth = np.where(given > 0, given, depth)
        new = np.zeros_like(depth)
        for y in range(h):
            for x in range(w):
                weights, values = [], []
                for index, (dy, dx) in enumerate(AROUND):
                    py = y + dy + numbers[2 * index, y, x]
                    px = x + dx + numbers[2 * index + 1, y, x]
                    affinity = np.tanh(numbers[16 + index, y, x]) / gamma
                    weights.append(affinity * bilinear(trust, py, px))
                    values.append(bilinear(depth, py, px))
                weights = np.array(weights) / max(1.0, np.abs(weights).sum() + 1e-4)
                new[y, x] = (1 - weights.sum()) * depth[y, x] + weights @ values
        depth = new
    return depth


@pytest.mark.parametrize("preserve_input", [False, True])
@pytest.mark.parametrize("strength", [0.1, 1.0])
def test_propagation_is_its_formula(preserve_input, strength):
    torch.manual_seed(0)
    layer = Propagation(steps=4, preserve_input=preserve_input)
    nn.init.normal_(layer.conv_offset_aff.weight, std=strength)
    with torch.no_grad():
        layer.aff_scale_const.fill_(1.5)
    initial, guidance = torch.rand(1, 1, 7, 9), torch.randn(1, 8, 7, 9)
    confidence = torch.rand(1, 1, 7, 9)
    sensor = torch.where(torch.rand(1, 1, 7, 9) < 0.2, 2.0, 0.0)
    with torch.no_grad():
        found = layer(initial, guidance, confidence, sensor)[0, 0].numpy()
    expected = written_out(layer, initial, guidance, confidence, sensor)
    assert abs(expected - initial[0, 0].numpy()).max() > 0.05
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_untrained_propagation_changes_nothing():
    layer = Propagation(steps=18, preserve_input=False)
    initial = torch.rand(2, 1, 6, 5)
    with torch.no_grad():
        found = layer(initial, torch.randn(2, 8, 6, 5), torch.rand(2, 1, 6, 5), initial * 0)
    torch.testing.assert_close(found, initial)


def test_without_offsets_the_neighbours_are_those_around():
    image = torch.arange(30.0).reshape(1, 1, 5, 6)
    found = sample(image, sampling_places(torch.zeros(1, 16, 5, 6)))[0]
    for index, (dy, dx) in enumerate(AROUND):
        torch.testing.assert_close(found[index, 2, 3], image[0, 0, 2 + dy, 3 + dx])
    assert found[0, 0, 0] == found[7, 4, 5] == 0  # beyond the edges


def test_the_sensors_depth_is_not_kept_unless_asked():
    assert not PRESETS["published"].preserve_input
    case = CASES["nlspn"]
    color, depth, _ = frames(1)
    found = {}
    for keeps in (False, True):
        network = NLSPNetwork(replace(case.config, preserve_input=keeps, steps=1)).eval()
        network.load_state_dict(case.make().state_dict())
        with torch.inference_mode():
            found[keeps] = network(color, depth)
    measured = depth > 0
    assert abs(found[True].depth - depth)[measured].mean() < (
        0.5 * abs(found[False].depth - depth)[measured].mean()
    )


def test_confidence_learns_through_the_weights_and_moves_no_neighbour():
    torch.manual_seed(0)
    layer = Propagation(steps=1, preserve_input=False)
    nn.init.normal_(layer.conv_offset_aff.weight, std=0.3)
    initial = torch.rand(1, 1, 6, 6)
    flat = torch.full_like(initial, 0.5)
    guidance = torch.randn(1, 8, 6, 6)
    # Of a flat image nothing changes with the offsets, unless confidence let them learn.
    confidence = torch.rand(1, 1, 6, 6, requires_grad=True)
    inside = torch.zeros_like(initial)
    inside[..., 2:4, 2:4] = 1
    (layer(flat * 0 + initial, guidance, confidence, initial) * inside).sum().backward()
    assert confidence.grad is not None and confidence.grad.any()
    layer.zero_grad()
    layer.conv_offset_aff.weight.data.mul_(0.1)  # all neighbours stay within the image
    (layer(flat, guidance, confidence.detach(), initial) * inside).sum().backward()
    gradient = layer.conv_offset_aff.weight.grad
    assert gradient is not None and abs(gradient[:16]).max() < 1e-6


def test_sizes():
    assert parameter_count(NLSPNetwork()) == 26_231_779
    assert parameter_count(NLSPNetwork(PRESETS["compact"])) == 2_264_195


def test_every_parameter_learns_once_propagation_has_an_effect():
    case = CASES["nlspn"]
    color, depth, truth = frames(2)
    fresh, stirred = NLSPNetwork(case.config).train(), case.make().train()
    still = {}
    for name, network in (("fresh", fresh), ("stirred", stirred)):
        abs(network(color, depth).depth - truth).mean().backward()
        still[name] = {
            key.partition(".")[0]
            for key, parameter in network.named_parameters()
            if parameter.grad is None or not parameter.grad.any()
        }
    assert still["stirred"] == set()
    # The first step of training moves affinities only: all else is multiplied by them.
    assert still["fresh"] == {"gd_dec0", "gd_dec1", "cf_dec0", "cf_dec1", "prop_layer"}


@pytest.mark.parametrize("size", [(64, 64), (37, 50)])
def test_any_size(size):
    network = CASES["nlspn"].make().eval()
    with torch.inference_mode():
        found = network(torch.rand(2, 3, *size), torch.rand(2, 1, *size))
    assert found.depth.shape == (2, 1, *size) and (found.depth >= 0).all()


def test_imagenet_weights(tmp_path):
    torch.manual_seed(3)
    layers = {
        "layer1": residual_layer(16, 16, 1),
        "layer2": residual_layer(16, 32, 1, stride=2),
        "layer3": residual_layer(32, 64, 1, stride=2),
        "layer4": residual_layer(64, 128, 1, stride=2),
    }
    state = nn.ModuleDict(layers).state_dict()
    state |= {"conv1.weight": torch.zeros(64, 3, 7, 7), "fc.weight": torch.zeros(1000, 512)}
    torch.save(state, tmp_path / "resnet.pth")
    network = CASES["nlspn"].make()
    load_imagenet(network, tmp_path / "resnet.pth")
    for old, new in (("layer1", "conv2"), ("layer4", "conv5")):
        for key, tensor in layers[old].state_dict().items():
            assert torch.equal(network.state_dict()[f"{new}.{key}"], tensor)
    with pytest.raises(ToolkitError, match="missing"):
        load_imagenet(NLSPNetwork(), tmp_path / "resnet.pth")
