"""SPD and SGPA: crops, sizes as published, what every part of the networks has to do."""

import numpy as np
import pytest
import torch
from boxes_in_view import CAR, MUG, WIDTH, batch_of, boxes_of, view_of_boxes, write_priors

from benchmark.methods.network import parameter_count
from benchmark.methods.pose.deformation import PerCategory
from benchmark.methods.pose.segmented import LEAST_PIXELS, crop_object, stacked
from benchmark.methods.pose.sgpa import PRESETS as SGPA
from benchmark.methods.pose.sgpa import Adaptation, SGPANetwork, Structure, StructurePoints
from benchmark.methods.pose.spd import PRESETS as SPD
from benchmark.methods.pose.spd import PatchFeatures, SPDNetwork
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import configured

SMALL = {
    "prior_points": "64",
    "side": "32",
    "points": "80",
    "color_width": "8",
    "color_decoder": "8,8,8,8",
    "color": "16",
    "geometry": "16",
    "width": "32",
    "hidden": "32,16",
}
SMALL_SGPA = {"centres": "32,16,8,4", "thickness": "16", "structure": "12"}
SMALL_SGPA["structure_widths"] = "16,16"


@pytest.fixture(scope="module")
def priors(tmp_path_factory):
    return write_priors(tmp_path_factory.mktemp("priors") / "p.safetensors")


@pytest.fixture
def network(request, priors):
    torch.manual_seed(0)
    if request.param == "spd":
        return SPDNetwork(configured(SPD["compact"], {**SMALL, "priors": str(priors)}))
    settings = {**SMALL, **SMALL_SGPA, "priors": str(priors)}
    return SGPANetwork(configured(SGPA["compact"], settings))


both = pytest.mark.parametrize("network", ["spd", "sgpa"], indirect=True)


def _inputs(config, b=3, seed=0):
    g = torch.Generator().manual_seed(seed)
    color = torch.rand(b, 3, config.side, config.side, generator=g)
    points = torch.randn(b, config.points, 3, generator=g) * 0.05 + torch.tensor([0, 0, 0.8])
    pixels = torch.randint(config.side**2, (b, config.points), generator=g)
    return color, points, pixels, torch.tensor([4, 5, 0])[:b]


def _crop(view, number, **changes):
    options = {"side": 40, "points": 200, "generator": torch.Generator().manual_seed(0)}
    mask = torch.from_numpy(view.truth.mask == number)
    color = torch.from_numpy(view.color).permute(2, 0, 1) / 255
    K = torch.from_numpy(view.camera.K).float()
    return crop_object(color, torch.from_numpy(view.depth), mask, K, **{**options, **changes})


def test_points_of_a_crop_are_the_pixels_of_the_object():
    view = view_of_boxes(boxes_of(0))
    crop = _crop(view, 2)
    chosen = crop.chosen.numpy()
    assert (view.truth.mask.flat[chosen] == 2).all()
    rays = view.camera.rays().reshape(-1, 3)[chosen]
    wanted = rays * view.depth.flat[chosen][:, None]
    np.testing.assert_allclose(crop.points, wanted, atol=1e-6)


def test_a_points_pixel_in_the_patch_has_its_colour():
    """Sides of a box are of one colour: away from edges, both show the same."""
    view = view_of_boxes(boxes_of(0))
    crop = _crop(view, 1, side=160)
    patch = (crop.color.flatten(1)[:, crop.pixels] * 255).T.numpy()
    image = view.color.reshape(-1, 3)[crop.chosen]
    agree = (np.abs(patch - image).max(axis=1) < 60).mean()
    assert agree > 0.9


def test_a_crop_reaches_beyond_the_image_where_its_object_does():
    view = view_of_boxes(boxes_of(0))
    mask = torch.zeros(view.depth.shape, dtype=torch.bool)
    mask[20:60, :6] = True
    K = torch.from_numpy(view.camera.K).float()
    depth = torch.ones(view.depth.shape)
    color = torch.ones(3, *view.depth.shape)
    crop = crop_object(color, depth, mask, K, side=44, points=50)
    # The square is 44 pixels wide around column 3: its left 19 columns are outside.
    assert (crop.color[:, :, :18] == 0).all() and (crop.color[:, 3:-3, 20:] == 1).all()
    column = crop.chosen % WIDTH
    assert torch.equal(crop.pixels % 44, column + 19)


def test_points_are_repeated_only_where_pixels_are_few():
    view = view_of_boxes(boxes_of(0))
    there = int((view.truth.mask == 1).sum())
    few, many = _crop(view, 1, points=there - 5), _crop(view, 1, points=2 * there)
    assert len(few.chosen.unique()) == there - 5
    assert (torch.bincount(many.chosen)[many.chosen.unique()] == 2).all()


