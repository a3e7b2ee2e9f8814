"""LIDF's parts against what is written out, and known answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from lidf_scenes import pixel_rays_of
from torch.nn.functional import normalize

from benchmark.methods.depth.lidf.features import (
    PointNet,
    cell_means,
    encoded,
    encoded_size,
    first_largest_of_groups,
    largest_of_groups,
    log_softmax_of_groups,
    spread,
    surroundings,
)
from benchmark.methods.depth.lidf.refinement import (
    Features,
    Head,
    OffsetHead,
    disturbances,
    leaky_clip,
)
from benchmark.methods.depth.lidf.voxels import (
    Grid,
    LIDFConfig,
    Pairs,
    Voxels,
    occupied,
    passed,
    points_on,
    true_pairs,
)

CONFIG = LIDFConfig()


def test_the_largest_of_groups_is_a_loops():
    torch.manual_seed(0)
    values = torch.randn(200, 5, requires_grad=True)
    group = torch.randint(0, 30, (200,))
    group[group == 7] = 8  # a group without members
    found = largest_of_groups(values, group, 31)
    for index in range(31):
        members = values[group == index]
        expected = members.max(dim=0).values if len(members) else torch.zeros(5)
        assert torch.equal(found[index], expected)
    assert (found[7] == 0).all() and (found[30] == 0).all() and (found < 0).any()
    # The gradient goes to the largest ones alone.
    found.sum().backward()
    assert values.grad is not None and values.grad.sum() == 5 * len(group.unique())


def test_softmax_of_groups():
    torch.manual_seed(0)
    logits = 50 * torch.randn(300)
    logits[:3] = torch.tensor([1e4, -1e4, 1e4])
    group = torch.randint(0, 40, (300,)).sort().values
    found = log_softmax_of_groups(logits, group, 41)
    assert found.isfinite().all()
    for index in group.unique():
        expected = logits[group == index].log_softmax(0)
        torch.testing.assert_close(found[group == index], expected, rtol=1e-4, atol=1e-5)
    total = torch.zeros(41).index_add(0, group, found.exp())
    torch.testing.assert_close(total[group.unique()], torch.ones(len(group.unique())))


def test_the_first_largest_of_groups():
    values = torch.tensor([1.0, 3, 3, -5, -7, 2])
    group = torch.tensor([0, 0, 0, 2, 2, 3])
    assert first_largest_of_groups(values, group, 5).tolist() == [1, -1, 3, 5, -1]
    none = first_largest_of_groups(values[:0], group[:0], 3)
    assert none.tolist() == [-1, -1, -1]


def test_encoding_is_its_formula():
    (found,) = encoded(torch.tensor([[0.3, -0.7, 1.1]]), 8).tolist()
    assert len(found) == encoded_size(8) == 51 and encoded_size(4) == 27
    assert found[:3] == pytest.approx([0.3, -0.7, 1.1])
    for power in range(8):
        at = 3 + 6 * power
        for axis, x in enumerate((0.3, -0.7, 1.1)):
            # Doubling the angle doubles what float32 has rounded off.
            assert found[at + axis] == pytest.approx(math.sin(2**power * x), abs=1e-4)
            assert found[at + 3 + axis] == pytest.approx(math.cos(2**power * x), abs=1e-4)


def test_the_grid_is_nine_voxels_each_way():
    grid = Grid(CONFIG)
    assert grid.shape == (9, 9, 9) and grid.low == (-1.125, -1.125, -0.125)
    points = torch.tensor([[-1.12, -1.12, -0.12], [1.12, 1.12, 2.12], [0, 0, 0], [0, 0, 2.13]])
    cells, inside = grid.cells_of(points)
    assert cells.tolist() == [0, 728, (4 * 9 + 4) * 9, (4 * 9 + 4) * 9 + 8]
    assert inside.tolist() == [True, True, True, False]
    corner = grid.corners(cells)
    assert ((points[:3] >= corner[:3]) & (points[:3] < corner[:3] + 0.25)).all()


def test_occupied_voxels_hold_their_points_and_keep_images_apart():
    torch.manual_seed(0)
    points = torch.rand(500, 3) * torch.tensor([2.2, 2.2, 2.2]) - torch.tensor([1.1, 1.1, 0.1])
    image = torch.randint(0, 3, (500,)).sort().values
    voxels, voxel = occupied(Grid(CONFIG), points, image)
    assert torch.equal(voxels.image[voxel], image)
    apart = points - voxels.corner[voxel]
    assert (apart >= -1e-6).all() and (apart <= 0.25 + 1e-6).all()
    assert len(torch.unique(torch.cat([voxels.image[:, None], voxels.corner], 1), dim=0)) == len(
        voxels.image
    )
    assert (voxels.image.diff() >= 0).all()


def test_rays_pass_the_voxels_in_which_their_points_are():
    """The slab test against walking along the rays in steps of a millimetre."""
    torch.manual_seed(0)
    grid = Grid(CONFIG)
    points = torch.rand(400, 3) * 2 - torch.tensor([1.0, 1.0, 0.0])
    image = (torch.arange(400) >= 200).long()
    voxels, _ = occupied(grid, points, image)
    direction = torch.randn(60, 3)
    direction[:, 2] = direction[:, 2].abs()
    direction[0], direction[30] = torch.tensor([0, 0, 1.0]), torch.tensor([0.6, 0, 0.8])
    direction = normalize(direction, dim=1)
    of = (torch.arange(60) >= 30).long()
    found = passed(direction, of, voxels, grid.side)
    assert (found.ray.diff() >= 0).all() and (found.exit > found.entry).all()
    keys = {
        (int(i), *(c / 0.25 - 0.5).round().int().tolist()): number
        for number, (i, c) in enumerate(zip(voxels.image, voxels.corner, strict=True))
    }
    steps = torch.arange(0.0005, 3.0, 0.001)
    walked: dict[tuple[int, int], list[float]] = {}
    for ray in range(60):
        at = ((steps[:, None] * direction[ray] + 0.125) / 0.25).floor().int() - 1
        for step, place in zip(steps.tolist(), at.tolist(), strict=True):
            number = keys.get((int(of[ray]), *place))
            if number is not None:
                walked.setdefault((ray, number), []).append(step)
    told = {(int(r), int(v)): (float(a), float(b)) for r, v, a, b in zip(*found, strict=True)}
    assert set(walked) <= set(told)
    for key, (entry, leave) in told.items():
        if key in walked:
            assert max(entry, 0) == pytest.approx(walked[key][0], abs=1.1e-3)
            assert leave == pytest.approx(walked[key][-1], abs=1.1e-3)
        else:  # a corner that the walk has stepped over
            assert leave - max(entry, 0) < 1.1e-3
    assert len(walked) > 150


def test_no_voxels_and_no_rays():
    none = Voxels(torch.zeros(0).long(), torch.zeros(0, 3))
    ahead = torch.tensor([[0, 0, 1.0]])
    assert len(passed(ahead, torch.zeros(1).long(), none, 0.25).ray) == 0
    one = Voxels(torch.zeros(1).long(), torch.tensor([[-0.125, -0.125, 0.5]]))
    assert len(passed(ahead[:0], torch.zeros(0).long(), one, 0.25).ray) == 0
    pairs = passed(ahead, torch.zeros(1).long(), one, 0.25)
    assert (pairs.entry.item(), pairs.exit.item()) == (0.5, 0.75)


def test_a_plane_comes_back_from_true_offsets():
    """Through the true voxel, and the offset of the plane in it, to the plane."""
    grid = Grid(CONFIG)
    rays = pixel_rays_of(48, 64)[0].flatten(1).T
    normal = torch.tensor([0.3, -0.4, 1.0])
    points = rays * (0.9 / (rays @ normal))[:, None]
    image = torch.zeros(len(points)).long()
    voxels, voxel = occupied(grid, points, image)
    direction = normalize(rays, dim=1)
    pairs = passed(direction, image, voxels, grid.side)
    distance = points.norm(dim=1)
    true = true_pairs(pairs, distance)
    assert (true >= 0).all() and torch.equal(pairs.ray[true], torch.arange(len(points)))
    assert (pairs.voxel[true] == voxel).float().mean() > 0.999
    diagonal = 3**0.5 * grid.side
    offset = (distance[pairs.ray] - pairs.entry) / diagonal
    assert (offset[true] >= 0).all() and (offset[true] <= 1).all()
    found = points_on(direction, pairs, offset, diagonal)[true]
    torch.testing.assert_close(found, points, rtol=0, atol=1e-6)


def test_no_true_pair_where_no_depth_is_known():
    pairs = Pairs(
        torch.tensor([0, 0, 1, 2]),
        torch.arange(4),
        torch.tensor([-0.1, 0.5, 0.5, 0.5]),
        torch.tensor([0.1, 0.7, 0.7, 0.7]),
    )
    found = true_pairs(pairs, torch.tensor([0.6, 0.0, 0.9, 0.4]))
    assert found.tolist() == [1, -1, -1, -1]


def roi_align(image: np.ndarray, left: float, top: float, side: float, bins: int) -> np.ndarray:
    """ROIAlign as it is defined, aligned, with as many samples as the window has pixels."""
    cell, samples = side / bins, int(side / bins)
    found = np.zeros((bins, bins))
    for i in range(bins):
        for j in range(bins):
            for k in range(samples):
                for m in range(samples):
                    y = top - 0.5 + cell * i + cell * (k + 0.5) / samples
                    x = left - 0.5 + cell * j + cell * (m + 0.5) / samples
                    y0, x0 = int(np.floor(y)), int(np.floor(x))
                    for row, wy in ((y0, 1 - (y - y0)), (y0 + 1, y - y0)):
                        for column, wx in ((x0, 1 - (x - x0)), (x0 + 1, x - x0)):
                            if wy * wx:
                                found[i, j] += wy * wx * image[row, column] / samples**2
    return found


def test_surroundings_are_roi_align():
    torch.manual_seed(0)
    features = torch.randn(2, 3, 20, 24)
    means = cell_means(features)
    assert means.shape == (2, 3, 24, 28)
    pixels = torch.tensor([0 * 480 + 9 * 24 + 11, 1 * 480 + 4 * 24 + 4, 480 + 15 * 24 + 19])
    found = surroundings(means, pixels).reshape(3, 3, 2, 2).numpy()
    for index, (image, row, column) in enumerate(((0, 9, 11), (1, 4, 4), (1, 15, 19))):
        for channel in range(3):
            plain = features[image, channel].double().numpy()
            expected = roi_align(plain, column - 4, row - 4, 8, 2)
            np.testing.assert_allclose(found[index, channel], expected, atol=1e-5)


def test_surroundings_of_a_linear_image_are_exact():
    y, x = torch.meshgrid(torch.arange(30.0), torch.arange(40.0), indexing="ij")
    means = cell_means((2 * x - 3 * y + 1)[None, None])
    pixels = torch.tensor([10 * 40 + 20])
    # Centres of the bins: two pixels and a half before, one and a half behind.
    expected = [2 * (20 + dx) - 3 * (10 + dy) + 1 for dy in (-2.5, 1.5) for dx in (-2.5, 1.5)]
    assert surroundings(means, pixels).flatten().tolist() == pytest.approx(expected, abs=1e-4)


def test_surroundings_at_the_edges_go_on_as_the_edge():
    flat = torch.full((1, 1, 9, 9), 3.5)
    found = surroundings(cell_means(flat), torch.arange(81))
    assert found.shape == (81, 4) and (found - 3.5).abs().max() < 1e-5


def test_measurements_are_taken_from_everywhere():
    valid = torch.ones(2, 64, 80).bool()
    valid[1, :, 40:] = False
    found = spread(valid, 200)
    assert len(found) == 400 == len(found.unique())
    assert valid.flatten()[found].all()
    blocks = [
        torch.bincount(own // 80 // 8 * 10 + own % 80 // 8, minlength=80)
        for own in (found[:200], found[200:] - 64 * 80)
    ]
    assert blocks[0].min() == 2 and blocks[0].max() == 3
    assert set(blocks[1].tolist()) == {0, 5}
    assert spread(valid, 10_000).numel() == valid.sum()
    assert spread(valid & False, 10).numel() == 0


def test_leaky_clip():
    numbers = torch.tensor([-2.0, 0.0, 0.3, 1.0, 3.0])
    assert leaky_clip(numbers).tolist() == pytest.approx([-0.02, 0, 0.3, 1, 1.02])


def features_of(count: int = 50) -> tuple[Features, torch.Tensor]:
    torch.manual_seed(0)
    some = Features(
        torch.randn(7, 12),
        torch.randint(0, 7, (count,)),
        torch.randn(9, 10),
        torch.randint(0, 9, (count,)),
        torch.randn(count, 6),
    )
    joined = torch.cat([some.voxels[some.voxel], some.rays[some.ray], some.pairs], dim=1)
    return some, joined


def test_a_head_is_a_perceptron_of_the_joined_features():
    some, joined = features_of()
    head = Head((12, 10, 6), (32, 16, 8))
    for layer in (head.first, head.second, head.third, head.last):
        torch.nn.init.normal_(layer.weight)
        torch.nn.init.normal_(layer.bias)
    inner = joined[:, [*range(12), *range(12, 28)]]
    for layer in (head.first, head.second, head.third):
        inner = torch.nn.functional.leaky_relu(layer(inner), 0.02)
    expected = head.last(inner).squeeze(1)
    # The parts of the first layer stand in the order voxel, ray, pair.
    torch.testing.assert_close(head(some), expected, rtol=1e-4, atol=1e-3)
    which = torch.tensor([3, 30, 4])
    torch.testing.assert_close(head(some.chosen(which)), expected[which], rtol=1e-4, atol=1e-3)


def test_offsets_are_improved_from_the_start():
    some, joined = features_of()
    head = OffsetHead((12, 10, 6), (32, 16, 8))
    for parameter in head.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    number = torch.full((50,), 0.001)
    for _ in range(2):
        inner = torch.cat([joined, head.embed(number[:, None])], dim=1)
        for layer in (head.first, head.second, head.third):
            inner = torch.nn.functional.leaky_relu(layer(inner), 0.02)
        number = number + head.last(inner).squeeze(1)
    assert (number.abs() > 1).any()
    torch.testing.assert_close(head(some), leaky_clip(number), rtol=1e-4, atol=1e-4)


def test_voxels_depend_on_their_own_points_in_any_order():
    torch.manual_seed(0)
    net = PointNet(8)
    points, voxel = torch.randn(40, 6), torch.randint(0, 4, (40,))
    found = net(points, voxel, 5)
    assert found.shape == (5, 32)
    order = torch.randperm(40)
    torch.testing.assert_close(net(points[order], voxel[order], 5), found)
    twice = torch.cat([points, points[:9]]), torch.cat([voxel, voxel[:9]])
    torch.testing.assert_close(net(*twice, 5), found)  # why none need be repeated
    points[voxel == 2] += 1
    changed = (net(points, voxel, 5) != found).any(dim=1)
    assert changed.tolist() == [False, False, True, False, False]


def test_disturbances_are_of_the_published_kinds():
    torch.manual_seed(0)
    found = disturbances(200_000, torch.device("cpu"))
    assert disturbances(0, torch.device("cpu")).shape == (0,)
    shares = {
        (-0.1, -0.05): 0.08,
        (-0.05, 0): 0.4,
        (0, 0.05): 0.24,
        (0.05, 0.1): 0.08,
    }
    for (low, high), share in shares.items():
        inside = (found > low) & (found < high)
        assert inside.float().mean().item() == pytest.approx(share, abs=0.005)
        assert found[inside].mean().item() == pytest.approx((low + high) / 2, abs=5e-4)
    assert (found == 0).float().mean().item() == pytest.approx(0.2, abs=0.005)
