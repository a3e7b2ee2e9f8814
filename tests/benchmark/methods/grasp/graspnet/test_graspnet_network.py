"""The network: its views, cylinders, sizes, and what does not change its answers."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from benchmark.methods.grasp.graspnet.cloud import (
    PRESETS,
    GraspNetConfig,
    fibonacci_views,
    gripper_rotations,
    rotation_of,
)
from benchmark.methods.grasp.graspnet.graspnet import best_of_seeds
from benchmark.methods.grasp.graspnet.graspnet_network import (
    Approaches,
    GraspNetwork,
    Operations,
    Seeds,
    group_cylinders,
)
from benchmark.methods.network import parameter_count
from benchmark.training.grasp.grasp_step import GraspNetLoss, GraspTarget
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import so3_exp

TINY = GraspNetConfig(
    points=256,
    level_points=(96, 40, 24, 12),
    level_neighbours=(8, 8, 8, 8),
    width=8,
    views=20,
    angles=4,
    depths=(0.01, 0.03),
    cylinder_points=8,
)


def a_cloud(count: int = 256, seed: int = 0, batch: int = 1) -> torch.Tensor:
    draw = torch.Generator().manual_seed(seed)
    box = torch.tensor([0.2, 0.2, 0.08])
    return torch.rand(batch, count, 3, generator=draw) * box + torch.tensor([0, 0, 0.5])


def turned(count: int, seed: int = 0) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    return torch.from_numpy(np.stack([so3_exp(rng.normal(size=3)) for _ in range(count)])).float()


def a_network(config: GraspNetConfig = TINY) -> GraspNetwork:
    torch.manual_seed(1)
    return GraspNetwork(config).eval()


def test_views_are_spread_evenly_and_rotations_approach_from_them():
    views = fibonacci_views(300)
    assert np.allclose(np.linalg.norm(views, axis=1), 1)
    apart = np.degrees(np.arccos(np.clip(views @ views.T - 2 * np.eye(300), -1, 1)).min(axis=1))
    # 300 equal caps have a radius of 6.6 degrees: neighbours are about twice that apart.
    assert apart.min() > 8
    assert apart.max() < 14
    rotations = gripper_rotations(300, 12)
    assert np.allclose(rotations @ rotations.swapaxes(-1, -2), np.eye(3))
    assert np.allclose(np.linalg.det(rotations), 1)
    assert np.allclose(rotations[:, :, :, 0], -views[:, None])
    assert np.allclose(rotations[:, 0, 2, 1], 0)  # y is level before the turn
    fifteen = so3_exp([math.radians(15), 0, 0])
    assert np.allclose(rotations[:, 4], rotations[:, 3] @ fifteen)
    # Twelve steps are half a turn, which makes the same grasp with swapped fingers.
    assert np.allclose(rotations[:, 11] @ fifteen, rotations[:, 0] * [1, -1, -1])


def test_a_view_from_straight_above_or_below_has_a_rotation():
    for z in (1.0, -1.0):
        R = rotation_of([0, 0, z])
        assert np.allclose(R.T @ R, np.eye(3))
        assert np.linalg.det(R) == pytest.approx(1)


def test_cylinders_hold_the_first_points_within_them():
    cloud, rotations = a_cloud(400), turned(30)[None]
    seeds = cloud[:, :30]
    sizes = {"radius": 0.03, "behind": 0.02}
    ends = (0.01, 0.04)
    found = group_cylinders(cloud, seeds, rotations, **sizes, ends=ends, count=6)
    assert found.shape == (1, 30, 2, 6, 3)
    full = 0
    for k in range(30):
        local = (cloud[0] - seeds[0, k]).double() @ rotations[0, k].double()
        across = local[:, 1:].norm(dim=1)
        for d, end in enumerate(ends):
            inside = (across < 0.03) & (local[:, 0] > -0.02) & (local[:, 0] < end)
            wanted = local[inside][:6]
            full += len(wanted) == 6
            wanted = torch.cat([wanted, wanted[:1].expand(6 - len(wanted), 3)])
            assert torch.allclose(found[0, k, d].double(), wanted, atol=1e-6)
    assert 0 < full < 60  # both kinds occur: those that are full, and those that are filled up


def test_an_empty_cylinder_is_filled_and_parts_of_a_batch_do_not_mix():
    cloud = a_cloud(300, batch=2)
    rotations = turned(8).expand(2, 8, 3, 3)
    sizes = {"radius": 0.02, "behind": 0.01, "ends": (0.02,), "count": 4}
    both = group_cylinders(cloud, cloud[:, :8], rotations, **sizes)
    for k in range(2):
        one = group_cylinders(cloud[k : k + 1], cloud[k : k + 1, :8], rotations[:1], **sizes)
        assert torch.allclose(both[k : k + 1], one, atol=1e-6)
    far = cloud[:, :8] + 5
    assert torch.isfinite(group_cylinders(cloud, far, rotations, **sizes)).all()


def test_the_published_network_has_the_published_layers():
    network = GraspNetwork()
    # Weights of convolutions, and scale and shift of their normalisation.
    levels = [(3, 64, 64, 128), *[(131, 128, 128, 256)], *[(259, 128, 128, 256)] * 2]
    back = [(512, 256, 256)] * 2
    cylinder = [(3, 64, 128, 256)]
    trunks = [(256, 128, 128)] * 2
    hidden = [(256, 256, 302)]
    count = 0
    for widths in (*levels, *back, *cylinder, *trunks, *hidden):
        count += sum(a * b + 2 * b for a, b in pairwise(widths))
    for inputs, outputs in ((302, 302), (128, 36), (128, 12)):
        count += inputs * outputs + outputs
    assert parameter_count(network) == count
    assert parameter_count(GraspNetwork(PRESETS["compact"])) < count / 4


def test_seeds_are_points_of_the_cloud_and_have_everything_said_of_them():
    network, cloud = a_network(), a_cloud(batch=2)
    seeds = network.seeds(cloud)
    assert seeds.points.shape == (2, 40, 3)
    for k in range(2):
        assert torch.equal(cloud[k][seeds.chosen[k]], seeds.points[k])
        assert len(seeds.chosen[k].unique()) == 40
    assert seeds.approaches.objectness.shape == (2, 2, 40)
    assert seeds.approaches.views.shape == (2, 40, 20)
    found = network.operations(cloud, seeds.points, turned(40).expand(2, 40, 3, 3))
    assert all(part.shape == (2, 40, 4, 2) for part in found)


def test_a_grasp_does_not_change_when_everything_is_moved():
    network, cloud = a_network(), a_cloud()
    points, rotations = cloud[:, :20], turned(20)[None]
    before = network.operations(cloud, points, rotations)
    R, t = turned(1, 5)[0], torch.tensor([0.3, -0.2, 0.1])
    moved = cloud @ R.T + t
    after = network.operations(moved, points @ R.T + t, R @ rotations)
    for one, other in zip(before, after, strict=True):
        assert torch.allclose(one, other, atol=1e-4)


def test_points_that_come_twice_change_nothing():
    network, cloud = a_network(), a_cloud(256)
    twice = torch.cat([cloud, cloud[:, :50]], dim=1)
    one, other = network.seeds(cloud), network.seeds(twice)
    assert torch.equal(one.points, other.points)


def test_every_parameter_learns():
    network, cloud = a_network().train(), a_cloud(batch=2)
    seeds = network.seeds(cloud)
    rotations = turned(40).expand(2, 40, 3, 3)
    operations = network.operations(cloud, seeds.points, rotations)
    draw = torch.Generator().manual_seed(3)
    shape = (2, 40, 4, 2)
    target = GraspTarget(
        (torch.rand(2, 40, generator=draw) < 0.5).long(),
        torch.rand(2, 40, generator=draw) < 0.5,
        torch.rand(2, 40, 20, generator=draw),
        torch.rand(shape, generator=draw),
        torch.rand(shape, generator=draw) * 0.1,
        torch.rand(shape, generator=draw) * 0.05,
    )
    GraspNetLoss()(seeds.approaches, operations, target).total.backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().sum() > 0, name


def test_what_is_said_becomes_the_grasp_that_is_meant():
    """Two seeds whose best view, turn and depth are set by hand."""
    config = TINY
    cloud = a_cloud()
    rotations = torch.from_numpy(gripper_rotations(20, 4)).float()
    views = torch.zeros(1, 2, 20)
    views[0, 0, 7] = views[0, 1, 3] = 1.0
    objectness = torch.tensor([[[0.0, 3.0], [1.0, 2.0]]])  # logits of nothing, of object
    scores = torch.zeros(1, 2, 4, 2)
    turns = torch.zeros(1, 2, 4, 2)
    widths = torch.full((1, 2, 4, 2), 0.01)
    tolerances = torch.full((1, 2, 4, 2), 0.02)
    turns[0, 0, 2, 1] = turns[0, 0, 1, 0] = 5
    scores[0, 0, 2, 1], scores[0, 0, 1, 0], scores[0, 0, 3, 0] = 1.0, 0.5, 9.0
    widths[0, 0, 2, 1], widths[0, 1] = 0.05, 0.2
    tolerances[0, 0, 2, 1] = 0.025

    class Said(GraspNetwork):
        def seeds(self, cloud):
            return Seeds(torch.arange(2)[None], cloud[:, :2], Approaches(objectness, views))

        def operations(self, cloud, points, given):  # noqa: ARG002
            assert torch.equal(given[0], rotations[[7, 3], 0])
            return Operations(scores, turns, widths, tolerances)

    (found,) = best_of_seeds(Said(config).eval(), cloud, rotations)
    assert found.on_object.tolist() == [True, False]
    grasps = found.grasps
    # The score of a turn that is not the likeliest of its depth, 9, counts for nothing.
    assert grasps.depths.tolist() == pytest.approx([0.03, 0.01])
    assert np.allclose(grasps.rotations[0], rotations[7, 2].numpy())
    assert np.allclose(grasps.translations, cloud[0, :2].numpy())
    assert grasps.widths.tolist() == pytest.approx([1.2 * 0.05, 0.1])
    assert grasps.scores[0] == pytest.approx(1.0 * 0.025 / 0.05)


def test_sizes_that_make_no_sense_are_refused():
    for changes in (
        {"points": 100},
        {"level_points": (96, 100, 24, 12)},
        {"views": 0},
        {"depths": (-0.02, 0.01)},
    ):
        with pytest.raises(ToolkitError):
            GraspNetConfig(**{**{"level_points": (128, 64, 32, 16)}, "points": 256, **changes})
