"""GraspNet's loss: gradients by differences, values by a plain loop."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from benchmark.methods.grasp.graspnet.graspnet_network import Approaches, Operations
from benchmark.training.grasp.grasp_step import GraspNetLoss, GraspTarget

B, S, V, A, D = 2, 5, 6, 3, 2


def a_target(seed: int = 0) -> GraspTarget:
    draw = torch.Generator().manual_seed(seed)

    def uniform(*shape: int, most: float = 1.0) -> Tensor:
        return most * torch.rand(*shape, generator=draw, dtype=torch.float64)

    scores = uniform(B, S, A, D, most=1.7)
    scores[0, 0] = 0  # a seed whose view has no grasp
    scores[1, 1, :, 0] = 0.05  # and one with hardly any at one depth
    return GraspTarget(
        torch.tensor([[1, 1, 1, 0, -1], [1, 1, 0, 0, 1]]),
        torch.tensor([[1, 1, 0, 0, 0], [1, 1, 0, 0, 1]]).bool(),
        uniform(B, S, V, most=1.7),
        scores,
        uniform(B, S, A, D, most=0.1),
        uniform(B, S, A, D, most=0.05),
    )


def an_answer(seed: int = 1) -> list[Tensor]:
    draw = torch.Generator().manual_seed(seed)
    shapes = [(B, 2, S), (B, S, V), *[(B, S, A, D)] * 4]
    return [torch.randn(shape, generator=draw, dtype=torch.float64) for shape in shapes]


def told(answer: list[Tensor], target: GraspTarget, loss: GraspNetLoss | None = None) -> Tensor:
    loss = loss or GraspNetLoss()
    return loss(Approaches(*answer[:2]), Operations(*answer[2:]), target).total


def test_gradients_are_those_of_differences():
    target = a_target()
    answer = [part.requires_grad_() for part in an_answer()]
    assert torch.autograd.gradcheck(lambda *parts: told(list(parts), target), answer, eps=1e-7)


def huber(x: float) -> float:
    return 0.5 * x * x if abs(x) < 1 else abs(x) - 0.5


def test_the_value_is_that_of_a_loop():
    target, answer = a_target(), an_answer()
    objectness, views, scores, turns, widths, tolerances = (part.tolist() for part in answer)
    ce, mse, of_views = [], [], []
    for b in range(B):
        for s in range(S):
            label = int(target.objectness[b, s])
            if label >= 0:
                logits = [objectness[b][0][s], objectness[b][1][s]]
                ce.append(math.log(sum(map(math.exp, logits))) - logits[label])
            if not target.known[b, s]:
                continue
            mse.append(
                sum((views[b][s][v] - float(target.views[b, s, v])) ** 2 for v in range(V)) / V
            )
            for d in range(D):
                labels = target.scores[b, s, :, d].tolist()
                a = labels.index(max(labels))
                if labels[a] <= 0.1:
                    continue
                logits = [turns[b][s][k][d] for k in range(A)]
                of_views.append(
                    huber(scores[b][s][a][d] - labels[a])
                    + math.log(sum(map(math.exp, logits)))
                    - logits[a]
                    + huber((widths[b][s][a][d] - float(target.widths[b, s, a, d])) / 0.1)
                    + huber((tolerances[b][s][a][d] - float(target.tolerances[b, s, a, d])) / 0.05)
                )
    assert len(of_views) == 2 * 4 - 1  # four seeds are known and have grasps, one at one depth
    expected = sum(ce) / len(ce) + sum(mse) / len(mse) + 0.2 * sum(of_views) / len(of_views)
    assert told(answer, target).item() == pytest.approx(expected, rel=1e-12)


def test_what_is_said_of_seeds_that_nobody_knows_does_not_matter():
    target, answer, other = a_target(), an_answer(), an_answer()
    unknown = ~target.known
    for part in other[1:]:
        part[unknown] += 3.0
    other[0][0, :, 4] += 7.0  # whether there is an object is not known there
    assert told(answer, target) == told(other, target)


def test_nothing_known_costs_nothing_and_has_finite_gradients():
    target = a_target()
    nothing = target._replace(
        objectness=torch.full((B, S), -1), known=torch.zeros(B, S, dtype=torch.bool)
    )
    answer = [part.requires_grad_() for part in an_answer()]
    loss = told(answer, nothing)
    loss.backward()
    assert loss == 0
    assert all(torch.isfinite(part.grad).all() for part in answer)


def test_the_truth_costs_nothing_but_what_a_softmax_does():
    target = a_target()
    sure = 40.0
    objectness = torch.zeros(B, 2, S, dtype=torch.float64)
    objectness[:, 1] = sure * (2.0 * (target.objectness == 1) - 1)
    turns = sure * torch.nn.functional.one_hot(target.scores.argmax(2), A).permute(0, 1, 3, 2)
    answer = [
        objectness,
        target.views,
        target.scores,
        turns.double(),
        target.widths,
        target.tolerances,
    ]
    assert told(answer, target).item() < 1e-12
    for part in (1, 2, 4, 5):
        wrong = list(answer)
        wrong[part] = wrong[part] + 0.01
        assert told(wrong, target).item() > 1e-7


def test_of_equally_good_turns_the_one_amid_others_is_meant():
    target, answer = a_target(), an_answer()
    turns = 12
    scores = torch.zeros(1, 1, turns, 1, dtype=torch.float64)
    scores[0, 0, [11, 0, 1, 5]] = 1.1  # half a turn is the same grasp: 11 is beside 0
    one = GraspTarget(
        torch.ones(1, 1, dtype=torch.long),
        torch.ones(1, 1, dtype=torch.bool),
        target.views[:1, :1],
        scores,
        scores * 0,
        scores * 0,
    )
    found = {}
    for turn in range(turns):
        logits = torch.zeros_like(scores)
        logits[0, 0, turn] = 5
        zeros = torch.zeros_like(scores)
        said = Operations(scores, logits, zeros, zeros)
        approaches = Approaches(answer[0][:1, :, :1], answer[1][:1, :1])
        found[turn] = GraspNetLoss()(approaches, said, one).parts["turn"].item()
    assert min(found, key=found.__getitem__) == 0
    scores[0, 0, 5] = 1.79  # better by a step, and alone
    logits = torch.zeros_like(scores)
    logits[0, 0, 5] = 5
    zeros = torch.zeros_like(scores)
    approaches = Approaches(answer[0][:1, :, :1], answer[1][:1, :1])
    said = Operations(scores, logits, zeros, zeros)
    assert GraspNetLoss()(approaches, said, one).parts["turn"] < 0.1
