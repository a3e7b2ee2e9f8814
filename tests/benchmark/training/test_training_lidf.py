"""LIDF's training: its phases, its losses by hand, and what each stage learns."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
import torch
from torch import Tensor
from training_set import SIDE, TINY, packed, trained, wishes, write_scenes

from benchmark.methods.depth.lidf.lidf import LIDFPrediction
from benchmark.methods.depth.lidf.voxels import Pairs, Rays, Refinements, Terminations
from benchmark.training.catalogue import get_trainable
from benchmark.training.depth.lidf_training import (
    COARSE,
    HARD,
    REFINE,
    LIDFLoss,
    end_loss,
    hardest,
    lidf_depth,
    lidf_inputs,
    lidf_step,
    with_neighbours,
)
from benchmark.training.fit import make_network
from benchmark.training.plan import plan_training
from benchmark.training.step import StepInfo, Target, model_input, target_of
from std_toolkit.errors import ToolkitError


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("lidf")
    return packed(top / "pack", write_scenes(top / "data"))


def a_target(b: int = 2, side: int = 5) -> Target:
    draw = torch.Generator().manual_seed(0)
    depth = torch.rand(b, 1, side, side, generator=draw, dtype=torch.float64) * 0.3 + 0.5
    depth[:, :, 0, :2] = 0
    K = torch.tensor([[7.0, 0, 2.1], [0, 6.5, 1.9], [0, 0, 1]], dtype=torch.float64)
    return Target(depth, depth > 0.6, K.expand(b, 3, 3))


def rays_of(target: Target, pixels: Tensor) -> Rays:
    h, w = target.depth.shape[-2:]
    u, v = pixels % w, pixels // w % h
    K = target.K[0]
    way = torch.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], torch.ones_like(u)], dim=1)
    return Rays(pixels, pixels // (h * w), way / way.norm(dim=1, keepdim=True), way[:, :0])


def first_stage(target: Target, logits: Tensor, depth: Tensor, pixels: Tensor) -> LIDFPrediction:
    """Every ray passes two voxels, of which the second one holds depths of 0.6 m and more."""
    rays = rays_of(target, pixels)
    count = len(pixels)
    slant = 1 / rays.direction[:, 2]
    ray = torch.arange(count).repeat_interleave(2)
    entry = torch.stack([0.4 * slant, 0.6 * slant], 1).flatten()
    leave = torch.stack([0.6 * slant, 0.9 * slant], 1).flatten()
    pairs = Pairs(ray, torch.zeros_like(ray), entry, leave)
    log = logits.reshape(count, 2).log_softmax(dim=1).flatten()
    none = entry.new_zeros(2 * count, 3)
    chosen = torch.arange(count) * 2
    told = Terminations(rays, pairs, log, entry * 0, none, chosen, chosen)
    return LIDFPrediction(depth, depth, None, told)


def second_stage(target: Target, depth: Tensor, pixels: Tensor) -> LIDFPrediction:
    return LIDFPrediction(
        depth, depth, None, None, Refinements(rays_of(target, pixels), (depth[:0],))
    )


@pytest.mark.parametrize("phase", [COARSE, REFINE, HARD])
def test_gradients_are_those_of_differences(phase):
    target = a_target()
    draw = torch.Generator().manual_seed(1)
    depth = 0.5 + 0.3 * torch.rand(target.depth.shape, generator=draw, dtype=torch.float64)
    pixels = torch.arange(3, 40)
    logits = torch.randn(2 * len(pixels), generator=draw, dtype=torch.float64)

    def total(depth: Tensor, logits: Tensor) -> Tensor:
        if phase == COARSE:
            found = first_stage(target, logits, depth, pixels)
        else:
            found = second_stage(target, depth, pixels)
        return LIDFLoss(hard_share=0.4)(found, target, phase).total

    assert torch.autograd.gradcheck(
        total, (depth.requires_grad_(), logits.requires_grad_()), eps=1e-7, atol=1e-4
    )


def test_the_first_stages_loss_is_the_sum_that_is_written_down():
    target = a_target(b=1, side=4)
    depth = target.depth.clone()
    depth[0, 0, 2, 1] += 0.02
    depth[0, 0, 1, 0] += 0.5  # not predicted
    pixels = torch.arange(8, 16)
    logits = torch.zeros(16, dtype=torch.float64)
    logits[0] = 2.0
    found = first_stage(target, logits, depth, pixels)
    parts = LIDFLoss()(found, target, COARSE).parts
    K = target.K[0]
    x, y = (1 - K[0, 2]) / K[0, 0], (2 - K[1, 2]) / K[1, 1]
    assert parts["positions"].item() == pytest.approx(
        0.02 * (abs(x) + abs(y) + 1).item() / 3 / 8, rel=1e-4
    )
    chances = [math.log(2)] * 7
    first = target.depth[0, 0, 2, 0].item()
    chances.append(math.log(1 + math.exp(-2.0 if first < 0.6 else 2.0)))
    assert parts["terminations"].item() == pytest.approx(sum(chances) / 8, rel=1e-5)
    total = LIDFLoss()(found, target, COARSE).total.item()
    expected = 100 * parts["positions"] + 0.5 * parts["terminations"] + 10 * parts["normals"]
    assert total == pytest.approx(expected.item(), rel=1e-5)
    # Three pixels have all of their neighbours; the bent ones are beside (2, 1).
    assert 0 < parts["normals"].item() < 1


def test_rays_that_end_in_none_of_their_voxels_say_nothing():
    target = a_target(b=1, side=4)
    target = target._replace(depth=torch.full_like(target.depth, 1.5))
    pixels = torch.arange(4)
    logits = torch.randn(8, dtype=torch.float64)
    found = first_stage(target, logits, target.depth, pixels)
    assert end_loss(found.terminations, target.depth).item() == 0


def test_the_hardest_tenth():
    apart = torch.arange(40.0).reshape(2, 1, 4, 5)
    known = apart < 30
    assert hardest(apart, known, 0.1).flatten().nonzero().flatten().tolist() == [27, 28, 29]
    assert hardest(apart, known, 0.01).sum() == 1
    assert not hardest(apart, known & False, 0.1).any()


def test_a_normal_needs_its_two_neighbours():
    known = torch.ones(1, 1, 4, 4, dtype=torch.bool)
    known[0, 0, 1, 1] = False
    found = with_neighbours(known)[0, 0]
    assert found.tolist() == [
        [True, False, True, False],
        [False, False, True, False],
        [True, True, True, False],
        [False] * 4,
    ]


def test_published_phases_and_rates(pack):
    config = plan_training(wishes("lidf", pack, steps=120, checkpoint_every=6, validate_every=6))[0]
    assert config.phases == {COARSE: 60, REFINE: 30, HARD: 30}
    rates = [config.rate(step) for step in (0, 59, 60, 89, 90, 119, 120)]
    assert rates == pytest.approx([1e-3] * 4 + [1e-4] * 3)
    places = [tuple(config.step_info(step)) for step in (0, 59, 60, 90, 119, 120)]
    assert places == [
        (COARSE, 0, 60), (COARSE, 59, 60), (REFINE, 0, 30), (HARD, 0, 30), (HARD, 29, 30),
        (HARD, 30, 30),
    ]  # fmt: skip
    odd = plan_training(wishes("lidf", pack, steps=7))[0]
    assert sum(odd.phases.values()) == 7
    chosen = wishes("lidf", pack, steps=None, phases={HARD: 3, COARSE: 4})
    config = plan_training(chosen)[0]
    assert config.steps == 7
    assert [config.step_info(step).phase for step in range(7)] == [COARSE] * 4 + [HARD] * 3


@pytest.mark.parametrize(
    ("method", "changes", "told"),
    [
        ("lidf", {"phases": {"fine": 3}}, "fine: the method has no such phase"),
        ("dfnet", {"phases": {"coarse": 3}}, "its training has only one"),
        ("lidf", {"phases": {"coarse": 3}, "steps": 3}, "--phases: do not go with --steps"),
        ("lidf", {"phases": {"coarse": -1}}, "coarse: must not be negative"),
        ("lidf", {"phases": {"coarse": 0}}, "steps: must be at least 1"),
    ],
)
def test_wrong_phases_are_told(method, changes, told, pack):
    with pytest.raises(ToolkitError) as error:
        plan_training(wishes(method, pack, **{"steps": None, **changes}))
    assert told in str(error.value)


@pytest.mark.slow
def test_a_stage_changes_its_own_weights_only(pack, tmp_path):
    """The weights after the first phase; then after all of them, in one run."""
    first = trained(
        wishes("lidf", pack, steps=None, phases={COARSE: 3}, checkpoint_every=3, validate_every=3),
        tmp_path / "first",
    )
    asked = wishes(
        "lidf", pack, steps=None, phases={COARSE: 3, REFINE: 2, HARD: 1}, checkpoint_every=3,
        validate_every=3,
    )  # fmt: skip
    whole = trained(asked, tmp_path / "whole")
    config, _, beginning = plan_training(asked)
    begun = make_network(get_trainable("lidf"), config, beginning).state_dict()
    for name, tensor in whole.items():
        if name.startswith("refinement."):
            assert torch.equal(first[name], begun[name]), name
            if "embed" not in name:  # a number that hardly changes
                assert not torch.equal(tensor, begun[name]), name
        else:
            assert torch.equal(first[name], tensor), name
            assert not torch.equal(begun[name], tensor) or "num_batches" in name, name
    rows = list(csv.DictReader((tmp_path / "whole" / "steps.csv").open()))
    assert [row["phase"] for row in rows] == [COARSE] * 3 + [REFINE] * 2 + [HARD]
    assert rows[0]["terminations"] and not rows[-1]["terminations"]
    # A second run that only refines begins with what the first one left.
    refined = trained(
        wishes(
            "lidf", pack, steps=None, phases={REFINE: 2}, checkpoint_every=2, validate_every=2,
            weights=tmp_path / "first" / "last.safetensors",
        ),
        tmp_path / "second",
    )  # fmt: skip
    assert torch.equal(refined["termination.last.weight"], first["termination.last.weight"])
    assert not torch.equal(
        refined["refinement.points.last.weight"], first["refinement.points.last.weight"]
    )


def test_true_voxels_are_told_at_the_beginning_only(pack, monkeypatch):
    config, data, beginning = plan_training(wishes("lidf", pack))
    network = make_network(get_trainable("lidf"), config, beginning)
    follows = []
    plain = type(network).forward

    def watched(self, *inputs, learns=None, follow=None):
        follows.append((learns, follow is not None))
        return plain(self, *inputs, learns=learns, follow=follow)

    monkeypatch.setattr(type(network), "forward", watched)
    seen = model_input(data.training[[0, 1]])
    for step_info in (StepInfo(COARSE, 5, 60), StepInfo(COARSE, 6, 60), StepInfo(REFINE, 0, 60)):
        lidf_step(network, LIDFLoss(), seen, step_info)
    assert follows == [(1, True), (1, False), (2, False)]


def test_doubted_and_asked_pixels_are_the_restorers(pack):
    config, data, beginning = plan_training(wishes("lidf", pack))
    seen = model_input(data.training[[0, 1]])
    hard = data.training.frame(0).mask_where(lambda i: i.material in (2, 3))
    for predict, mask in (("all", "objects"), ("missing", "objects"), ("missing", "holes")):
        settings = {**TINY["lidf"], "predict": predict, "mask": mask}
        config = plan_training(wishes("lidf", pack, settings=settings))[0]
        network = make_network(get_trainable("lidf"), config, beginning)
        _, depth, rays, believed, asked = lidf_inputs(network, seen)
        doubted = torch.from_numpy(hard) if mask == "objects" else torch.zeros(SIDE, SIDE).bool()
        assert torch.equal(believed[0, 0], (depth[0, 0] > 0) & ~doubted)
        assert asked.all() if predict == "all" else torch.equal(asked, ~believed)
        K = seen.batch["K"][0].numpy()
        assert rays[0, :, 3, 7].tolist() == pytest.approx(
            [(7 - K[0, 2]) / K[0, 0], (3 - K[1, 2]) / K[1, 1], 1]
        )
    with torch.no_grad():
        assert lidf_depth(network.eval(), data.training[[0, 1]]).shape == (2, SIDE, SIDE)


@pytest.mark.parametrize("phase", [COARSE, REFINE, HARD])
def test_frames_without_a_measurement_teach_nothing_and_break_nothing(pack, phase):
    config, data, beginning = plan_training(wishes("lidf", pack))
    network = make_network(get_trainable("lidf"), config, beginning)
    batch = data.training[[0, 1]]
    batch["raw"].zero_()
    loss = lidf_step(network, LIDFLoss(), model_input(batch), StepInfo(phase, 3, 4))
    loss.total.backward()
    assert loss.total.item() == 0
    assert all(torch.isfinite(p.grad).all() for p in network.parameters() if p.grad is not None)
    assert (target_of(batch).depth > 0).any()
