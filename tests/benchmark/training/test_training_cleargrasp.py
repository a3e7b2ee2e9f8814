"""ClearGrasp's training: targets from depth and masks, losses, one network or all three."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor
from torch.nn.functional import normalize
from training_set import TINY, packed, same, trained, wishes, write_scenes

from benchmark.methods.depth.cleargrasp.global_optimization import normals_to_opencv, optimize_depth
from benchmark.methods.depth.cleargrasp.join import join_weights
from benchmark.methods.depth.full_size import view_of
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.methods.torch_camera import points_of
from benchmark.training.catalogue import get_trainable
from benchmark.training.depth.cleargrasp_losses import (
    CONTACT,
    IGNORED,
    NONE,
    OCCLUSION,
    ClearGraspAnswers,
    ClearGraspLoss,
    ClearGraspTarget,
    outlines_of,
)
from benchmark.training.depth.cleargrasp_training import ClearGraspValidator, cleargrasp_target
from benchmark.training.packed_frames import PackedFrames
from std_toolkit.geometry.camera import Camera
from tests.dreds_on_disk import TRANSPARENT

K = torch.tensor([[120.0, 0, 63.5], [0, 120.0, 47.5], [0, 0, 1]])[None]
SIZE = (96, 128)
GAP = 0.01


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("cleargrasp")
    return packed(top / "pack", write_scenes(top / "data"))


def rays() -> Tensor:
    return points_of(torch.ones(1, 1, *SIZE), K)


def on_plane(normal: tuple[float, float, float], offset: float) -> Tensor:
    """(1, 1, h, w) depth of the plane n . x = offset."""
    return offset / (rays() * torch.tensor(normal).reshape(1, 3, 1, 1)).sum(1, keepdim=True)


def a_ball(centre: tuple[float, float, float], radius: float) -> Tensor:
    """(1, 1, h, w) depth of a sphere, infinite beside it."""
    way, c = rays(), torch.tensor(centre).reshape(1, 3, 1, 1)
    a, b = way.square().sum(1, keepdim=True), (way * c).sum(1, keepdim=True)
    root = b.square() - a * (c.square().sum() - radius**2)
    return torch.where(root >= 0, (b - root.clamp(min=0).sqrt()) / a, torch.inf)


TABLE = (0.0, 0.8, 0.6)  # seen from above at 53 degrees; normal away from the camera


def table_and_ball() -> tuple[Tensor, Tensor]:
    """Depth and mask of a ball that floats above a table."""
    table, ball = on_plane(TABLE, 0.6), a_ball((0.05, 0.0, 0.6), 0.08)
    mask = torch.where(ball < table, 3, 255).to(torch.uint8)
    return ball.minimum(table), mask[:, 0]


def test_normals_of_a_plane_and_a_ball():
    depth, mask = table_and_ball()
    found, classes = outlines_of(depth, mask, K, GAP)
    inner = (found.square().sum(1) > 0.5) & (mask == 255)
    # Towards the camera in its frame is (0, -0.8, -0.6): with y up and z back (0, 0.8, 0.6).
    expected = torch.tensor([0.0, 0.8, 0.6])
    assert (found.permute(0, 2, 3, 1)[inner] @ expected).min() > 1 - 1e-4
    assert inner.sum() > 0.95 * (mask == 255).sum()
    ball = (found.square().sum(1) > 0.5) & (mask == 3)
    at = (rays() * depth).permute(0, 2, 3, 1)[ball]
    true = normalize(at - torch.tensor([0.05, 0.0, 0.6]), dim=1) * torch.tensor([1, -1, -1])
    cosine = (found.permute(0, 2, 3, 1)[ball] * true).sum(1)
    assert cosine.median() > 0.999
    assert (cosine > 0.95).float().mean() > 0.85  # differences over a pixel at the round edge
    assert (classes != IGNORED).all()


def test_a_floating_ball_has_an_occlusion_boundary_and_no_contact():
    depth, mask = table_and_ball()
    classes = outlines_of(depth, mask, K, GAP).boundaries[0]
    ball = (mask[0] == 3).float()
    grown = torch.nn.functional.max_pool2d(ball[None, None], 3, 1, 1)[0, 0] > 0
    shrunk = -torch.nn.functional.max_pool2d(-ball[None, None], 3, 1, 1)[0, 0] > 0
    rim = grown & ~shrunk
    assert (classes[rim] == OCCLUSION).float().mean() > 0.7  # the rest of it meets by corners
    far = torch.nn.functional.max_pool2d(rim.float()[None, None], 5, 1, 2)[0, 0] == 0
    assert (classes[far] == NONE).all()
    assert not (classes == CONTACT).any()


def test_a_slanted_box_on_the_table_touches_it():
    """A wall that stands on the table: their crease is a contact edge, its upper rim is not."""
    table, wall = on_plane(TABLE, 0.6), on_plane((0.0, -0.6, 0.8), 0.5)
    v = torch.arange(SIZE[0])[None, None, :, None]
    mask = ((wall < table) & (v > 30)).expand(1, 1, *SIZE)
    depth = torch.where(mask, wall, table)
    classes = outlines_of(depth, torch.where(mask[:, 0], 1, 255).byte(), K, GAP).boundaries[0]
    column = classes[:, 64]
    foot = int(mask[0, 0, :, 64].nonzero().max())
    assert column[30:32].tolist() == [OCCLUSION] * 2
    assert column[foot : foot + 2].tolist() == [CONTACT] * 2
    assert (column == NONE).sum() == SIZE[0] - 4


def test_a_table_at_a_grazing_angle_is_whole():
    """Decimetres of depth from pixel to pixel are no boundary, nor is the image's own edge."""
    depth = on_plane((0.0, 0.8, 0.42), 0.35)
    step = (depth[..., 1:, :] - depth[..., :-1, :]).abs()
    assert step.max() > 10 * GAP and (depth > 0).all()
    found, classes = outlines_of(depth, torch.full((1, *SIZE), 255, dtype=torch.uint8), K, GAP)
    assert (classes == NONE).all()
    assert (found.square().sum(1) > 0.5).all()


