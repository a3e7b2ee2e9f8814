"""The NOCS network's parts: pyramid, regions, detector, bins."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from safetensors.torch import save_file

from benchmark.methods.network import parameter_count
from benchmark.methods.pose.nocs.detector import (
    Boxes,
    Regions,
    boxes_of,
    boxes_of_ids,
    cell_middles,
    cut_out,
    detections_of,
    level_of,
    nearest_pixels,
    overlaps,
    places_of,
    put_back,
    without_doubles,
)
from benchmark.methods.pose.nocs.nocs import NOCSNetwork, coordinates_of, objects_of, of_class
from benchmark.methods.pose.nocs.nocs_backbone import (
    CLASSES,
    PRESETS,
    STRIDES,
    NOCSConfig,
    load_imagenet,
)
from benchmark.methods.protocol import PoseView
from benchmark.methods.registry import MethodOptions, make_pose_method
from benchmark.methods.weights import save_weights
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

TINY = NOCSConfig(
    block="basic",
    channels=8,
    blocks=(1, 1, 1, 1),
    pyramid=16,
    tower=1,
    region_channels=16,
    region_convs=1,
    input_size=(64, 48),
)
SETTINGS = {
    "channels": "8",
    "blocks": "1,1,1,1",
    "pyramid": "16",
    "tower": "1",
    "region_channels": "16",
    "region_convs": "1",
    "input_size": "64,48",
}


def regions_at(boxes: list[list[float]], image: list[int], class_ids: list[int]) -> Regions:
    n = len(boxes)
    return Regions(
        torch.tensor(boxes),
        torch.tensor(image),
        torch.tensor(class_ids),
        torch.ones(n),
        torch.arange(n),
    )


def test_sizes_of_the_presets():
    """ResNet-50's own 23.5 million, a pyramid, a detector and four heads of regions as published:
    4 x 256 channels, twice the size, a map for every class (and bin)."""
    with torch.device("meta"):
        network, compact = NOCSNetwork(PRESETS["published"]), NOCSNetwork(PRESETS["compact"])
    assert parameter_count(network.pyramid.backbone) == 23_508_032  # as torchvision's, without fc
    trunk = 4 * (256 * 256 * 9 + 3 * 256) + 256 * 256 * 4 + 256
    heads = [trunk + 257 * outputs for outputs in (CLASSES, *(3 * [32 * CLASSES]))]
    found = parameter_count(network.mask_head) + parameter_count(network.coordinate_heads)
    assert found == sum(heads)
    assert parameter_count(network) == 42_278_390
    assert parameter_count(compact) < 15_000_000


def test_weights_of_a_classifier_begin_the_backbone(tmp_path):
    backbone = NOCSNetwork(TINY).pyramid.backbone
    state = {k: torch.rand_like(t) for k, t in backbone.state_dict().items() if "num_" not in k}
    save_file({**state, "fc.weight": torch.rand(10, 64)}, tmp_path / "resnet.safetensors")
    load_imagenet(backbone, tmp_path / "resnet.safetensors")
    assert torch.equal(
        backbone.state_dict()["layer3.0.conv1.weight"], state["layer3.0.conv1.weight"]
    )
    del state["conv1.weight"]
    save_file(state, tmp_path / "cut.safetensors")
    with pytest.raises(ToolkitError, match=r"1 keys missing \(conv1\.weight\)"):
        load_imagenet(backbone, tmp_path / "cut.safetensors")


@pytest.mark.parametrize("stride", STRIDES)
def test_regions_of_a_ramp_are_its_values_at_the_cells(stride):
    """A level that holds x and y of its pixels: what is cut out must be those of the cells."""
    size, side = 768, 7
    levels = []
    for each in STRIDES:
        at = (torch.arange(size // each) + 0.5) * each - 0.5
        ramp = torch.stack(torch.meshgrid(at, at, indexing="xy"))[None]
        levels.append(ramp if each == stride else torch.zeros_like(ramp))
    width = 14.5 * stride
    boxes = torch.tensor([[30.0, 44.0, 30.0 + 1.2 * width, 44.0 + width]])
    found = cut_out(levels, boxes, torch.tensor([0]), STRIDES, side)[0]
    across, down = cell_middles(boxes, side)
    assert torch.allclose(found[0], across.expand(side, side), atol=1e-3)
    assert torch.allclose(found[1], down[0][:, None].expand(side, side), atol=1e-3)


def test_half_floats_do_not_move_regions():
    """A bright column one pixel wide: it must stay in its cell."""
    level = torch.zeros(1, 1, 192, 192, dtype=torch.bfloat16)
    level[..., 101] = 1
    levels = [level, *(torch.zeros(1, 1, 768 // s, 768 // s) for s in STRIDES[1:])]
    boxes = torch.tensor([[380.0, 380, 436, 436]]) - 0.5  # 14 pixels of this level, from 95
    found = cut_out(levels, boxes, torch.tensor([0]), STRIDES, 14)[0, 0]
    assert found[7].argmax() == 6
    assert float(found[7, 6]) == pytest.approx(0.75)  # two samples, each a quarter of a pixel off


def test_regions_are_of_their_images_and_levels():
    boxes = torch.tensor(
        [[0.0, 0, 50, 50], [0, 0, 60, 60], [0, 0, 120, 120], [0, 0, 230, 230], [0, 0, 900, 900]]
    )
    assert level_of(boxes, STRIDES).tolist() == [0, 0, 1, 2, 3]
    levels = [torch.stack([torch.full((1, 64 // s * 4, 64 // s * 4), 10.0 * b + i) for b in (0, 1)])
              for i, s in enumerate(STRIDES)]  # fmt: skip
    image = torch.tensor([0, 1, 1, 0, 1])
    found = cut_out(levels, boxes, image, STRIDES, 2)
    assert found[:, 0, 0, 0].tolist() == [0, 10, 11, 2, 13]


def test_what_is_put_back_is_where_it_was():
    """Maps cut out of an image by the nearest pixel, put back at the same boxes."""
    mask = torch.zeros(1, 60, 80)
    mask[0, 10:38, 20:48] = 1
    boxes = torch.tensor([[19.5, 9.5, 47.5, 37.5]])  # 28x28 pixels: a cell for each
    inside = nearest_pixels(boxes, torch.tensor([0]), mask, 28)
    assert (inside == 1).all()
    ramp = torch.rand(1, 2, 28, 28)
    for mode in ("nearest", "bilinear"):
        back = put_back(ramp, boxes, (80, 60), mode)
        assert back.shape == (1, 2, 60, 80)
        assert torch.allclose(back[0, :, 10:38, 20:48], ramp[0], atol=1e-4)
        assert back[0].abs().sum() == pytest.approx(float(ramp.abs().sum()), rel=1e-4)


def test_boxes_of_masks_are_those_of_loops():
    rng = np.random.default_rng(0)
    mask = rng.choice([0, 3, 7, 255], (2, 20, 30), p=[0.01, 0.01, 0.3, 0.68]).astype(np.uint8)
    boxes, counts = boxes_of_ids(torch.from_numpy(mask))
    for b in range(2):
        for number in range(256):
            y, x = np.nonzero(mask[b] == number)
            assert counts[b, number] == len(x)
            if len(x):
                expected = [x.min() - 0.5, y.min() - 0.5, x.max() + 0.5, y.max() + 0.5]
                assert boxes[b, number].tolist() == expected


def test_overlaps_and_doubles():
    boxes = torch.tensor([[0.0, 0, 10, 10], [1, 0, 11, 10], [0, 0, 10, 10], [20, 20, 30, 30]])
    found = overlaps(boxes, boxes)
    assert found[0, 1] == pytest.approx(90 / 110)
    assert found[0, 3] == 0
    assert found.diagonal().tolist() == [1, 1, 1, 1]
    # The second goes, the third is of another class.
    assert without_doubles(boxes, torch.tensor([0, 0, 1, 0]), 0.5).tolist() == [0, 2, 3]
    assert without_doubles(boxes, torch.tensor([0, 0, 1, 0]), 0.9).tolist() == [0, 1, 2, 3]


def test_detections_are_the_likely_ones():
    places = torch.cat(
        [places_of(4, 5, 8, torch.device("cpu")), places_of(2, 2, 16, torch.device("cpu"))]
    )
    assert places[0].tolist() == [3.5, 3.5]
    assert places[6].tolist() == [11.5, 11.5]
    classes = torch.full((2, 24, CLASSES), -9.0)
    edges = torch.full((2, 24, 4), 6.0)
    middles = torch.full((2, 24), 4.0)
    classes[0, 6, 2], classes[0, 7, 2], classes[0, 13, 6] = 4.0, 3.0, 2.0
    edges[0, 7] = torch.tensor([14.0, 6, -2, 6])  # the same box as that of place 6
    middles[0, 13] = -9
    strides = torch.tensor([8] * 20 + [16] * 4)
    found = detections_of(Boxes(classes, edges, middles, places, strides), TINY, (40, 14))
    assert found.class_ids.tolist() == [3]
    assert found.image.tolist() == [0]
    assert found.boxes.tolist() == [[5.5, 5.5, 17.5, 13.5]]  # ends with the image
    expected = math.sqrt(1 / (1 + math.exp(-4)) * 1 / (1 + math.exp(-4)))
    assert found.scores[0] == pytest.approx(expected)


def test_edges_and_boxes():
    places = torch.tensor([[3.5, 3.5]])
    assert boxes_of(torch.tensor([[1.0, 2, 3, 4]]), places).tolist() == [[2.5, 1.5, 6.5, 7.5]]


def test_maps_are_of_the_class_and_bins_tell_coordinates():
    maps = torch.arange(2 * 14).reshape(2, 14, 1, 1).float()
    assert of_class(maps, torch.tensor([1, 7]))[:, :, 0, 0].tolist() == [[0, 1], [26, 27]]
    bins = torch.zeros(1, 3, 32, 1, 1)
    bins[0, 0, 0], bins[0, 1, 16], bins[0, 2, 31] = 1, 1, 1
    assert coordinates_of(bins, "edge").flatten().tolist() == [0, 0.5, 31 / 32]
    assert coordinates_of(bins, "centre").flatten().tolist() == [1 / 64, 33 / 64, 63 / 64]


def test_a_batch_says_of_a_region_what_an_image_does():
    torch.manual_seed(0)
    network = NOCSNetwork(TINY).eval()
    color = torch.rand(2, 3, 48, 64)
    given = regions_at([[5.0, 5, 40, 40], [8, 3, 60, 30]], [0, 1], [2, 5])
    alone = regions_at([[8.0, 3, 60, 30]], [0], [5])
    with torch.no_grad():
        both, one = network(color, given), network(color[1:], alone)
    assert torch.allclose(both.bins[1:], one.bins, atol=1e-5)
    assert torch.allclose(both.masks[1:], one.masks, atol=1e-5)
    assert torch.allclose(both.boxes.edges[1:], one.boxes.edges, rtol=1e-4)
    objects = objects_of(both, 1, "centre", (64, 48))
    assert objects.segmented.class_ids.tolist() == ([5] if (both.masks[1] > 0).any() else [])


def test_views_where_nothing_is_found(tmp_path):
    torch.manual_seed(0)
    save_weights(NOCSNetwork(TINY), tmp_path / "w.safetensors")
    options = MethodOptions(preset="compact", weights=tmp_path / "w.safetensors", settings=SETTINGS)
    method = make_pose_method("nocs", options)
    assert method.input_size == (64, 48)
    flat = np.full((48, 64), 0.6, np.float32)
    view = PoseView(np.zeros((48, 64, 3), np.uint8), flat, flat, Camera(64, 48, 60, 60, 31.5, 23.5))
    found = method.estimate([view, view])
    assert [len(each.prediction.class_ids) for each in found] == [0, 0]
    assert found[0].masks.shape == (0, 48, 64)
    assert method.segment([view])[0].masks.shape == (0, 48, 64)
    assert method.estimate([]) == []
    assert method.macs(view) > 1e6


def test_another_methods_weights_are_refused(tmp_path):
    save_file({"conv1.weight": torch.rand(3)}, tmp_path / "w.safetensors")
    options = MethodOptions(preset="compact", weights=tmp_path / "w.safetensors", settings=SETTINGS)
    with pytest.raises(ToolkitError, match="weights of another network"):
        make_pose_method("nocs", options)
    with pytest.raises(ToolkitError, match="no such setting"):
        make_pose_method("nocs", MethodOptions(preset="compact", settings={"colour": "1"}))
