"""Labels of grasps: against analytic cases, loops, and the tests of single grasps."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from benchmark.metrics.grasp.collision import Cloud
from benchmark.metrics.grasp.force_closure import GraspedMesh, even_points
from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import PANDA
from benchmark.training.grasp.grasp_labels import (
    CLEARANCE,
    UNIT,
    object_labels,
    scene_labels,
    tolerances,
)
from benchmark.training.grasp.tabletop import TableObject
from std_toolkit.geometry.se3 import SE3
from tests.benchmark.training.grasp.true_friction import true_friction

GRID = {"views": 60, "angles": 6, "depths": (0.01, 0.03)}
BOX = trimesh.creation.box((0.04, 0.05, 0.12))


@pytest.fixture(scope="module")
def labels():
    return object_labels(BOX.vertices, BOX.faces, PANDA, spacing=0.012, **GRID)


def test_points_lie_on_the_surface_evenly():
    points = even_points(BOX.vertices, BOX.faces, 0.012)
    outside = np.abs(points) - np.array([0.02, 0.025, 0.06])
    assert np.abs(outside.max(axis=1)).max() < 1e-9
    assert np.array_equal(points, even_points(BOX.vertices, BOX.faces, 0.012))
    # Every place of the surface has a point near it.
    from scipy.spatial import cKDTree

    anywhere, _ = trimesh.sample.sample_surface(BOX, 500, seed=3)
    assert cKDTree(points).query(anywhere)[0].max() < 1.5 * 0.012


def test_labels_are_what_single_grasps_are_found_to_be(labels):
    """Of random grasps of the grid, good ones and others."""
    rng = np.random.default_rng(1)
    rows = np.arange(len(labels.points))
    good = np.flatnonzero(labels.friction)
    some = np.concatenate(
        [rng.choice(good, 150, replace=False), rng.integers(labels.friction.size, size=300)]
    )
    grasps = labels.grasps(rows, some)
    codes = labels.friction.reshape(-1)[some]
    mesh = GraspedMesh(BOX.vertices, BOX.faces)
    held = mesh.friction_scores(grasps)
    assert np.allclose(held[codes > 0], 0.2 * codes[codes > 0])
    surface = Cloud(even_points(BOX.vertices, BOX.faces, 0.004))
    hit = surface.hit_by(grasps, PANDA)
    assert not hit[codes > 0].any()
    # What is no grasp needs too much friction with the widest jaw, or hits the object.
    none = codes == 0
    widest = grasps.replaced(widths=np.full(len(grasps), PANDA.max_width))
    held = mesh.friction_scores(widest)
    contacts = mesh.contacts(widest)
    off = np.einsum("nki,ni->nk", contacts.points - grasps.tips[:, None], grasps.closings)
    opening = np.minimum(2 * np.abs(off).max(axis=1) + CLEARANCE, PANDA.max_width)
    opened = grasps.replaced(widths=np.floor(opening / UNIT + 1e-6) * UNIT)
    assert ((held[none] < 0) | surface.hit_by(opened, PANDA)[none]).all()


def test_a_box_is_held_best_by_parallel_faces_and_opens_as_wide_as_it_is(labels):
    rows = np.arange(len(labels.points))
    good = np.flatnonzero(labels.friction)
    grasps = labels.grasps(rows, good)
    code = labels.friction.reshape(-1)[good]
    # The friction needed is the tangent of the angle to the normal of the faces held.
    most = np.abs(grasps.closings).max(axis=1)
    needed = np.tan(np.arccos(np.clip(most, -1, 1)))
    parallel = needed < 0.19
    assert parallel.sum() > 50
    assert (code[parallel] == 1).all()
    widths = labels.widths.reshape(-1)[good] * UNIT
    # Between faces, not over a corner; the jaw's middle need not be the box's.
    assert widths[parallel].min() >= 0.04 + CLEARANCE - 2 * UNIT
    assert widths.max() <= PANDA.max_width


def test_tolerances_are_those_of_a_loop():
    rng = np.random.default_rng(2)
    points = rng.uniform(0, 0.1, (40, 3))
    good = rng.random((40, 3, 2)) < 0.9
    found = tolerances(points, good, 0.05)
    for p in range(40):
        for v in range(3):
            for a in range(2):
                apart = np.linalg.norm(points - points[p], axis=1)
                bad = apart[~good[:, v, a]]
                expected = min([0.05, *bad])
                assert found[p, v, a] == pytest.approx(expected, abs=1e-7)


def test_grasps_of_a_scene_hit_neither_table_nor_neighbours(labels):
    upright = SE3(np.eye(3), np.array([0, 0, 0.06]))
    beside = SE3(np.eye(3), np.array([0.06, 0, 0.06]))  # a gap of 2 cm along x
    vertices, faces = np.asarray(BOX.vertices), np.asarray(BOX.faces)
    alone = [TableObject("box", vertices, faces, upright)]
    pair = [*alone, TableObject("box", vertices, faces, beside)]
    rows = np.arange(len(labels.points))
    one = scene_labels(alone, [labels], [rows], PANDA)
    two = scene_labels(pair, [labels, labels], [rows, rows[:0]], PANDA)
    count = [(x > 0).sum() for x in (labels.friction, one.friction, two.friction)]
    assert 0 < count[2] < count[1] < count[0]
    assert not ((one.friction > 0) & (labels.friction == 0)).any()
    assert not ((two.friction > 0) & (one.friction == 0)).any()
    for scene, kept in ((alone, one), (pair, two)):
        rng = np.random.default_rng(4)
        good = rng.choice(np.flatnonzero(kept.friction), 100, replace=False)
        lost = np.flatnonzero((labels.friction > 0) & (kept.friction == 0))
        lost = rng.choice(lost, 100, replace=False)
        for flat, holds in ((good, True), (lost, False)):
            grasps = labels.grasps(rows, flat).transformed(upright)
            friction = true_friction(scene, grasps, PANDA)
            # Grippers are grown a little for labels: some that are left out only nearly collide.
            share = (friction > 0).mean()
            assert share == 1 if holds else share < 0.35
            codes = labels.friction.reshape(-1)[flat]
            assert np.allclose(friction[friction > 0], 0.2 * codes[friction > 0])


def test_a_scene_of_which_nothing_is_seen_has_no_labels(labels):
    box = TableObject("box", BOX.vertices, BOX.faces, SE3(np.eye(3), np.array([0, 0, 0.06])))
    none = scene_labels([box], [labels], [np.zeros(0, int)], PANDA)
    assert none.friction.shape == (0, 60, 6, 2)


def test_grasps_in_free_air_and_through_the_table_do_not_hold():
    box = TableObject("box", BOX.vertices, BOX.faces, SE3(np.eye(3), np.array([0, 0, 0.06])))
    down = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]]).T * [-1, 1, -1]  # x down, y along x
    assert np.linalg.det(down) == pytest.approx(1)
    places = np.array([[0, 0, 0.12], [0.3, 0, 0.12], [0.0, 0, 0.02]])
    grasps = Grasps.make(np.stack([down] * 3), places, widths=0.06, depths=0.03)
    assert true_friction([box], grasps, PANDA).tolist() == [pytest.approx(0.2), -1, -1]
    assert true_friction([box], Grasps.empty(), PANDA).shape == (0,)