def test_what_is_not_known_is_not_asked():
    depth, mask = table_and_ball()
    depth[..., 40:60, 10:30] = 0
    found, classes = outlines_of(depth, mask, K, GAP)
    assert (classes[0, 40:60, 10:30] == IGNORED).all()
    assert (classes[0, 39, 10:30] == IGNORED).all(), "what is beside it may be a boundary"
    assert not found[..., 40:60, 10:30].any()
    empty = outlines_of(depth * 0, mask, K, GAP)
    assert (empty.boundaries == IGNORED).all() and not empty.normals.any()


def test_targets_bring_a_ball_back_through_the_optimisation():
    """What the networks are to say is what the global optimisation can use: a ball without a
    measurement but for a ring where it is taken to touch."""
    depth, mask = table_and_ball()
    found, classes = outlines_of(depth, mask, K, GAP)
    ball = (mask[0] == 3).numpy()
    raw = depth[0, 0].numpy().copy()
    centre = np.argwhere(ball).mean(axis=0).astype(int)
    raw[ball] = 0
    spot = np.s_[centre[0] - 1 : centre[0] + 2, centre[1] - 1 : centre[1] + 2]
    raw[spot] = depth[0, 0].numpy()[spot]
    normals = normals_to_opencv(found[0].permute(1, 2, 0).numpy())
    camera = Camera(SIZE[1], SIZE[0], 120.0, 120.0, 63.5, 47.5)
    boundary = (classes[0] == OCCLUSION).numpy().astype(float)
    restored = optimize_depth(raw, normals, boundary, None, camera)
    error = abs(restored - depth[0, 0].numpy())[ball]
    assert np.median(error) < 0.002
    flat = optimize_depth(raw, normals * 0, boundary, None, camera)
    assert np.median(abs(flat - depth[0, 0].numpy())[ball]) > 5 * np.median(error)


