"""Crop NOCS: turned crops, bins, round objects, and that it learns poses."""

import math

import numpy as np
import pytest
import torch

from benchmark.methods.pose.crop_nocs import PRESETS, CropNOCSNetwork, decoded, points_in
from benchmark.methods.pose.segmented import Placed, crop_object, longest_axis, turned_about_z
from benchmark.methods.registry import MethodOptions, make_pose_method
from benchmark.methods.weights import save_weights
from benchmark.training.catalogue import get_trainable
from benchmark.training.pose.crop_nocs_training import binned_entropy, crop_nocs_step, seen_half
from benchmark.training.pose.deformation_loss import ObjectTruth, about_y, facing
from benchmark.training.pose.deformation_training import trained_depth
from benchmark.training.step import StepInfo, model_input
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import configured
from tests.benchmark.methods.pose.boxes_in_view import (
    CAR,
    MUG,
    batch_of,
    boxes_of,
    view_of_boxes,
)

TINY = {"side": "32", "points": "300", "widths": "16,32,48,64", "blocks": "1,1,1,1"}
TINY |= {"input_size": "96,72"}


def _network(**changes):
    torch.manual_seed(0)
    return CropNOCSNetwork(configured(PRESETS["compact"], {**TINY, **changes}))


def _crop(number, placed=None, side=160):
    view = view_of_boxes(boxes_of(0))
    return view, crop_object(
        torch.from_numpy(view.color).permute(2, 0, 1) / 255,
        torch.from_numpy(view.depth),
        torch.from_numpy(view.truth.mask == number),
        torch.from_numpy(view.camera.K).float(),
        side=side,
        points=200,
        generator=torch.Generator().manual_seed(0),
        placed=placed,
    )