def test_an_object_without_depth_gives_no_crop():
    view = view_of_boxes(boxes_of(0))
    depth = torch.zeros(view.depth.shape)
    mask = torch.from_numpy(view.truth.mask == 1)
    place = mask.nonzero()[: LEAST_PIXELS - 1]
    depth[place[:, 0], place[:, 1]] = 0.5
    depth[0, 0] = torch.nan
    K = torch.from_numpy(view.camera.K).float()
    color = torch.zeros(3, *depth.shape)
    assert crop_object(color, depth, mask, K, side=32, points=50) is None


def test_each_category_has_its_own_last_layer():
    layer = PerCategory(4, 3, 5)
    features, category = torch.randn(2, 4, 6), torch.tensor([3, 1])
    found = layer(features, category)
    wanted = torch.einsum("oi,in->on", layer.weight[1], features[1]) + layer.bias[1][:, None]
    torch.testing.assert_close(found[1], wanted)


def test_colour_features_at_pixels_are_those_of_the_whole_patch():
    torch.manual_seed(0)
    features = PatchFeatures(width=8, decoder=(8, 8, 8, 8), outputs=5).eval()
    color, side = torch.rand(1, 3, 32, 32), 32
    everywhere = features(color, torch.arange(side * side)[None])
    some = torch.tensor([[5, 700, 33]])
    torch.testing.assert_close(features(color, some), everywhere[..., some[0]])
    other = color.clone()
    other[..., 20:, 20:] = 0
    assert not torch.allclose(features(other, some), features(color, some))


@both
def test_an_answer_is_a_deformed_prior_and_coordinates_on_it(network):
    inputs = _inputs(network.config)
    answer = network.eval()(*inputs)
    assert answer.assignment.shape == (3, 80, 64) and answer.shape.shape == (3, 64, 3)
    torch.testing.assert_close(answer.assignment.sum(dim=2), torch.ones(3, 80))
    torch.testing.assert_close(answer.shape, network.prior[inputs[3]] + answer.deformation)
    wanted = torch.einsum("bnm,bmd->bnd", answer.assignment, answer.shape)
    torch.testing.assert_close(answer.coordinates, wanted)


@both
def test_an_object_is_answered_alike_alone_and_in_a_batch(network):
    inputs = _inputs(network.config)
    with torch.no_grad():
        together = network.eval()(*inputs)
        alone = network(*(part[1:2] for part in inputs))
    torch.testing.assert_close(alone.coordinates, together.coordinates[1:2], atol=1e-5, rtol=1e-4)


@both
def test_points_in_another_order_are_answered_in_that_order(network):
    """But for the first: farthest points begin with it."""
    color, points, pixels, category = _inputs(network.config)
    order = torch.cat([torch.zeros(1, dtype=torch.long), 1 + torch.randperm(79)])
    # Balls that hold all points: a smaller choice would be of the first ones.
    if hasattr(network, "structure"):
        for module in network.geometry.down:
            module.scales = tuple(
                type(s)(radius=1e3, count=80, widths=s.widths) for s in module.scales
            )
    with torch.no_grad():
        plain = network.eval()(color, points, pixels, category)
        turned = network(color, points[:, order], pixels[:, order], category)
    torch.testing.assert_close(
        turned.coordinates, plain.coordinates[:, order], atol=1e-4, rtol=1e-3
    )


@both
def test_centred_networks_see_neither_place_nor_size(network):
    color, points, pixels, category = _inputs(network.config)
    moved = 2 * points + torch.tensor([0.1, -0.2, 0.4])
    with torch.no_grad():
        plain = network.eval()(color, points, pixels, category)
        other = network(color, moved, pixels, category)
    torch.testing.assert_close(other.coordinates, plain.coordinates, atol=1e-3, rtol=1e-3)


@both
def test_every_parameter_gets_a_gradient(network):
    answer = network.train()(*_inputs(network.config))
    total = sum(part.square().sum() for part in answer if part is not None)
    (total + answer.assignment.square().sum()).backward()
    idle = [n for n, p in network.named_parameters() if p.grad is None or not p.grad.any()]
    assert idle == []


@both
def test_half_precision_changes_little(network):
    inputs = _inputs(network.config)
    with torch.no_grad():
        plain = network.eval()(*inputs)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            narrow = network(*inputs)
    assert narrow.coordinates.dtype == torch.float32
    torch.testing.assert_close(narrow.assignment.sum(dim=2), torch.ones(3, 80))
    assert (narrow.coordinates - plain.coordinates).abs().max() < 0.02