def a_question(seed: int = 0) -> tuple[ClearGraspAnswers, ClearGraspTarget]:
    draw = torch.Generator().manual_seed(seed)

    def random(channels: int) -> Tensor:
        return torch.randn(2, channels, 4, 5, generator=draw, dtype=torch.float64)

    classes = torch.randint(0, 3, (2, 4, 5), generator=draw)
    classes[:, 0, :2] = IGNORED
    true = normalize(random(3), dim=1)
    true[:, :, 1, 1] = 0
    from benchmark.training.depth.cleargrasp_losses import Outlines

    target = ClearGraspTarget(
        torch.randint(0, 2, (2, 4, 5), generator=draw), Outlines(true, classes)
    )
    return ClearGraspAnswers(random(2), random(3), random(3)), target


@pytest.mark.parametrize("reduce", ["mean", "sum"])
def test_gradients_are_those_of_differences(reduce):
    answers, target = a_question()

    def total(masks: Tensor, normals: Tensor, boundaries: Tensor) -> Tensor:
        said = ClearGraspAnswers(masks, normalize(normals, dim=1), boundaries)
        return ClearGraspLoss(reduce=reduce)(said, target).total

    inputs = tuple(maps.requires_grad_() for maps in answers)
    assert torch.autograd.gradcheck(total, inputs, eps=1e-6, atol=1e-5)


def test_the_loss_is_the_sum_that_is_written_down():
    answers, target = a_question()
    answers = answers._replace(normals=normalize(answers.normals, dim=1))
    loss = ClearGraspLoss(masks=2.0, normals=3.0, boundaries=0.5)(answers, target)
    masks, normals, bounds, weights = [], [], [], []
    for i in range(2):
        for v in range(4):
            for u in range(5):
                log = answers.masks[i, :, v, u].log_softmax(0)
                masks.append(-log[target.masks[i, v, u]].item())
                kind = int(target.outlines.boundaries[i, v, u])
                if kind != IGNORED:
                    weights.append(5.0 if kind else 1.0)
                    log = answers.boundaries[i, :, v, u].log_softmax(0)
                    bounds.append(-log[kind].item() * weights[-1])
                true = target.outlines.normals[i, :, v, u]
                if true.any():
                    normals.append(1 - float(true @ answers.normals[i, :, v, u]))
    expected = 2 * np.mean(masks) + 3 * np.mean(normals) + 0.5 * np.sum(bounds) / np.sum(weights)
    assert loss.total.item() == pytest.approx(expected, rel=1e-9)
    summed = ClearGraspLoss(reduce="sum")(answers, target)
    assert summed.total.item() == pytest.approx(
        (np.sum(masks) + np.sum(normals) + np.sum(bounds)) / 2, rel=1e-9
    )


def test_what_is_said_of_unknown_pixels_does_not_matter():
    answers, target = a_question()
    mine = ClearGraspLoss(masks=0.0)(answers._replace(masks=None), target).total
    answers.normals[:, :, 1, 1] += 3
    answers.boundaries[:, :, 0, :2] += 3
    yours = ClearGraspLoss(masks=0.0)(answers._replace(masks=None), target).total
    assert mine.item() == yours.item()
    nothing = target._replace(
        outlines=type(target.outlines)(
            target.outlines.normals * 0, torch.full_like(target.outlines.boundaries, IGNORED)
        )
    )
    assert ClearGraspLoss()(answers._replace(masks=None), nothing).total.item() == 0


def test_transparent_objects_are_dropped_and_specular_ones_on_request(pack):
    frames = PackedFrames([pack])
    batch, frame = frames[[0]], frames.frame(0)
    for objects, kinds in (("transparent", (2,)), ("specular_transparent", (2, 3))):
        masks = cleargrasp_target(batch, ClearGraspLoss(objects=objects)).masks[0]
        expected = frame.mask_where(lambda i, kinds=kinds: i.material in kinds)
        assert np.array_equal(masks.numpy() > 0, expected) and expected.any()
    assert any(i.material == TRANSPARENT for i in frame.instances)


