"""PointNet++: every operation against a plain loop, and what its layers must not depend on."""

import numpy as np
import pytest
import torch

from benchmark.methods.pointnet import grouping as grouping_module
from benchmark.methods.pointnet.grouping import at, ball_query, farthest_points, group, nearest
from benchmark.methods.pointnet.layers import (
    FeaturePropagation,
    Scale,
    SetAbstraction,
    SharedMLP,
    interpolated,
)
from std_toolkit.errors import ToolkitError


def _cloud(b, n, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).random((b, n, 3)).astype(np.float32))


def _farthest_by_loop(points, count):
    chosen = [0]
    while len(chosen) < count:
        least = [min(float(((p - points[c]) ** 2).sum()) for c in chosen) for p in points]
        chosen.append(int(np.argmax(least)))
    return chosen


def _ball_by_loop(points, centre, radius, count):
    squared = ((points - centre) ** 2).sum(axis=1)
    inside = [i for i in range(len(points)) if squared[i] < radius**2][:count]
    first = inside[0] if inside else int(squared.argmin())
    return inside + [first] * (count - len(inside))


def test_farthest_points_are_those_of_a_plain_loop():
    points = _cloud(3, 60)
    found = farthest_points(points, 25).numpy()
    for cloud, chosen in zip(points.numpy(), found, strict=True):
        assert chosen.tolist() == _farthest_by_loop(cloud, 25)


def test_all_points_are_chosen_once_where_all_are_asked_for():
    found = farthest_points(_cloud(2, 40), 40)
    assert (found.sort(dim=1).values == torch.arange(40)).all()


@pytest.mark.parametrize("count", [0, 9])
def test_no_more_points_are_chosen_than_there_are(count):
    with pytest.raises(ToolkitError, match=f"{count} points of 8"):
        farthest_points(_cloud(1, 8), count)


@pytest.mark.parametrize(("radius", "count"), [(0.25, 8), (0.05, 4), (2.0, 90), (1e-6, 3)])
@pytest.mark.parametrize("pairs", [1 << 22, 500])
def test_ball_query_is_that_of_a_plain_loop(monkeypatch, radius, count, pairs):
    monkeypatch.setattr(grouping_module, "_PAIRS", pairs)
    points, centres = _cloud(2, 70), _cloud(2, 12, seed=1)
    found = ball_query(points, centres, radius, count).numpy()
    assert found.shape == (2, 12, count)
    for b in range(2):
        for m in range(12):
            wanted = _ball_by_loop(points[b].numpy(), centres[b, m].numpy(), radius, count)
            assert found[b, m].tolist() == wanted


def test_neighbours_are_found_a_metre_from_the_origin():
    """Where |a|^2 + |b|^2 - 2ab in float32 rounds away distances below a millimetre."""
    near = _cloud(1, 200) * 1e-3
    moved = near + torch.tensor([0.0, 0.0, 3.0])
    wanted = ball_query(moved.double().float(), moved[:, :20], 3e-4, 16)
    loop = [
        _ball_by_loop(moved[0].double().numpy(), moved[0, m].double().numpy(), 3e-4, 16)
        for m in range(20)
    ]
    assert wanted[0].tolist() == loop


@pytest.mark.parametrize("pairs", [1 << 22, 100])
def test_nearest_points_are_those_of_a_plain_loop(monkeypatch, pairs):
    monkeypatch.setattr(grouping_module, "_PAIRS", pairs)
    points, centres = _cloud(2, 50), _cloud(2, 9, seed=1)
    squared, index = nearest(points, centres, 3)
    for b in range(2):
        away = ((centres[b][:, None] - points[b][None]) ** 2).sum(-1).numpy()
        wanted = np.argsort(away, axis=1, kind="stable")[:, :3]
        assert (index[b].numpy() == wanted).all()
        np.testing.assert_allclose(squared[b], np.take_along_axis(away, wanted, 1), rtol=1e-6)
    with pytest.raises(ToolkitError, match="3 nearest of 2"):
        nearest(points[:, :2], centres, 3)


