"""From rough poses, 30 mm and 15 degrees off, on the edges of three images alone."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from depth_picture import CAMERA, bottle_mesh, mesh_object, off, photograph

from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.geometry.symmetry import Symmetry, mssd
from std_toolkit.labels.refine.caster import WorldCaster, cast_patch
from std_toolkit.labels.refine.edges.approach import near_symmetry
from std_toolkit.labels.refine.edges.contour import trace_contour
from std_toolkit.labels.refine.edges.edge_search import (
    EdgeScore,
    ScoreLevel,
    search_edges,
    spread_views,
)
from std_toolkit.labels.refine.edges.outlines import (
    DIRECTIONS,
    EdgeMap,
    OutlineCaster,
    Window,
    edge_direction,
)
from std_toolkit.labels.refine.edges.solver import refine_poses
from std_toolkit.labels.refine.patch_pixels import outline_angles, outline_weights
from std_toolkit.labels.refine.problem import RefineObject

ANGLES = (-0.9, 0.1, 1.0)
TRUTH = SE3(so3_exp([0.0, 0.0, 0.4]), np.array([-0.02, 0.01, 0.05]))
STANDING = SE3(so3_exp([0.0, 0.0, -0.9]), np.array([0.05, -0.01, 0.0]))


def box(pose: SE3 = TRUTH, **arguments) -> RefineObject:
    return mesh_object(trimesh.creation.box((0.08, 0.05, 0.1)), pose, "box", **arguments)


def bottle(pose: SE3 = STANDING, **arguments) -> RefineObject:
    return mesh_object(bottle_mesh(), pose, "bottle", **arguments)


def error_mm(found: SE3, thing: RefineObject, truth: SE3) -> float:
    return 1000 * mssd(found, truth, thing.vertices, thing.symmetry)


@pytest.fixture(scope="module")
def views():
    return [photograph([box(), bottle()], a, depth=False) for a in ANGLES]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_rough_poses_find_their_place(views, seed):
    things = [
        replace(t, T_world_obj=off(t.T_world_obj, t.centre, 0.03, 15, seed=seed), rough=True)
        for t in (box(), bottle())
    ]
    result = refine_poses(views, things)
    for thing, found, truth in zip(things, result.objects, (TRUTH, STANDING), strict=True):
        assert error_mm(thing.T_world_obj, thing, truth) > 30
        assert error_mm(found.T_world_obj, thing, truth) < 1.5, found.name


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [40, 150, -80])
def test_a_handle_on_the_wrong_side_is_found(views, degrees):
    """The round body fits a pixel at any turn: following edges alone leaves the handle there."""
    thing = bottle()
    axis = near_symmetry(thing)
    turned = axis.turned(STANDING, np.deg2rad(degrees))
    start = SE3(turned.R, turned.t + np.array([0.008, -0.006, 0.004]))
    around = [box(fixed=True), replace(thing, T_world_obj=start, rough=True)]
    assert error_mm(start, thing, STANDING) > 30
    found = refine_poses(views, around).objects[1].T_world_obj
    assert error_mm(found, thing, STANDING) < 1.5


def test_the_axis_of_what_is_nearly_round():
    lying = SE3(so3_exp([0.0, np.pi / 2, 0.0]), np.array([0.01, 0.02, 0.03]))
    thing = bottle()
    moved = replace(thing, vertices=lying @ thing.vertices)
    for found, pose in ((near_symmetry(thing), SE3.identity()), (near_symmetry(moved), lying)):
        assert abs(found.direction @ pose.R[:, 2]) > 1 - 1e-9
        off_axis = np.cross(found.point - pose.t, pose.R[:, 2])
        assert np.linalg.norm(off_axis) < 0.0005
    can = mesh_object(trimesh.creation.cylinder(0.03, 0.09, sections=64), TRUTH)
    declared = replace(thing, symmetry=Symmetry(continuous=(((0, 0, 1), (0, 0, 0)),)))
    # Boxes have no such axis, cans no turn that shows, and of a declared one none is asked for.
    assert [near_symmetry(t) for t in (box(), can, declared)] == [None, None, None]


@pytest.mark.slow
def test_a_good_pose_stays(views):
    things = [box(rough=True), bottle(rough=True)]
    result = refine_poses(views, things)
    assert error_mm(result.objects[0].T_world_obj, things[0], TRUTH) < 1.0
    assert error_mm(result.objects[1].T_world_obj, things[1], STANDING) < 1.0


@pytest.mark.slow
def test_the_search_ends_near_the_truth_and_always_at_the_same_place(views):
    start = replace(box(), T_world_obj=off(TRUTH, box().centre, 0.03, 15, seed=4))
    found = search_edges(views, start, [bottle()])
    assert min(error_mm(T, start, TRUTH) for T in found) < 15
    again = search_edges(views, start, [bottle()])
    assert [np.array_equal(a.matrix(), b.matrix()) for a, b in zip(found, again, strict=True)]
    for k, T in enumerate(found):
        assert all(error_mm(T, start, other) > 2 for other in found[:k])


def test_an_object_out_of_view_keeps_its_pose(views):
    away = box(SE3(TRUTH.R, np.array([0.0, 0.0, 3.0])), rough=True)
    assert search_edges(views, away, [])[0] is away.T_world_obj
    result = refine_poses(views, [away, bottle()])
    assert result.objects[0].views == 0
    assert np.allclose(result.objects[0].T_world_obj.t, [0.0, 0.0, 3.0], atol=1e-6)


def test_the_truth_scores_higher_than_poses_around_it(views):
    things = box(), bottle()
    score = EdgeScore(
        views, things[0], things[1:], ScoreLevel(pixels=80, tolerance=1), reach_m=0.04
    )
    around = [off(TRUTH, things[0].centre, 0.01, 5, seed=s) for s in range(20)]
    values = score.of([TRUTH, *around])
    assert score.views == len(views)
    assert values[0] > 1.0
    assert values[0] > values[1:].max() + 0.3


def test_outlines_pass_where_contours_do(views):
    thing, other = box(), bottle()
    view = views[1]
    world = WorldCaster([thing, other], [TRUTH, STANDING])
    patch = cast_patch(world, thing, TRUTH, CAMERA, view.T_world_cam, margin=4)
    contour = trace_contour(world, patch, 0, CAMERA, view.T_world_cam, limit=5000)
    hidden_by = WorldCaster([other], [STANDING])
    others = hidden_by.cast(CAMERA, view.T_world_cam, CAMERA.pixel_grid()).depth
    window = Window(CAMERA, view.T_world_cam, 0, 0, others)
    R = np.stack([np.eye(3), TRUTH.R])
    t = np.stack([[0.0, 0.0, 5.0], TRUTH.t])
    found = OutlineCaster(thing).outlines(window, R, t)
    assert set(found.pose) == {1}
    apart = np.linalg.norm(
        contour.pixels[:, None] - np.stack([found.u, found.v], axis=1)[None], axis=2
    )
    assert apart.min(axis=1).max() < 1.5
    assert np.percentile(apart.min(axis=0), 90) < 2
    # Direction of the nearest contour's normal, modulo half a turn.
    n = contour.normals[apart.argmin(axis=0)]
    turn = found.angle - np.arctan2(n[:, 1], n[:, 0])
    assert np.median(np.abs(np.sin(turn))) < np.sin(np.deg2rad(15))


def test_a_nearer_object_leaves_no_outline_on_what_it_hides():
    thing = box(SE3(np.eye(3), np.array([0.0, 0.0, 0.6])))
    window = Window(CAMERA, SE3.identity(), 0, 0, np.full((240, 320), np.inf, np.float32))
    R, t = np.eye(3)[None], thing.T_world_obj.t[None]
    whole = OutlineCaster(thing).outlines(window, R, t)
    window.others[:, :161] = 0.4
    half = OutlineCaster(thing).outlines(window, R, t)
    assert whole.u.min() < 140 and half.u.min() >= 161
    # The border of the nearer object is not the object's outline.
    assert not ((half.u < 165) & (np.abs(half.v - 118) < 8)).any()


def test_edges_are_known_by_their_direction():
    image = np.full((60, 60, 3), 60, np.uint8)
    image[:, 30:] = 180
    edges = EdgeMap.of(image, tolerance=1.0)
    rows = np.full(40, 30)
    across = edges.at(np.zeros(40, np.float32), rows, np.arange(10, 50))
    along = edges.at(np.full(40, np.pi / 2, np.float32), rows, np.arange(10, 50))
    assert abs(int(across.argmax()) - 20) <= 1
    assert across.max() > 2 and along[across.argmax()] < 1
    assert edges.response.shape == (DIRECTIONS, 60, 60)


@pytest.mark.parametrize("angle", np.linspace(0, np.pi, 7)[:-1])
def test_the_direction_of_an_edge(angle):
    v, u = np.mgrid[:40, :40].astype(np.float32)
    ramp = np.tanh(0.3 * ((u - 20) * np.cos(angle) + (v - 20) * np.sin(angle)))
    _, found = edge_direction(np.repeat(ramp[..., None], 2, axis=2).astype(np.float32))
    assert abs(np.sin(float(found[20, 20]) - angle)) < 0.03


def test_directions_of_outlines_are_those_of_the_whole_patch():
    rng = np.random.default_rng(0)
    depth = np.zeros((2, 30, 40), np.float32)
    depth[:, 8:22, 8:30] = 0.5 + 0.02 * rng.random((2, 14, 22))
    depth[1, 12, 15] = 0
    normal = rng.normal(size=(2, 24, 34, 3)).astype(np.float32)
    seen = depth > 0
    channels = np.zeros((2, 30, 40, 5), np.float32)
    channels[..., 0] = 2 * seen
    channels[..., 1] = np.clip((depth - 0.5) / 0.005, -6, 6) * seen
    channels[:, 3:-3, 3:-3, 2:] = normal
    channels[~seen] = 0
    at = rng.choice(np.flatnonzero(seen), 50)
    found = outline_angles(depth, normal, 3, 0.5, 0.005, at)
    for n in range(2):
        smooth = cv2.blur(channels[n], (3, 3), borderType=cv2.BORDER_CONSTANT)
        mine = at // 1200 == n
        expected = edge_direction(smooth)[1].ravel()[at[mine] % 1200]
        assert np.abs(np.sin(found[mine] - expected)).max() < 1e-4


def test_outlines_have_weights_by_kind():
    depth = np.zeros((1, 12, 14), np.float32)
    depth[0, 4:8, 4:10] = 0.5
    depth[0, 4:8, 7:10] = 0.6  # a jump
    normal = np.zeros((1, 6, 8, 3), np.float32)
    normal[..., 2] = -1
    normal[0, 3:] = [0, -1, 0]  # a crease below row 5
    others = np.full((12, 14), np.inf, np.float32)
    others[:, :4] = 0.3  # hides what lies to the left
    row, column = np.arange(12)[None], np.arange(14)[None]
    weight = outline_weights(depth, normal, 3, others, row, column, 0.02, 0.766, 0.5)[0]
    assert (weight[5, 6:8] == 1).all() and weight[5, 8] == 0.5 == weight[6, 5]
    assert weight[6, 4] == 0.5 and weight[6, 3] == 0  # the border of the nearer surface
    assert (weight[3, 4:10] == 1).all() and (weight[8, 4:10] == 1).all()
    assert (weight[4:8, 9] == 1).all() and (weight[4:8, 10] == 1).all()


def test_five_views_from_all_around_are_looked_at():
    views = [photograph([box()], a, depth=False) for a in np.linspace(-1.2, 1.2, 9)]
    chosen = spread_views(views, box())
    assert len(chosen) == 5 and chosen[0] is views[0] and chosen[-1] is views[-1]