@pytest.mark.slow
def test_one_network_or_all_three_are_the_same_training(pack, tmp_path):
    """They share nothing: masks trained alone are masks trained with the others, bit for bit."""
    settings = {**TINY["cleargrasp"]}
    plain = wishes("cleargrasp", pack, settings=settings, steps=4, colors="off")
    whole = trained(plain, tmp_path / "whole")
    parts = {}
    for name in ("normals", "boundaries"):
        others = {other: "0" for other in ("masks", "normals", "boundaries") if other != name}
        parts[name] = trained(replace(plain, loss=others), tmp_path / name)
    for name, part in parts.items():
        mine = [key for key in part if key.startswith(f"{name}.")]
        rest = [key for key in part if not key.startswith(f"{name}.")]
        assert all(torch.equal(part[key], whole[key]) for key in mine)
        assert not all(torch.equal(part[key], whole[key]) for key in rest)
    rows = list(csv.DictReader((tmp_path / "normals" / "validation.csv").open()))
    assert rows[0]["normals_degrees"] != "nan" and rows[0]["masks_iou"] == "nan"
    rows = list(csv.DictReader((tmp_path / "normals" / "steps.csv").open()))
    assert "normals" in rows[0] and "masks" not in rows[0]
    # The network of one run and those of another become one file; or one run goes on with those
    # that another left.
    joined, files = (
        tmp_path / "joined.safetensors",
        [tmp_path / run / "last.safetensors" for run in ("whole", "normals", "boundaries")],
    )
    config = get_trainable("cleargrasp").config("compact", settings)
    join_weights(*files, joined, config)
    assert same(load_file(joined), whole)
    left = replace(plain, loss={"normals": "0"}, weights=tmp_path / "normals" / "last.safetensors")
    both = trained(left, tmp_path / "both")
    assert all(torch.equal(both[k], t) for k, t in parts["normals"].items() if "normals." in k)
    assert not torch.equal(
        both["masks.decoder.conv1.weight"], parts["normals"]["masks.decoder.conv1.weight"]
    )
    weights = tmp_path / "both" / "best.safetensors"
    method = make_restorer("cleargrasp", MethodOptions(weights=weights, settings=settings))
    frame = PackedFrames([pack]).frame(0)
    (answer,) = method.restore([view_of(frame, None)])
    assert np.isfinite(answer.depth).all() and (answer.depth > 0).any()


def test_validation_of_what_is_true_is_perfect(pack, tmp_path):
    frames, loss = PackedFrames([pack]), ClearGraspLoss()
    validator = ClearGraspValidator(frames, range(5), 2, loss)

    class Knowing(torch.nn.Module):
        """The submodules answer what is true of the batch that colour is asked of."""

        def __init__(self, name: str) -> None:
            super().__init__()
            self.name, self.calls = name, 0

        def forward(self, color: Tensor) -> Tensor:
            first = self.calls
            self.calls += len(color)
            target = cleargrasp_target(frames[list(range(first, first + len(color)))], loss)
            if self.name == "normals":
                return target.outlines.normals
            classes = target.masks if self.name == "masks" else target.outlines.boundaries
            count = 2 if self.name == "masks" else 3
            hot = torch.nn.functional.one_hot(classes.clamp(min=0), count)
            return 50.0 * hot.permute(0, 3, 1, 2)

    network = torch.nn.ModuleDict({n: Knowing(n) for n in ("masks", "normals", "boundaries")})
    scores = validator.scores(validator.states(network, torch.device("cpu")))
    assert scores["masks_iou"] == 1 and scores["occlusion_iou"] == 1
    assert scores["normals_degrees"] < 0.1 and scores["loss"] < 1e-5
    assert validator.main_score(scores) == ("loss", scores["loss"])
    unknown = validator.scores(np.zeros(10))
    assert all(np.isnan(value) for value in unknown.values())


@pytest.mark.slow
def test_a_run_leaves_pictures_and_scores(pack, tmp_path):
    trained(wishes("cleargrasp", pack, steps=2, validate_every=2), tmp_path)
    best = json.loads((tmp_path / "best.json").read_text())
    assert best["ranked_by"] == "loss" and 0 <= best["scores"]["masks_iou"] <= 1
    assert (tmp_path / "gallery" / "step-0000002.jpg").stat().st_size > 5000
