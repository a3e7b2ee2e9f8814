"""Grippers against points, voxels, planes and meshes: cases whose answer is evident."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from benchmark.metrics.grasp.collision import (
    Cloud,
    boxes_meet_triangles,
    filled_share,
    hits_mesh,
    hits_plane,
    lowest_points,
    voxel_means,
)
from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import GRASPNET, GRASPNET_SWEPT, PANDA

DOWN = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])  # approach -z, closing y


def grasp_down(tips: list[list[float]], width: float = 0.06, depth: float = 0.02) -> Grasps:
    t = np.asarray(tips, dtype=float) - depth * DOWN[:, 0]
    return Grasps.make(np.tile(DOWN, (len(t), 1, 1)), t, widths=width, depths=depth)


def test_a_grasp_in_free_air_hits_nothing_and_holds_nothing() -> None:
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    points = Cloud(np.asarray(trimesh.sample.sample_surface(box, 2000, seed=0)[0]))
    grasps = grasp_down([[0, 0, 0], [0, 0, 0.2]])
    assert not points.hit_by(grasps, PANDA).any()
    assert points.count_between(grasps, PANDA)[0] > 100
    assert points.count_between(grasps, PANDA)[1] == 0
    assert not hits_mesh(grasps, PANDA, box.vertices, box.faces).any()


def test_a_grasp_through_the_table_collides() -> None:
    table = np.eye(4)
    grasps = grasp_down([[0, 0, 0.001], [0, 0, -0.001], [0, 0, -0.5]])
    assert hits_plane(grasps, PANDA, table).tolist() == [False, True, True]
    assert hits_plane(grasps, PANDA, table, clearance=0.002).tolist() == [True, True, True]
    assert np.allclose(lowest_points(grasps, PANDA, table), [0.001, -0.001, -0.5])
    grid = np.stack(np.meshgrid(*2 * [np.arange(-0.2, 0.2, 0.004)], [0.0]), -1).reshape(-1, 3)
    assert Cloud(grid).hit_by(grasps, PANDA).tolist() == [False, True, False]  # all beneath
    slab = trimesh.creation.box(
        (1, 1, 0.1), np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.05], [0, 0, 0, 1]])
    )
    hit = hits_mesh(grasp_down([[0, 0, 0.001], [0, 0, -0.001]]), PANDA, slab.vertices, slab.faces)
    assert hit.tolist() == [False, True]


def test_a_tilted_plane_is_met_at_the_lowest_corner() -> None:
    rng = np.random.default_rng(3)
    grasps = Grasps.make(
        Rotation.random(20, rng=rng).as_matrix(), rng.normal(size=(20, 3)), widths=0.05, depths=0.03
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(rng=rng).as_matrix(), [0.1, -0.2, 0.3]
    boxes = PANDA.boxes(grasps.widths, grasps.depths)
    ends = np.stack([boxes.low, boxes.high])
    corners = np.stack(
        [ends[[i, j, k], :, :, [0, 1, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    ).transpose(2, 3, 0, 1)  # (N, B, 8, 3)
    world = (
        np.einsum("nij,nbkj->nbki", grasps.rotations, corners) + grasps.translations[:, None, None]
    )
    expected = ((world - T[:3, 3]) @ T[:3, 2]).min(axis=(1, 2))
    assert np.allclose(lowest_points(grasps, PANDA, T), expected)


def test_counts_are_those_of_a_loop() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.1, 0.1, (3000, 3))
    grasps = Grasps.make(
        Rotation.random(30, rng=rng).as_matrix(),
        rng.uniform(-0.1, 0.1, (30, 3)),
        widths=rng.uniform(0, 0.08, 30),
        depths=rng.uniform(0, 0.04, 30),
    )
    boxes = PANDA.boxes(grasps.widths, grasps.depths)
    counts = Cloud(points).count_inside(grasps, boxes, margin=0.002)
    expected = np.zeros_like(counts)
    for n in range(30):
        local = (points - grasps.translations[n]) @ grasps.rotations[n]
        for b in range(counts.shape[1]):
            low, high = boxes.low[n, b] - 0.002, boxes.high[n, b] + 0.002
            expected[n, b] = ((local > low) & (local < high)).all(axis=1).sum()
    assert expected.sum() > 500
    assert np.array_equal(counts, expected)


@pytest.mark.parametrize(
    "spread",
    [(0.1, 0.1, 0.1), (0.3, 0.3, 0.0), (0.2, 0.0, 0.0), (0.0, 0.0, 0.0), (1000.0, 1000.0, 0.01)],
)
def test_points_of_any_spread_are_found(spread: tuple[float, float, float]) -> None:
    """Flat clouds, a single place, and points far outside of all boxes."""
    rng = np.random.default_rng(4)
    near = rng.uniform(-1, 1, (400, 3)) * np.minimum(spread, 0.3)
    points = np.concatenate([near, rng.uniform(-1, 1, (50, 3)) * spread])
    grasps = Grasps.make(
        Rotation.random(60, rng=rng).as_matrix(),
        rng.uniform(-0.1, 0.1, (60, 3)),
        widths=rng.uniform(0, 0.08, 60),
        depths=rng.uniform(0, 0.04, 60),
    )
    boxes = PANDA.boxes(grasps.widths, grasps.depths)
    local = np.einsum("npj,njk->npk", points - grasps.translations[:, None], grasps.rotations)
    above = local[:, None] > boxes.low[:, :, None]
    expected = (above & (local[:, None] < boxes.high[:, :, None])).all(axis=3).sum(axis=2)
    cloud = Cloud(points)
    assert expected.any() and not expected.all()
    assert np.array_equal(cloud.count_inside(grasps, boxes), expected)
    assert np.array_equal(cloud.any_inside(grasps, boxes), expected.any(axis=1))
    assert np.array_equal(cloud.hit_by(grasps, PANDA), expected.any(axis=1))


def test_a_cloud_of_no_points_and_no_grasps_meet_nothing() -> None:
    none = Cloud(np.zeros((0, 3)))
    assert not none.hit_by(grasp_down([[0, 0, 0]]), PANDA).any()
    one = Cloud(np.zeros((1, 3)))
    assert one.hit_by(grasp_down([[0, 0, 0]])[[]], PANDA).shape == (0,)


def test_voxels_are_the_cells_that_hold_points() -> None:
    points = [[0.001, 0.001, 0.001], [0.009, 0.002, 0.003], [0.011, 0.001, 0.001]]
    assert len(voxel_means(np.random.default_rng(0).uniform(0, 0.1, (5000, 3)), 0.05)) <= 27
    assert np.allclose(voxel_means(points, 1.0), [np.mean(points, axis=0)])
    assert voxel_means(np.zeros((0, 3)), 0.01).shape == (0, 3)


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.005, 0.01, 0.037])
def test_a_thinner_cloud_is_that_of_open3d(size: float) -> None:
    """Its grid begins half a cell before the smallest point along each axis."""
    import open3d as o3d

    points = np.random.default_rng(5).uniform([-0.1, 0.3, -0.7], [0.1, 0.4, -0.5], (4000, 3))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    expected = np.asarray(cloud.voxel_down_sample(size).points)
    ours = voxel_means(points, size)
    assert len(ours) == len(expected) > 50
    for one, other in ((ours, expected), (expected, ours)):
        gap = np.linalg.norm(one[:, None] - other[None], axis=2).min(axis=1)
        assert gap.max() < 1e-12


def test_the_grid_begins_half_a_cell_before_the_smallest_point() -> None:
    # Cells from 0.995, so that the first holds 1.000 to 1.004 and the second 1.006.
    points = np.array([[1.0, 2.0, -3.0], [1.004, 2.0, -3.0], [1.006, 2.0, -3.0]])
    for axis in range(3):
        means = voxel_means(np.roll(points, axis, axis=1), 0.01)
        assert np.allclose(np.roll(means, -axis, axis=1), [[1.002, 2, -3], [1.006, 2, -3]])


def test_cells_that_fill_a_finger_begin_half_a_cell_before_the_smallest_point() -> None:
    """Two points 6 mm apart lie in two cells of 1 cm; from the first point on, it would be one."""
    grasps = Grasps.make(np.eye(3)[None], np.zeros((1, 3)), widths=0.05, depths=0.04)
    share = filled_share(grasps, GRASPNET_SWEPT, [[0.0, 0.03, 0.0], [0.006, 0.03, 0.0]])
    assert share[0] == pytest.approx(2 / (2 * 12 + 6 * 7 * 2))


def test_the_share_that_is_filled_counts_cells() -> None:
    # A cloud that fills one finger of 6 x 1 x 2 cm wholly: 12 cells of 1 cm.
    grasps = Grasps.make(np.eye(3)[None], np.zeros((1, 3)), widths=0.05, depths=0.04)
    x, y, z = np.arange(-0.015, 0.04, 0.01), [0.03], [-0.005, 0.005]
    cells = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3)
    assert len(cells) == 12
    volume = 2 * 12 + 6 * 7 * 2  # cells of two fingers, and of the palm with its way
    share = filled_share(grasps, GRASPNET_SWEPT, cells)
    assert share[0] == pytest.approx(12 / volume)


@pytest.mark.parametrize("seed", range(3))
def test_boxes_against_triangles_agree_with_sampled_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-1, 0, (4, 3))
    high = low + rng.uniform(0.2, 1.5, (4, 3))
    triangles = rng.uniform(-1.5, 1.5, (60, 3, 3))
    meet = boxes_meet_triangles(low, high, triangles)
    a, b = rng.uniform(size=(2, 8000))
    flip = a + b > 1
    a, b = np.where(flip, 1 - a, a), np.where(flip, 1 - b, b)
    weights = np.stack([1 - a - b, a, b], axis=1)
    points = np.einsum("sk,fkj->fsj", weights, triangles)
    seen = np.array(
        [((points > lo) & (points < hi)).all(-1).any(-1) for lo, hi in zip(low, high, strict=True)]
    )
    assert 20 < seen.sum() < 220
    assert not (seen & ~meet).any()
    # What is said to meet meets boxes that are a little larger in the samples.
    grown = np.array(
        [
            ((points > lo - 0.06) & (points < hi + 0.06)).all(-1).any(-1)
            for lo, hi in zip(low, high, strict=True)
        ]
    )
    assert not (meet & ~grown).any()


def test_inside_a_solid_is_a_collision() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    grasps = grasp_down([[0, 0, 0], [0, 0, 0.6]])
    assert hits_mesh(grasps, PANDA, ball.vertices, ball.faces).tolist() == [True, False]
    # Of an open shell nobody can say what is inside.
    half = ball.faces[ball.triangles_center[:, 2] > 0.2]
    assert not hits_mesh(grasps[0], PANDA, ball.vertices, half).any()


def test_fingers_beside_a_mesh_by_a_hair() -> None:
    box = trimesh.creation.box((0.3, 0.05, 0.02))
    wide = grasp_down([[0, 0, 0]], width=0.0502)
    tight = grasp_down([[0, 0, 0]], width=0.0498)
    for gripper in (PANDA, GRASPNET):
        assert not hits_mesh(wide, gripper, box.vertices, box.faces).any()
        assert hits_mesh(tight, gripper, box.vertices, box.faces).all()