@both
def test_colour_and_geometry_both_count(network):
    color, points, pixels, category = _inputs(network.config)
    with torch.no_grad():
        plain = network.eval()(color, points, pixels, category).assignment
        assert not torch.allclose(network(1 - color, points, pixels, category).assignment, plain)
        bent = points * torch.tensor([1.0, 3.0, 1.0])
        assert not torch.allclose(network(color, bent, pixels, category).assignment, plain)
        other = network(color, points, pixels, torch.tensor([1, 2, 3])).assignment
        assert not torch.allclose(other, plain)


def test_attention_is_the_formula_of_the_transformer():
    torch.manual_seed(0)
    layer = Adaptation(8, 2)
    prior = torch.randn(1, 8, 5)
    structure = Structure(torch.zeros(1, 6, 3), torch.randn(1, 6, 8), torch.randn(1, 6, 8))
    found = layer(prior, structure)
    W, B = layer.attention.in_proj_weight, layer.attention.in_proj_bias
    q = prior[0].T @ W[:8].T + B[:8]
    k = structure.geometry[0] @ W[8:16].T + B[8:16]
    v = structure.color[0] @ W[16:].T + B[16:]
    heads = [
        ((q[:, h] @ k[:, h].T) / 2).softmax(dim=1) @ v[:, h] for h in (slice(0, 4), slice(4, 8))
    ]
    out = layer.attention.out_proj
    wanted = torch.cat(heads, dim=1) @ out.weight.T + out.bias
    torch.testing.assert_close(found[0, 8:], wanted.T)
    assert torch.equal(found[0, :8], prior[0])


def test_structure_points_lie_within_the_object():
    torch.manual_seed(0)
    layer = StructurePoints(4, 4, (8,), 10)
    points = torch.rand(2, 30, 3)
    found = layer(points, torch.randn(2, 4, 30), torch.randn(2, 4, 30))
    assert found.points.shape == (2, 10, 3) and found.color.shape == (2, 10, 4)
    assert (found.points >= points.amin(1, keepdim=True)).all()
    assert (found.points <= points.amax(1, keepdim=True)).all()


def test_settings_that_do_not_belong_together_are_refused(priors):
    def spd(**changes):
        return SPDNetwork(configured(SPD["compact"], {**SMALL, "priors": str(priors), **changes}))

    with pytest.raises(ToolkitError, match="64 points"):
        spd(prior_points="65")
    with pytest.raises(ToolkitError, match="multiple of 8"):
        spd(side="36")
    with pytest.raises(ToolkitError, match="no prior of this category"):
        spd(categories="bottle,spoon")
    sgpa = {**SMALL, **SMALL_SGPA, "priors": str(priors)}
    with pytest.raises(ToolkitError, match="as many channels"):
        SGPANetwork(configured(SGPA["compact"], {**sgpa, "color": "8"}))
    with pytest.raises(ToolkitError, match="two radii"):
        SGPANetwork(configured(SGPA["compact"], {**sgpa, "centres": "32,16"}))


@pytest.mark.slow
def test_published_sizes(tmp_path):
    """SPD has 18.3 million parameters with the six categories of its paper."""
    priors = str(write_priors(tmp_path / "p.safetensors", points=1024))
    six = {"priors": priors, "categories": "bottle,bowl,camera,can,car,mug"}
    spd = SPDNetwork(configured(SPD["published"], six))
    assert parameter_count(spd) / 1e6 == pytest.approx(18.3, abs=0.05)
    assert spd.heads.assign.trunk[0].in_channels == 2176
    assert spd.heads.deform.trunk[0].in_channels == 2112
    sgpa = SGPANetwork(configured(SGPA["published"], six))
    assert [d.centres for d in sgpa.geometry.down] == [512, 256, 128, 64]
    assert sgpa.structure.weigh.outputs == 256
    with torch.no_grad():
        answer = sgpa.eval()(*_inputs(sgpa.config, b=1))
    assert answer.structure.shape == (1, 256, 3) and answer.coordinates.shape == (1, 1024, 3)


def test_frames_of_boxes_are_as_their_poses_say():
    boxes = boxes_of(3)
    view = view_of_boxes(boxes)
    for number, box in enumerate(boxes, start=1):
        pixels = view.truth.mask == number
        assert pixels.sum() > 150 and box.class_id in (CAR, MUG)
        points = view.camera.rays()[pixels] * view.depth[pixels][:, None]
        placed = (view.truth.nocs[pixels] - 0.5) @ box.RT[:3, :3].T + box.RT[:3, 3]
        np.testing.assert_allclose(points, placed, atol=1e-5)
    assert batch_of([view])["classes"][0, 2] == MUG
    assert stacked([_crop(view, 1), _crop(view, 2)]).points.shape == (2, 200, 3)
