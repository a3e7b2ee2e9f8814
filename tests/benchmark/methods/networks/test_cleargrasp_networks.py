"""ClearGrasp's networks: sizes, keys, learning; and the restorer around them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from network_cases import CASES, views, weights_of
from torch import nn

from benchmark.methods.depth.cleargrasp import join
from benchmark.methods.depth.cleargrasp.cleargrasp import ClearGrasp
from benchmark.methods.depth.cleargrasp.cleargrasp_network import (
    PRESETS,
    ClearGraspConfig,
    ClearGraspMaps,
    ClearGraspNetwork,
)
from benchmark.methods.network import parameter_count
from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.methods.weights import architecture_of, load_weights, save_weights
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, pixel_rays

TINY = ClearGraspConfig(
    width=2,
    bottleneck=False,
    blocks=(1, 1, 1, 1, 1, 1, 1, 1),
    head_channels=8,
    input_size=(64, 64),
    depth_size=(64, 36),
)
SETTINGS = {
    "width": "2",
    "bottleneck": "false",
    "blocks": "1,1,1,1,1,1,1,1",
    "head_channels": "8",
    "input_size": "64,64",
    "depth_size": "64,36",
}
PARTS = ("masks", "normals", "boundaries")


def tiny(seed: int = 0, config: ClearGraspConfig = TINY) -> ClearGraspNetwork:
    torch.manual_seed(seed)
    return ClearGraspNetwork(config)


def restorer(folder, weights=None, **settings) -> ClearGrasp:
    if weights is None:
        weights = folder / "cleargrasp.safetensors"
        save_weights(tiny(), weights)
    made = make_restorer("cleargrasp", MethodOptions(weights=weights, settings=SETTINGS | settings))
    assert isinstance(made, ClearGrasp)
    return made


@pytest.mark.slow
def test_sizes():
    with torch.device("meta"):
        network, compact = ClearGraspNetwork(), ClearGraspNetwork(PRESETS["compact"])
    # DRN-D-54, whose classifier of 513,000 more numbers makes the 35.8 million of its paper.
    assert parameter_count(network.masks.backbone) == 35_296_176 == 35_809_176 - 513_000
    assert [parameter_count(network.get_submodule(name)) for name in PARTS] == [
        40_732_178,
        40_732_435,
        40_732_435,
    ]
    assert parameter_count(compact) == 13_720_624 < 15_000_000


def test_keys_of_the_published_weights():
    with torch.device("meta"):
        network = ClearGraspNetwork()
    keys = {name: network.get_submodule(name).state_dict() for name in PARTS}
    for key, shape in {
        "backbone.layer0.0.weight": (16, 3, 7, 7),
        "backbone.layer1.0.weight": (16, 16, 3, 3),
        "backbone.layer3.0.downsample.0.weight": (256, 32, 1, 1),
        "backbone.layer5.5.conv3.weight": (1024, 256, 1, 1),
        "backbone.layer6.2.bn2.running_var": (512,),
        "backbone.layer8.1.weight": (512,),
        "aspp.aspp4.atrous_conv.weight": (256, 512, 3, 3),
        "aspp.global_avg_pool.1.weight": (256, 512, 1, 1),
        "aspp.conv1.weight": (256, 1280, 1, 1),
        "decoder.conv1.weight": (48, 256, 1, 1),
        "decoder.last_conv.0.weight": (256, 304, 3, 3),
        "decoder.last_conv.4.weight": (256, 256, 3, 3),
    }.items():
        for name in PARTS:
            assert keys[name][key].shape == shape, key
    assert keys["masks"]["decoder.last_conv.8.bias"].shape == (2,)
    assert keys["normals"]["decoder.last_conv.7.bias"].shape == (3,)
    assert keys["boundaries"]["decoder.last_conv.8.bias"].shape == (3,)


@pytest.mark.parametrize("bottleneck", [False, True])
def test_strides_reaches_and_dilations(bottleneck):
    network = tiny(config=replace(TINY, bottleneck=bottleneck)).eval()
    with torch.inference_mode():
        features, fine = network.masks.backbone(torch.rand(1, 3, 64, 80))
    assert features.shape == (1, 64, 8, 10)
    assert fine.shape == (1, 32 if bottleneck else 8, 16, 20)
    middle = network.masks.backbone.layer6[0].conv2
    assert middle.dilation == (4, 4) and middle.stride == (1, 1)
    assert [
        network.masks.aspp.get_submodule(f"aspp{i}").atrous_conv.dilation[0] for i in (1, 2, 3, 4)
    ] == [1, 12, 24, 36]


@pytest.mark.parametrize("size", [(64, 64), (50, 70)])
def test_maps(size):
    with torch.inference_mode():
        maps = tiny().eval()(torch.rand(2, 3, *size))
    assert maps.masks.shape == (2, 2, *size) and maps.boundaries.shape == (2, 3, *size)
    torch.testing.assert_close(maps.normals.norm(dim=1), torch.ones(2, *size))


def labelled(count: int, seed: int = 0) -> tuple[torch.Tensor, ...]:
    """Colour; mask, normals and boundaries of boxes on a floor."""
    random = np.random.default_rng(seed)
    colors, masks, normals, boundaries = [], [], [], []
    for _ in range(count):
        color = np.tile(np.linspace(0.2, 0.8, 64), (3, 64, 1))
        mask = np.zeros((64, 64), np.uint8)
        top, left = random.integers(8, 32, 2)
        mask[top : top + 20, left : left + 22] = 1
        color[:, mask > 0] = random.uniform(0, 1, (3, 1))
        edge = cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8))
        edge[top + 17 :] *= 2  # where the box touches the floor
        flat, steep = [[[v]] for v in (0, 0.8, 0.6)], [[[v]] for v in (0, 0, 1.0)]
        colors.append(color)
        masks.append(mask)
        normals.append(np.where(mask, steep, flat))
        boundaries.append(edge)
    return (
        torch.tensor(np.stack(colors), dtype=torch.float32),
        torch.tensor(np.stack(masks)).long(),
        torch.tensor(np.stack(normals), dtype=torch.float32),
        torch.tensor(np.stack(boundaries)).long(),
    )


def losses(maps: ClearGraspMaps, labels: tuple[torch.Tensor, ...]) -> torch.Tensor:
    masks, normals, boundaries = labels
    return torch.stack(
        [
            nn.functional.cross_entropy(maps.masks, masks),
            (1 - (maps.normals * normals).sum(dim=1)).mean(),
            nn.functional.cross_entropy(maps.boundaries, boundaries),
        ]
    )


@pytest.mark.parametrize("bottleneck", [False, True])
def test_every_parameter_learns(bottleneck):
    network = tiny(config=replace(TINY, bottleneck=bottleneck)).train()
    color, *labels = labelled(2)
    losses(network(color), tuple(labels)).sum().backward()
    for key, parameter in network.named_parameters():
        assert parameter.grad is not None and parameter.grad.any(), key


@pytest.mark.long  # in short: test_training_learns of test_training_fit.py
@pytest.mark.slow
def test_four_frames_are_learned():
    """Each of the three losses falls to a fifth."""
    network = tiny(config=replace(TINY, width=4, head_channels=16)).train()
    for module in network.modules():
        if isinstance(module, nn.Dropout):
            module.p = 0.0  # whatever is learned by heart is not dropped
    color, *labels = labelled(4)
    steps, rate = 150, 1e-2
    optimizer = torch.optim.AdamW(network.parameters(), rate, weight_decay=0)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, steps)
    found = []
    for _ in range(steps):
        parts = losses(network(color), tuple(labels))
        optimizer.zero_grad()
        parts.sum().backward()
        optimizer.step()
        schedule.step()
        found.append(parts.detach())
    assert (found[-1] < 0.2 * found[0]).all(), (found[0], found[-1])
    network.eval()
    with torch.inference_mode():
        maps = network(color)
    right = (maps.masks.argmax(dim=1) == labels[0]).float().mean()
    assert right > 0.95


class Knowing(nn.Module):
    """In the place of the networks: what is true of a scene."""

    def __init__(self, maps: ClearGraspMaps) -> None:
        super().__init__()
        self.maps = maps

    def forward(self, color):
        assert color.shape[-2:] == (64, 64) and color.max() <= 1
        return self.maps


def floor(size: tuple[int, int] = (64, 36)) -> tuple[View, np.ndarray, ClearGraspMaps]:
    """A slanted floor with a patch whose depth is wrong; its depth; what is true of it."""
    w, h = size
    camera = Camera(w, h, w, w, w / 2 - 0.5, h / 2 - 0.5)
    normal = np.array([0.0, -0.6, -0.8])  # y down
    depth = (-0.6 / (pixel_rays(camera) @ normal)).astype(np.float32)
    wrong = depth.copy()
    patch = np.s_[h // 3 : h // 2, w // 3 : w // 2]
    mask = np.zeros((h, w), dtype=bool)
    mask[patch] = True
    wrong[mask] += 0.1
    logits = torch.from_numpy(mask).float()[None, None]
    logits = nn.functional.interpolate(logits, size=(64, 64)) * 20 - 10
    maps = ClearGraspMaps(
        torch.cat([-logits, logits], dim=1),
        torch.tensor([0.0, 0.6, 0.8]).reshape(1, 3, 1, 1).expand(1, 3, 64, 64),
        torch.tensor([10.0, -10.0, -10.0]).reshape(1, 3, 1, 1).expand(1, 3, 64, 64),
    )
    return View(np.full((h, w, 3), 128, np.uint8), wrong, camera, mask), depth, maps


@pytest.mark.parametrize("mask", ["predicted", "given"])
@pytest.mark.parametrize("size", [(64, 36), (192, 108), (160, 120)])
def test_true_normals_and_masks_restore_a_floor(tmp_path, size, mask):
    view, truth, maps = floor(size)
    method = restorer(tmp_path, mask=mask)
    assert method.needs_mask == (mask == "given") and method.input_size is None
    if mask == "given":  # what the network says of it does not count
        maps = maps._replace(masks=-maps.masks)
    method._run = Knowing(maps)
    (answer,) = method.restore([view])
    assert answer.depth.dtype == np.float32 and answer.depth.shape == truth.shape
    assert abs(view.depth - truth).max() > 0.09
    # At the size of the optimisation to a hair; of larger views by the slope of one of its pixels.
    coarse = 1e-5 if size == (64, 36) else 0.02
    assert abs(answer.depth - truth)[view.mask].max() < coarse
    far = cv2.dilate(view.mask.astype(np.uint8), np.ones((25, 25))) == 0
    np.testing.assert_array_equal(answer.depth[far], view.depth[far])


def test_an_occlusion_boundary_loosens_and_a_contact_edge_does_not(tmp_path):
    view, _, maps = floor()
    depth = {}
    ring = cv2.morphologyEx(view.mask.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3)))
    around = nn.functional.interpolate(torch.from_numpy(ring).float()[None, None], size=(64, 64))
    # Inside the patch another surface, whose normals do not lead to the depths around it.
    inside = maps.masks[:, 1:] > 0
    maps = maps._replace(normals=torch.where(inside, -maps.normals.flip(1) + 1.4, maps.normals))
    maps = maps._replace(normals=nn.functional.normalize(maps.normals, dim=1))
    for name, channel in (("occlusion", 1), ("contact", 2)):
        boundaries = maps.boundaries.clone()
        boundaries[:, channel] = torch.where(around[:, 0] > 0, 30.0, -10.0)
        method = restorer(tmp_path)
        method._run = Knowing(maps._replace(boundaries=boundaries))
        depth[name] = method.restore([view])[0].depth
    method._run = Knowing(maps)
    plain = method.restore([view])[0].depth
    np.testing.assert_allclose(depth["contact"], plain, atol=1e-6)
    assert abs(depth["occlusion"] - plain).max() > 1e-3


def test_by_name_with_weights(tmp_path):
    some = views(2)
    method = restorer(tmp_path)
    answers = method.restore(some)
    assert all(np.isfinite(a.depth).all() and (a.depth >= 0).all() for a in answers)
    alone = method.restore(some[1:])[0].depth
    np.testing.assert_allclose(answers[1].depth, alone, rtol=1e-4, atol=1e-5)
    assert method.parameter_count == parameter_count(tiny())
    assert method.macs(some[0]) > 100_000
    assert method.restore([]) == []


def test_depth_that_is_all_missing_or_all_there(tmp_path):
    some = views(3)
    some[0].depth[:] = 0
    some[1].depth[:] = np.nan
    some[2].depth[:] = 0.7
    answers = restorer(tmp_path).restore(some)
    assert not answers[0].depth.any() and not answers[1].depth.any()
    assert np.isfinite(answers[2].depth).all()
    given = restorer(tmp_path, mask="given")
    full = replace(some[2], mask=np.zeros(some[2].depth.shape, dtype=bool))
    np.testing.assert_array_equal(given.restore([full])[0].depth, full.depth)
    doubted = replace(some[2], mask=np.ones(some[2].depth.shape, dtype=bool))
    assert not given.restore([doubted])[0].depth.any()


def test_wrong_options(tmp_path):
    with pytest.raises(ToolkitError, match="has no mask"):
        restorer(tmp_path, mask="given").restore(views(1))
    with pytest.raises(ToolkitError, match="grow_px: must not be negative"):
        restorer(tmp_path, grow_px="-1")
    with pytest.raises(ToolkitError, match="no such device"):
        make_restorer("cleargrasp", MethodOptions(device="cuda:99"))


def test_narrow_arithmetic_is_near(tmp_path):
    weights = tmp_path / "w.safetensors"
    save_weights(tiny(), weights)
    options = MethodOptions(weights=weights, settings=SETTINGS, precision="bf16")
    (narrow,) = make_restorer("cleargrasp", options).restore(views(1))
    (whole,) = restorer(tmp_path, weights).restore(views(1))
    assert np.isfinite(narrow.depth).all()
    assert np.median(abs(narrow.depth - whole.depth)) < 0.02


def test_round_trip_and_weights_of_others(tmp_path):
    first, second = tiny(1), tiny(2)
    path = tmp_path / "a.safetensors"
    save_weights(first, path)
    load_weights(second, path)
    for (key, one), other in zip(
        first.state_dict().items(), second.state_dict().values(), strict=True
    ):
        assert torch.equal(one, other), key
    assert architecture_of(first.state_dict()) == "ClearGrasp"
    with pytest.raises(ToolkitError, match="they look like those of DFNet"):
        restorer(tmp_path, weights_of(CASES["dfnet"], tmp_path))
    with pytest.raises(ToolkitError, match="they look like those of ClearGrasp"):
        make_restorer("dfnet", MethodOptions(weights=path, settings=CASES["dfnet"].settings))
    with pytest.raises(ToolkitError, match="of another size"):
        restorer(tmp_path, path, width="4")
    save_weights(first.normals, tmp_path / "normals.safetensors")
    with pytest.raises(ToolkitError, match="one of ClearGrasp's three"):
        restorer(tmp_path, tmp_path / "normals.safetensors")


def test_three_published_files_become_one(tmp_path):
    network = tiny(5)
    paths = [tmp_path / f"checkpoint_{name}.pth" for name in PARTS]
    for name, path in zip(PARTS, paths, strict=True):
        state = network.get_submodule(name).state_dict()
        torch.save({"model_state_dict": state, "epoch": 7, "config": {"a": 1}}, path)
    joined = tmp_path / "all.safetensors"
    join.join_weights(*paths, joined, TINY)
    (one,) = restorer(tmp_path, joined).restore(views(1))
    save_weights(network, tmp_path / "whole.safetensors")
    (other,) = restorer(tmp_path, tmp_path / "whole.safetensors").restore(views(1))
    np.testing.assert_array_equal(one.depth, other.depth)
    # Masks have two classes, normals three channels: they cannot be taken for one another.
    with pytest.raises(ToolkitError, match="of another shape"):
        join.join_weights(paths[2], paths[1], paths[2], joined, TINY)


def test_joining_as_a_command_refuses_in_one_line(tmp_path, monkeypatch, capsys):
    arguments = ["join", "a.pth", "b.pth", "c.pth", str(tmp_path / "all.safetensors")]
    monkeypatch.setattr("sys.argv", [*arguments, "--preset", "compact"])
    with pytest.raises(SystemExit) as stopped:
        join.main()
    assert stopped.value.code == 1
    assert "a.pth: no such file of weights" in capsys.readouterr().err
    assert not (tmp_path / "all.safetensors").exists()