def test_a_turned_crop_is_that_of_a_turned_camera():
    placed = Placed(0.7, 1.3, (0.05, -0.03))
    view, crop = _crop(1, placed)
    _, upright = _crop(1)
    c, s = math.cos(0.7), math.sin(0.7)
    R = torch.tensor([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    torch.testing.assert_close(crop.points, upright.points @ R.T)
    back = turned_about_z(crop.points[None], -crop.turn[None])
    torch.testing.assert_close(back[0], upright.points)
    # The pixel of a point in the patch shows the colour that it has in the image.
    patch = (crop.color.flatten(1)[:, crop.pixels] * 255).T.numpy()
    image = view.color.reshape(-1, 3)[crop.chosen]
    assert (np.abs(patch - image).max(axis=1) < 60).mean() > 0.9
    # Turned by a quarter, the patch is the upright one turned.
    _, quarter = _crop(1, Placed(math.pi / 2))
    torch.testing.assert_close(
        quarter.color, torch.rot90(upright.color, 1, (1, 2)), atol=0.02, rtol=0
    )


def test_points_of_a_grid_know_neither_distance_nor_size():
    g = torch.Generator().manual_seed(0)
    points = torch.randn(2, 90, 3, generator=g)
    pixels = torch.randint(32 * 32, (2, 90), generator=g)
    grid = points_in(points, pixels, 16)
    moved = points_in(0.1 * points + torch.tensor([0.3, 0.2, 0.9]), pixels, 16)
    torch.testing.assert_close(grid, moved, atol=1e-4, rtol=1e-4)
    row, column = int(pixels[0, 0]) // 32 // 2, int(pixels[0, 0]) % 32 // 2
    assert grid[0, 3, row, column] == 1
    assert (
        grid[:, 3].sum() < 2 * 90
        and (grid[:, :3][(grid[:, 3:] == 0).expand(-1, 3, -1, -1)] == 0).all()
    )


def test_bins_give_back_the_coordinates_that_they_learn():
    true = torch.rand(2, 40, 3, generator=torch.Generator().manual_seed(0)) * 0.9 - 0.45
    logits = torch.zeros(2, 3, 32, 40, requires_grad=True)
    known = torch.ones(2, 40, dtype=torch.bool)
    known[1, 7] = False
    optimizer = torch.optim.Adam([logits], 0.5)
    for _ in range(150):
        optimizer.zero_grad()
        loss = binned_entropy(logits, true, known).sum()
        loss.backward()
        optimizer.step()
    apart = (decoded(logits.detach()) - true).abs().amax(dim=2)
    assert apart[known].max() < 0.002
    assert not logits.grad[1, :, :, 7].any()


def test_round_objects_face_the_camera():
    """However an object is turned about y, it asks for the same answer, with +x to the camera."""
    rng = np.random.default_rng(0)
    R = torch.from_numpy(np.linalg.qr(rng.normal(size=(3, 3)))[0])
    R = R * torch.linalg.det(R)
    coordinates = torch.from_numpy(rng.uniform(-0.5, 0.5, (1, 30, 3))).expand(2, -1, -1)
    turn = about_y(torch.tensor([0.0, 2.1], dtype=torch.double))
    given = coordinates @ turn.transpose(1, 2)
    places = 0.2 * coordinates @ R.T + torch.tensor([0.1, 0.0, 0.7])
    truth = ObjectTruth(
        given, places, torch.ones(2, 30, dtype=torch.bool), torch.tensor([True] * 2)
    )
    found = facing(truth)
    torch.testing.assert_close(found.coordinates[0], found.coordinates[1])
    # The camera, in the object's frame: solve coordinates to places and look where 0 is.
    A = torch.cat([places[0], torch.ones(30, 1, dtype=torch.double)], dim=1)
    camera = torch.linalg.lstsq(A, found.coordinates[0]).solution[3]
    mean = found.coordinates[0].mean(dim=0)
    assert camera[0] - mean[0] > 0 and abs(camera[2] - mean[2]) < 1e-6
    half = seen_half(found)
    assert half[0, 0] == half[0, 2] == found.coordinates[0][:, ::2].norm(dim=1).max()
    as_they_are = facing(truth._replace(turned=torch.tensor([False, False])))
    assert torch.equal(as_they_are.coordinates, given)


def test_mixed_depth_is_true_for_some_frames():
    batch = batch_of([view_of_boxes(boxes_of(seed)) for seed in range(8)])
    batch["raw"] = batch["raw"] + 1.0
    config = configured(PRESETS["compact"], {"trained_on": "mixed"})
    torch.manual_seed(0)
    depth = trained_depth(config, model_input(batch), drawn=True)
    true = [torch.equal(d, t) for d, t in zip(depth, batch["true"], strict=True)]
    raw = [torch.equal(d, r) for d, r in zip(depth, batch["raw"], strict=True)]
    assert 0 < sum(true) < 8 and sum(true) + sum(raw) == 8
    assert torch.equal(trained_depth(config, model_input(batch), drawn=False), batch["raw"])


def test_a_step_gives_every_parameter_a_gradient():
    trainable, network = get_trainable("crop-nocs"), _network()
    batch = batch_of([view_of_boxes(boxes_of(seed)) for seed in (1, 2, 3)])
    torch.manual_seed(0)
    loss = crop_nocs_step(network, trainable.loss, model_input(batch), StepInfo())
    loss.total.backward()
    torch.manual_seed(0)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        narrow = crop_nocs_step(network, trainable.loss, model_input(batch), StepInfo())
    assert narrow.total.item() == pytest.approx(loss.total.item(), rel=0.02)
    idle = [n for n, p in network.named_parameters() if p.grad is None or not p.grad.any()]
    assert idle == [] and loss.parts["objects"] == 6
    batch["mask"].fill_(255)
    nothing = crop_nocs_step(network, trainable.loss, model_input(batch), StepInfo())
    nothing.total.backward()
    assert nothing.total == 0 and nothing.parts["objects"] == 0


@pytest.mark.slow
def test_a_network_that_knows_its_frames_finds_their_poses(tmp_path):
    """Also in a frame that it saw only turned, for crops are turned in training."""
    torch.set_num_threads(1)
    boxes = boxes_of(1)
    view = view_of_boxes(boxes)
    batch = batch_of([view, view])
    network = _network().train()
    trainable = get_trainable("crop-nocs")
    optimizer = torch.optim.AdamW(network.parameters(), 4e-3)
    steps = 250
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 4e-3, total_steps=steps)
    for step in range(steps):
        torch.manual_seed(step)
        found = crop_nocs_step(network, trainable.loss, model_input(batch), StepInfo())
        optimizer.zero_grad()
        found.total.backward()
        optimizer.step()
        schedule.step()
    save_weights(network, tmp_path / "w.safetensors")
    options = MethodOptions(
        preset="compact",
        weights=tmp_path / "w.safetensors",
        settings={**TINY, "masks": "true"},
    )
    estimator = make_pose_method("crop-nocs", options)
    assert estimator.needs_truth and estimator.input_size == (96, 72)
    answer = estimator.estimate([view])[0]
    prediction = answer.prediction
    assert prediction.class_ids.tolist() == [CAR, MUG]
    for k, box in enumerate(boxes):
        RT = prediction.RT[k]
        scale, true_scale = (np.cbrt(np.linalg.det(M[:3, :3])) for M in (RT, box.RT))
        cosine = (np.trace(RT[:3, :3].T @ box.RT[:3, :3]) / scale / true_scale - 1) / 2
        assert np.degrees(np.arccos(min(1, cosine))) < 8
        assert np.linalg.norm(RT[:3, 3] - box.RT[:3, 3]) < 0.015
        sides = scale * prediction.sizes[k]
        assert np.abs(sides / (true_scale * 2 * box.half) - 1).max() < 0.25
        assert (answer.masks[k] == (view.truth.mask == k + 1)).all()


def test_crops_are_turned_so_that_the_longest_axis_is_upright():
    """Whatever way a bar lies, it stands upright in its crop."""
    v, u = torch.meshgrid(torch.arange(90.0), torch.arange(120.0), indexing="ij")
    K = torch.tensor([[90.0, 0, 60], [0, 90, 45], [0, 0, 1]])
    for degrees in (-80, -30, 0, 10, 89):
        angle = math.radians(degrees)
        along = math.cos(angle) * (v - 45) - math.sin(angle) * (u - 60)
        across = math.sin(angle) * (v - 45) + math.cos(angle) * (u - 60)
        mask = (along.abs() < 35) & (across.abs() < 7)
        turn = longest_axis(mask)
        assert math.degrees(turn) == pytest.approx(degrees, abs=0.5)
        color = mask[None].float().expand(3, -1, -1)
        crop = crop_object(
            color, torch.ones(90, 120), mask, K, side=48, points=99, placed=Placed(turn)
        )
        rows, columns = (crop.color[0] > 0.5).nonzero(as_tuple=True)
        assert rows.max() - rows.min() > 40 and columns.max() - columns.min() < 11


@pytest.mark.parametrize("changes", [{"side": "40"}, {"side": "0"}, {"points": "0"}])
def test_crops_that_cannot_be_are_refused(changes):
    with pytest.raises(ToolkitError, match=next(iter(changes))):
        _network(**changes)
