"""LIDF as a whole: sizes, learning, what it answers where nothing was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from lidf_scenes import SETTINGS, TINY, pixel_rays_of, scene, tiny
from network_cases import CASES, SIDE, views, weights_of

from benchmark.methods.depth.lidf.features import log_softmax_of_groups
from benchmark.methods.depth.lidf.lidf import LIDF, LIDFNetwork
from benchmark.methods.depth.lidf.refinement import leaky_clip
from benchmark.methods.depth.lidf.voxels import PRESETS
from benchmark.methods.network import parameter_count
from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.methods.weights import architecture_of, load_weights, save_weights
from std_toolkit.errors import ToolkitError


def restorer(folder, weights=None, **settings) -> LIDF:
    if weights is None:
        weights = folder / "lidf.safetensors"
        save_weights(tiny(), weights)
    made = make_restorer("lidf", MethodOptions(weights=weights, settings=SETTINGS | settings))
    assert isinstance(made, LIDF)
    return made


@pytest.mark.slow
def test_sizes():
    with torch.device("meta"):
        network, compact = LIDFNetwork(), LIDFNetwork(PRESETS["compact"])
    parts = {name: parameter_count(part) for name, part in network.named_children()}
    assert parts == {
        "color_net": 21_301_088,
        "points": 56_032,
        "offset": 144_161,
        "termination": 140_033,
        "refinement": 56_032 + 131_105,
    }
    # 128 of a voxel, 128 of colour and 27 of a direction; 102 of two positions, 51 of one.
    assert network.termination.first.in_features == 385
    assert network.offset.first.in_features == 385 + 16
    assert network.refinement.offset.first.in_features == 334 + 16
    assert parameter_count(compact) == 3_096_131 < 15_000_000


def test_every_parameter_learns_in_its_stage():
    network = tiny()
    inputs, truth = scene(2)
    stages = {
        1: ("color_net", "points", "offset", "termination"),
        2: ("refinement",),
    }
    for stage, names in stages.items():
        network.zero_grad()
        network.train_stage(stage)
        found = network(*inputs, learns=stage, follow=truth)
        loss = (found.depth - truth).abs().mean()
        if stage == 1:
            told = found.terminations
            loss = loss - told.log_probability[told.true[told.true >= 0]].mean()
        loss.backward()
        for key, parameter in network.named_parameters():
            learns = key.partition(".")[0] in names
            assert parameter.requires_grad == learns
            got = parameter.grad is not None and bool(parameter.grad.any())
            assert got == learns, key


def test_what_the_losses_are_told():
    inputs, truth = scene(2)
    network = tiny().train()
    found = network(*inputs, learns=1, follow=truth)
    told = found.terminations
    asked = inputs[4].flatten().nonzero().squeeze(1)
    assert torch.equal(told.rays.pixel, asked)
    pairs = told.pairs
    total = torch.zeros(len(asked)).index_add(0, pairs.ray, told.log_probability.exp().detach())
    passing = torch.zeros(len(asked)).bool().index_fill(0, pairs.ray, True)
    torch.testing.assert_close(total[passing], torch.ones(int(passing.sum())))
    # The pair that holds the true depth is followed; its point lies on the ray. Boxes reach into
    # voxels in which nothing was measured, through which no pair goes.
    there = told.true >= 0
    assert 0.5 < there.float().mean() < 1 and torch.equal(told.chosen[there], told.true[there])
    ends = told.points[told.chosen[there]]
    direction = told.rays.direction[there]
    torch.testing.assert_close(ends, (ends * direction).sum(1, keepdim=True) * direction)
    z = found.depth.flatten()[asked[there]]
    torch.testing.assert_close(z, ends[:, 2])
    assert found.refinements is None and found.depth is found.initial
    second = network(*inputs, learns=2, follow=truth)
    assert second.terminations is None and len(second.refinements.points) == 3
    assert not second.refinements.points[0].requires_grad
    assert second.refinements.points[-1].requires_grad


def test_all_pairs_at_once_and_ray_by_ray_answer_the_same():
    inputs, truth = scene(2)
    network = tiny().eval()
    with torch.inference_mode():
        for follow in (None, truth):
            whole = network(*inputs, learns=1, follow=follow).depth
            parts = network(*inputs, follow=follow).initial
            torch.testing.assert_close(parts, whole, rtol=1e-5, atol=1e-6)
        fewer = LIDFNetwork(replace(TINY, rays_at_once=77)).eval()
        fewer.load_state_dict(network.state_dict())
        torch.testing.assert_close(fewer(*inputs).depth, network(*inputs).depth)


def test_true_offsets_and_voxels_give_the_true_depth(monkeypatch):
    """With an oracle in the place of the heads the first stage is exact."""
    side = 48
    rays = pixel_rays_of(side, side)
    truth = 0.8 / (rays * torch.tensor([0.2, 0.3, 1.0]).reshape(1, 3, 1, 1)).sum(1, keepdim=True)
    network = tiny().eval()
    believed = torch.ones_like(truth).bool()
    color = torch.rand(1, 3, side, side)
    with torch.inference_mode():
        told = network(color, truth, rays, believed, believed, learns=1, follow=truth).terminations
        distance = (truth * rays.norm(dim=1, keepdim=True)).flatten()
        exact = (distance[told.pairs.ray] - told.pairs.entry) / network.diagonal
        monkeypatch.setattr(network.offset, "forward", lambda _: exact)
        found = network(color, truth * 1.0, rays, believed, believed, learns=1, follow=truth)
    torch.testing.assert_close(found.depth, truth, rtol=0, atol=1e-6)
    assert not torch.equal(found.depth, truth)  # computed, not copied


def test_the_second_stage_moves_along_the_ray_and_not_far():
    inputs, _ = scene(1)
    network = tiny().eval()
    with torch.inference_mode():
        found = network(*inputs)
    told = found.refinements
    moves = told.points[-1] - told.points[0]
    along = (moves * told.rays.direction).sum(dim=1)
    torch.testing.assert_close(moves, along[:, None] * told.rays.direction, rtol=0, atol=1e-6)
    assert along.abs().max() > 1e-3
    assert along.abs().max() < 2 * 0.21 + 0.01 * 10
    fresh = LIDFNetwork(TINY).eval()  # whose heads answer next to nothing
    with torch.inference_mode():
        found = fresh(*inputs)
    torch.testing.assert_close(found.depth, found.initial, rtol=0, atol=2e-3)


def test_training_predicts_a_run_of_pixels():
    inputs, _ = scene(2)
    network = tiny(config=replace(TINY, train_rays=50)).train()
    network.load_state_dict(tiny().state_dict())
    runs = set()
    for _ in range(5):
        pixels = network(*inputs, learns=1).terminations.rays.pixel
        assert len(pixels) == 100
        asked = inputs[4].flatten().nonzero().squeeze(1)
        at = torch.searchsorted(asked, pixels).reshape(2, 50)
        assert (at.diff(dim=1) == 1).all()
        runs.add(int(at[0, 0]))
    assert len(runs) > 1


def with_masks(some: list[View]) -> list[View]:
    found = []
    for view in some:
        mask = np.zeros(view.depth.shape, dtype=bool)
        mask[10:30, 20:40] = True
        found.append(replace(view, mask=mask))
    return found


def test_by_name_and_all_or_missing(tmp_path):
    some = with_masks(views(2))
    whole = restorer(tmp_path)
    assert whole.needs_mask and whole.input_size == (SIDE, SIDE)
    missing = restorer(tmp_path, predict="missing")
    for view, one, other in zip(some, whole.restore(some), missing.restore(some), strict=True):
        doubted = view.mask | (view.depth <= 0)
        np.testing.assert_array_equal(other.depth[~doubted], view.depth[~doubted])
        assert (one.depth[~doubted] != view.depth[~doubted]).mean() > 0.9
        # On the doubted pixels both say the same but for the second stage, which looks at all
        # the predicted points: with other neighbours it answers otherwise.
        assert (other.depth[doubted] > 0).mean() > 0.9
        assert (other.depth[view.mask] != view.depth[view.mask]).all()
    assert whole.macs(some[0]) > 100_000
    coarse = [restorer(tmp_path, predict=p, refine="false") for p in ("all", "missing")]
    one, other = (r.restore(some)[0].depth for r in coarse)
    doubted = some[0].mask | (some[0].depth <= 0)
    np.testing.assert_allclose(one[doubted], other[doubted], rtol=1e-4)


def test_the_mask_is_needed_unless_holes_alone_are_doubted(tmp_path):
    with pytest.raises(ToolkitError, match="has no mask") as caught:
        restorer(tmp_path).restore(views(1))
    assert "mask=holes" in str(caught.value)
    believing = restorer(tmp_path, mask="holes", predict="missing")
    assert not believing.needs_mask
    (view,) = views(1)
    (answer,) = believing.restore([view])
    np.testing.assert_array_equal(answer.depth[view.depth > 0], view.depth[view.depth > 0])
    assert (answer.depth[view.depth == 0] > 0).mean() > 0.9


@pytest.mark.parametrize("predict", ["all", "missing"])
def test_depth_that_is_all_there_or_all_missing(tmp_path, predict):
    some = with_masks(views(3))
    some[1].depth[:] = 0
    some[2].mask[:] = True
    network = restorer(tmp_path, predict=predict)
    alone = network.restore(some[:1])[0].depth
    answers = network.restore(some)
    np.testing.assert_allclose(answers[0].depth, alone, rtol=1e-3, atol=1e-5)
    # Without a measurement there are no voxels: no answer.
    assert not answers[1].depth.any() and not answers[2].depth.any()
    assert not network.restore([some[1]])[0].depth.any()
    full = replace(some[0], depth=np.full((SIDE, SIDE), 0.7, np.float32), mask=some[0].mask & False)
    (answer,) = network.restore([full])
    if predict == "all":
        assert (answer.depth > 0).all() and (answer.depth != full.depth).any()
    else:
        np.testing.assert_array_equal(answer.depth, full.depth)


def test_broken_and_far_measurements_do_no_harm(tmp_path):
    (view,) = with_masks(views(1))
    view.depth[40:45] = np.nan
    view.depth[45:50] = 30.0  # outside the grid
    (answer,) = restorer(tmp_path, predict="missing").restore([view])
    assert np.isfinite(answer.depth).all()
    assert (answer.depth[45:50] == 30).all()


def test_views_of_another_size(tmp_path):
    (view,) = with_masks(views(1, (96, 80)))
    (answer,) = restorer(tmp_path).restore([view])
    assert answer.depth.shape == (80, 96) and (answer.depth > 0).mean() > 0.9


def test_narrow_arithmetic_is_near(tmp_path):
    some = with_masks(views(2))
    weights = tmp_path / "w.safetensors"
    save_weights(tiny(), weights)
    options = MethodOptions(weights=weights, settings=SETTINGS, precision="bf16")
    narrow = make_restorer("lidf", options).restore(some)
    for one, other in zip(narrow, restorer(tmp_path, weights).restore(some), strict=True):
        assert np.isfinite(one.depth).all()
        # Another voxel may be likeliest here and there; most pixels agree.
        assert np.median(abs(one.depth - other.depth)) < 0.02


def test_round_trip_and_weights_of_others(tmp_path):
    first, second = tiny(1), tiny(2)
    path = tmp_path / "a.safetensors"
    save_weights(first, path)
    load_weights(second, path)
    for (key, one), other in zip(
        first.state_dict().items(), second.state_dict().values(), strict=True
    ):
        assert torch.equal(one, other), key
    assert architecture_of(first.state_dict()) == "LIDF"
    with pytest.raises(ToolkitError, match="they look like those of DFNet"):
        restorer(tmp_path, weights_of(CASES["dfnet"], tmp_path))
    with pytest.raises(ToolkitError, match=r"keys missing .* they look like those of LIDF"):
        make_restorer("dfnet", MethodOptions(weights=path, settings=CASES["dfnet"].settings))
    with pytest.raises(ToolkitError, match="of another size"):
        restorer(tmp_path, path, channels="16")
    with pytest.raises(ToolkitError, match="expected one of all, missing"):
        restorer(tmp_path, path, predict="some")
    with pytest.raises(ToolkitError, match="rays_at_once: must be positive"):
        restorer(tmp_path, path, rays_at_once="0")


def learned(network, stage, steps, rate) -> list[float]:
    """The losses of training one stage on four frames."""
    inputs, truth = scene(4)
    network.train_stage(stage)
    learning = [parameter for parameter in network.parameters() if parameter.requires_grad]
    optimizer = torch.optim.AdamW(learning, rate, weight_decay=0)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, steps)
    losses = []
    for _ in range(steps):
        found = network(*inputs, learns=stage, follow=truth)
        loss = (found.depth - truth)[inputs[4]].abs().mean()
        if stage == 1:
            told = found.terminations
            loss = loss - 0.05 * told.log_probability[told.true[told.true >= 0]].mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        losses.append(loss.item())
    return losses


@pytest.mark.long  # in short: test_training_learns of test_training_fit.py
@pytest.mark.slow
def test_four_frames_are_learned():
    """The loss of the first stage falls to a tenth, that of the second, disturbed, to a third."""
    network = tiny()
    network.refinement.load_state_dict(LIDFNetwork(TINY).refinement.state_dict())
    first = learned(network, 1, 150, 4e-3)
    second = learned(network, 2, 100, 5e-3)
    assert first[-1] < 0.1 * first[0], (first[0], first[-1])
    assert second[-1] < 0.33 * second[0], (second[0], second[-1])
    # Without being told the voxels: much better than the sensor, still better after the second.
    inputs, truth = scene(4)
    network.eval()
    with torch.inference_mode():
        found = network(*inputs)
    before, after = ((d - truth)[inputs[4]].abs().mean() for d in (found.initial, found.depth))
    assert before < 0.1 * (inputs[1] - truth)[inputs[4]].abs().mean()
    assert after < 0.9 * before


def test_clipped_scores_are_those_of_the_published_program():
    """Before the softmax, scores beyond [0, 1] lose 99 % of what they exceed it by."""
    inputs, _ = scene(1)
    plain, clipped = tiny().eval(), tiny(config=replace(TINY, clipped=True)).eval()
    with torch.no_grad():
        for network in (plain, clipped):
            network.termination.last.weight.mul_(200)
    seen = []
    plain.termination.register_forward_hook(lambda *args: seen.append(args[2]))
    clipped.termination.register_forward_hook(lambda *args: seen.append(args[2]))
    with torch.inference_mode():
        one, other = plain(*inputs, learns=1), clipped(*inputs, learns=1)
    assert torch.equal(seen[0], seen[1]) and (seen[0].max() > 1.5 or seen[0].min() < -0.5)
    pairs, count = one.terminations.pairs, len(one.terminations.rays.pixel)
    expected = log_softmax_of_groups(leaky_clip(seen[0]), pairs.ray, count)
    torch.testing.assert_close(other.terminations.log_probability, expected)
    assert not torch.allclose(one.terminations.log_probability, expected)