def test_groups_hold_relative_places_and_features():
    points, features = _cloud(2, 30), torch.randn(2, 5, 30)
    centres = points[:, :4]
    index = torch.randint(30, (2, 4, 6))
    found = group(points, centres, features, index, scale=0.5)
    for b, m, k in np.ndindex(2, 4, 6):
        i = index[b, m, k]
        np.testing.assert_allclose(found[b, :3, m, k], (points[b, i] - centres[b, m]) / 0.5)
        assert torch.equal(found[b, 3:, m, k], features[b, :, i])
    assert torch.equal(at(features, index[:, 0])[1, :, 2], features[1, :, index[1, 0, 2]])


def test_interpolation_is_exact_at_known_places_and_weighted_between():
    known = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [9, 9, 9]]])
    features = torch.tensor([[[1.0, 2.0, 4.0, 100.0]]])
    assert torch.allclose(interpolated(known, features, known[:, :3]), features[..., :3], atol=1e-5)
    found = interpolated(known, features, torch.tensor([[[0.5, 0.0, 0.0]]]))
    weights = np.array([1 / 0.25, 1 / 0.25, 1 / 4.25])
    wanted = weights @ [1, 2, 4] / weights.sum()
    assert found.item() == pytest.approx(wanted, rel=1e-5)
    one = interpolated(known[:, :1], features[..., :1], known)
    assert torch.allclose(one, torch.ones(1, 1, 4))


def _network():
    torch.manual_seed(0)
    scales = (Scale(0.2, 8, (8, 12)), Scale(0.5, 16, (8, 10)))
    return SetAbstraction(16, scales, 4, normalise=True)


def test_set_abstraction_is_the_maximum_over_each_neighbourhood():
    network = _network().eval()
    points, features = _cloud(2, 64), torch.randn(2, 4, 64)
    with torch.no_grad():
        found = network(points, features)
        assert found.points.shape == (2, 16, 3)
        assert found.features.shape == (2, 22, 16) and network.outputs == 22
        assert torch.equal(found.points[1, 3], points[1, found.chosen[1, 3]])
        near = _ball_by_loop(points[1].numpy(), found.points[1, 3].numpy(), 0.2, 8)
        inputs = torch.cat([((points[1, near] - found.points[1, 3]) / 0.2).T, features[1][:, near]])
        wanted = network.mlps[0](inputs[None, :, None]).amax(dim=3)[0, :, 0]
    torch.testing.assert_close(found.features[1, :12, 3], wanted)


def test_set_abstraction_sees_no_translation_of_all_points():
    network = _network().eval()
    # Quarters: moved without rounding.
    points = torch.randint(8, (1, 64, 3)).float() / 4
    features = torch.randn(1, 4, 64)
    with torch.no_grad():
        here = network(points, features)
        there = network(points + torch.tensor([4.0, -8.0, 16.0]), features)
    assert torch.equal(here.chosen, there.chosen)
    assert torch.equal(here.features, there.features)


def test_every_parameter_and_input_gets_a_gradient():
    abstraction = SetAbstraction(12, (Scale(0.6, 8, (8, 8)),), 4)
    propagation = FeaturePropagation(8 + 4, (16, 5))
    points, features = _cloud(2, 40), torch.randn(2, 4, 40, requires_grad=True)
    few = abstraction(points, features)
    out = propagation(few.points, few.features, points, features)
    assert out.shape == (2, 5, 40)
    out.square().sum().backward()
    for name, parameter in [*abstraction.named_parameters(), *propagation.named_parameters()]:
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, name
    assert features.grad.abs().sum() > 0


def test_gradients_of_propagation_are_right():
    propagation = FeaturePropagation(4, (3,)).eval().double()
    known, wanted = _cloud(1, 6).double(), _cloud(1, 9, seed=2).double()
    features = torch.randn(1, 4, 6, dtype=torch.double, requires_grad=True)
    assert torch.autograd.gradcheck(lambda f: propagation(known, f, wanted), features)


def test_a_shared_network_treats_every_point_alike():
    network = SharedMLP(4, (8, 3), last_linear=True).eval()
    features = torch.randn(2, 4, 10)
    order = torch.randperm(10)
    torch.testing.assert_close(network(features)[..., order], network(features[..., order]))
    assert isinstance(network[-1], torch.nn.Conv1d) and network[-1].bias is not None
    with pytest.raises(ToolkitError, match="at least one scale"):
        SetAbstraction(4, (), 4)
