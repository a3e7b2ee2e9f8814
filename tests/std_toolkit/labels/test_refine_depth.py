"""Refinement on sensor depth against pictures with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from depth_picture import CAMERA, bottle_mesh, mesh_object, off, photograph, table
from tiny_camera import camera_pose

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.geometry.surface_colors import SurfaceColors
from std_toolkit.geometry.symmetry import Symmetry, mssd
from std_toolkit.labels.refine.depth.depth_steps import measure_depth
from std_toolkit.labels.refine.depth.icp import DepthFitOptions, refine_on_depth
from std_toolkit.labels.refine.depth.observed import fit_background, observe, plane_depth
from std_toolkit.labels.refine.depth.pose_search import DepthCost
from std_toolkit.labels.refine.directions import covariance_at
from std_toolkit.labels.refine.problem import RefineObject

BOX = mesh_object(
    trimesh.creation.box((0.08, 0.05, 0.1)),
    SE3(so3_exp([0.0, 0.0, 0.4]), np.array([0.01, -0.02, 0.05])),
    "box",
)
BALL = mesh_object(
    trimesh.creation.icosphere(subdivisions=4, radius=0.035),
    SE3(np.eye(3), np.array([0.01, -0.02, 0.035])),
    "ball",
    symmetry=Symmetry(continuous=(((1, 0, 0), (0, 0, 0)), ((0, 1, 0), (0, 0, 0)))),
)
BOTTLE = mesh_object(
    bottle_mesh(), SE3(so3_exp([0.0, 0.0, -0.9]), np.array([0.01, -0.02, 0.0])), "bottle"
)
# Stands between the camera and the things, and hides a part of them.
AHEAD = mesh_object(
    trimesh.creation.box((0.04, 0.04, 0.05)),
    SE3(np.eye(3), np.array([0.03, -0.12, 0.025])),
    "ahead",
)
DEPTH_ONLY = DepthFitOptions(use_edges=False)


def error_mm(T: SE3, thing: RefineObject) -> float:
    return 1000 * mssd(T, thing.T_world_obj, thing.vertices, thing.symmetry, steps=72)


def started_off(thing: RefineObject, seed: int = 0, *, mm: float = 40, deg: float = 25):
    return replace(
        thing, T_world_obj=off(thing.T_world_obj, thing.centre, mm / 1000, deg, seed), fixed=False
    )


@pytest.mark.parametrize("thing", [BOX, BALL, BOTTLE], ids=lambda t: t.name)
def test_a_pose_40_mm_and_25_degrees_off_is_found(thing):
    """Noise of 1 mm, 15 % holes, a labelled neighbour in front."""
    view = photograph([thing, AHEAD])
    fit = refine_on_depth([view], started_off(thing), others=[AHEAD])
    assert error_mm(fit.T_world_obj, thing) < 0.5
    assert fit.converged and fit.views == 1 and fit.depth_factor == 1
    assert fit.edge_rms_px < 1
    # The noise that was put in, and nothing else.
    assert 0.0003 < fit.depth.rms_m < 0.0012 and fit.depth.median_m < 0.001
    assert fit.depth.explained > 0.97
    assert 0.8 < fit.depth.measured < 0.93


@pytest.mark.parametrize("thing", [BOX, BALL, BOTTLE], ids=lambda t: t.name)
def test_depth_alone_finds_it_too(thing):
    fit = refine_on_depth([photograph([thing])], started_off(thing, 3), DEPTH_ONLY)
    assert error_mm(fit.T_world_obj, thing) < 1.0
    assert fit.edge_rms_px is None
    std = np.sqrt(np.diag(fit.covariance)[:3])
    assert (std > 1e-5).all() and (std < 0.01).all()


def test_a_distance_that_follows_the_sensor_has_its_deviation():
    view = photograph([BOX], bias=1.015)
    fit = refine_on_depth([view], started_off(BOX), DEPTH_ONLY)
    centre = BOX.T_world_obj @ BOX.centre
    ray = centre - view.T_world_cam.t
    distance = np.linalg.norm(ray)
    along = (fit.T_world_obj @ BOX.centre - centre) @ ray / distance
    axis = fit.T_world_obj.R.T @ ray / distance
    C = covariance_at(fit.covariance, BOX.centre)[:3, :3]
    assert along == pytest.approx(0.015 * distance, rel=0.3)
    assert np.sqrt(axis @ C @ axis) == pytest.approx(0.015 * distance, rel=0.1)


def test_an_occluder_without_a_label_does_not_draw_the_object():
    fit = refine_on_depth([photograph([BOX, AHEAD])], started_off(BOX))
    assert error_mm(fit.T_world_obj, BOX) < 0.7
    assert fit.depth.explained < 1  # its readings in front are not the box's


def test_an_unlabelled_twin_beside_it_does_not_take_its_place():
    twin = replace(BOX, T_world_obj=SE3(BOX.T_world_obj.R, np.array([0.13, 0.02, 0.05])))
    fit = refine_on_depth([photograph([BOX, twin])], started_off(BOX, 1))
    assert error_mm(fit.T_world_obj, BOX) < 0.7


@pytest.mark.slow
def test_several_views_around_see_through_a_biased_sensor():
    """A sensor that reads 1.5 % long: 8 mm in one view, told apart by the edges of three."""
    views = [photograph([BOX], a, bias=1.015) for a in (-0.8, 0.0, 0.8)]
    fit = refine_on_depth(views, started_off(BOX))
    assert error_mm(fit.T_world_obj, BOX) < 1.0
    assert fit.depth_factor * 1.015 == pytest.approx(1, abs=0.004)
    alone = refine_on_depth(views[1:2], started_off(BOX))
    assert 5 < error_mm(alone.T_world_obj, BOX) < 11
    assert alone.depth.median_m < 0.002  # it follows the sensor, as one view must


def test_views_without_depth_lend_their_edges():
    views = [photograph([BOX], 0.0), photograph([BOX], 0.9, depth=False)]
    fit = refine_on_depth(views, started_off(BOX))
    assert fit.views == 1
    assert error_mm(fit.T_world_obj, BOX) < 0.5


def test_a_declared_symmetry_is_not_turned():
    free = Symmetry(continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),))
    can = mesh_object(
        trimesh.creation.cylinder(0.03, 0.09, sections=64),
        SE3(so3_exp([0.0, 0.0, 0.3]), np.array([0.0, 0.0, 0.045])),
        symmetry=free,
    )
    start = replace(
        can, T_world_obj=SE3(can.T_world_obj.R, can.T_world_obj.t + np.array([0.02, 0.01, 0]))
    )
    fit = refine_on_depth([photograph([can])], start, DepthFitOptions(flips=False))
    assert error_mm(fit.T_world_obj, can) < 0.5
    about_axis = (start.T_world_obj.R.T @ fit.T_world_obj.R)[1, 0]
    assert abs(about_axis) < np.sin(np.deg2rad(35))


def test_the_same_call_gives_the_same_pose():
    view = photograph([BOX])
    a, b = (refine_on_depth([view], started_off(BOX), DEPTH_ONLY) for _ in range(2))
    assert np.array_equal(a.T_world_obj.matrix(), b.T_world_obj.matrix())


@pytest.mark.slow
def test_the_texture_tells_the_front_of_a_box_from_its_back():
    mesh = trimesh.creation.box((0.08, 0.05, 0.1)).subdivide().subdivide().subdivide()
    texture_of = np.where(
        (mesh.vertices[:, 1] < 0)[:, None] & ((np.floor(mesh.vertices[:, [2]] / 0.02) % 2) == 0),
        [230, 40, 40],
        [40, 60, 200],
    )
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=texture_of.astype(np.uint8))
    colors = SurfaceColors.from_mesh(mesh)
    box = mesh_object(mesh, BOX.T_world_obj, "carton", colors=colors)
    view = photograph([box])
    hits = box.surface.cast(
        CAMERA.rays().reshape(-1, 3), view.T_world_cam.inverse() @ box.T_world_obj
    )
    shown = np.isfinite(hits.depth)
    color = view.color.reshape(-1, 3).copy()
    color[shown] = colors.at(hits.face[shown], hits.corners[shown])
    textured = replace(view, color=color.reshape(view.color.shape))
    back = box.T_world_obj @ SE3(so3_exp([0.0, 0.0, np.pi]), np.zeros(3))
    turned = replace(box, T_world_obj=off(back, box.centre, 0.01, 5, 0))
    found = refine_on_depth([textured], turned).T_world_obj
    assert error_mm(found, box) < 1.0
    plain = refine_on_depth([view], replace(turned, colors=None)).T_world_obj
    assert error_mm(plain @ SE3(so3_exp([0.0, 0.0, np.pi]), np.zeros(3)), box) < 1.0


@pytest.mark.slow
def test_a_wrong_start_is_no_success():
    """A box where a bottle is: the pose may be anything, but nobody is told that it fits."""
    wrong = mesh_object(trimesh.creation.box((0.15, 0.02, 0.15)), BOTTLE.T_world_obj, "slab")
    fit = refine_on_depth([photograph([BOTTLE])], wrong)
    assert not fit.converged and fit.depth.explained < 0.5


def test_no_depth_at_all_is_said():
    view = photograph([BOX], depth=False)
    with pytest.raises(ToolkitError, match=r"box: the views have no sensor depth.*edges"):
        refine_on_depth([view], BOX)
    with pytest.raises(ToolkitError, match="at least one view"):
        refine_on_depth([], BOX)


def test_no_depth_on_the_object_is_said():
    view = photograph([BOX])
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    centre = CAMERA.project(view.T_world_cam.inverse() @ BOX.T_world_obj.t)
    glass = np.hypot(columns - centre[0], rows - centre[1]) < 75
    blind = replace(view, depth=np.where(glass, 0, view.depth).astype(np.float32))
    with pytest.raises(ToolkitError, match=r"no depth on box.*glass"):
        refine_on_depth([blind], BOX, DepthFitOptions(reach_m=0.01, turn=0.1, flips=False))
    empty = replace(view, depth=np.zeros_like(view.depth))
    with pytest.raises(ToolkitError, match="no sensor depth around box"):
        refine_on_depth([empty], BOX)


def test_a_mesh_out_of_view_is_said():
    for place in ([5.0, 5.0, 0.05], [0.0, -2.0, 0.05]):
        away = replace(BOX, T_world_obj=SE3(np.eye(3), np.array(place)))
        with pytest.raises(ToolkitError, match=r"box is out of view.*move the object"):
            refine_on_depth([photograph([BOX])], away)


def test_the_truth_costs_least():
    """Surface in free space costs, and so does measured surface that nothing explains."""
    view = photograph([BOX], noise_m=0.0005)
    surface = BOX.surface
    (window,) = observe([view], BOX, [], surface, reach_m=0.05)
    cost = DepthCost(surface, [window.thinned(4000)], 0.01)
    truth = cost(BOX.T_world_obj)
    assert truth < 0
    ray = BOX.T_world_obj.t - view.T_world_cam.t
    ray /= np.linalg.norm(ray)
    for step in (-0.03, -0.01, 0.01, 0.03):
        moved = SE3(BOX.T_world_obj.R, BOX.T_world_obj.t + step * ray)
        assert cost(moved) > truth + 50
    below = SE3(BOX.T_world_obj.R, BOX.T_world_obj.t - np.array([0, 0, 0.3]))
    assert cost(below) > 0
    in_front = SE3(BOX.T_world_obj.R, BOX.T_world_obj.t - 0.15 * ray)
    assert cost(in_front) > 0


def test_the_table_behind_an_object_is_found():
    view = photograph([BOX], noise_m=0.001)
    (window,) = observe([view], BOX, [], BOX.surface, reach_m=0.05)
    assert window.plane is not None
    up = view.T_world_cam.R.T @ [0, 0, 1]
    assert abs(window.plane[:3] @ up) > np.cos(np.deg2rad(0.3))
    height = camera_pose(0.0, radius=0.45, height=0.3).t[2]
    assert window.plane[3] == pytest.approx(height, abs=0.001)


def test_plane_of_points_and_none_of_clutter():
    rng = np.random.default_rng(0)
    xy = rng.uniform(-0.3, 0.3, (500, 2))
    flat = np.column_stack([xy, 0.8 + 0.2 * xy[:, 0]])
    plane = fit_background(flat)
    normal = np.array([-0.2, 0, 1]) / np.hypot(0.2, 1)
    assert np.allclose(plane, np.append(normal, 0.8 * normal[2]), atol=1e-6)
    assert plane_depth(plane, np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])) == pytest.approx(
        [0.8, np.inf]
    )
    assert fit_background(rng.uniform([-0.3, -0.3, 0.5], [0.3, 0.3, 1.1], (500, 3))) is None
    assert fit_background(flat[:20]) is None


def test_shares_and_distances_of_the_agreement():
    """A box 10 mm in front of its readings: none explains it."""
    view = photograph([BOX], noise_m=0.0, holes=0.0)
    surface = BOX.surface
    windows = observe([view], BOX, [], surface, reach_m=0.05)
    exact = measure_depth(surface, windows, BOX.T_world_obj)
    assert exact.median_m < 1e-4 and exact.explained > 0.99 and exact.measured > 0.99
    ray = BOX.T_world_obj.t - view.T_world_cam.t
    nearer = SE3(BOX.T_world_obj.R, BOX.T_world_obj.t - 0.02 * ray / np.linalg.norm(ray))
    shifted = measure_depth(surface, windows, nearer)
    assert shifted.explained < 0.1 and shifted.median_m > 0.012
    long = replace(view, depth=np.asarray(view.depth * 1.02, dtype=np.float32))
    windows = observe([long], BOX, [], surface, reach_m=0.05)
    corrected = measure_depth(surface, windows, BOX.T_world_obj, depth_factor=1 / 1.02)
    assert corrected.median_m < 1e-4


def test_neighbours_hide_what_is_behind_them():
    view = photograph([BOX, AHEAD], noise_m=0.0, holes=0.0)
    surface = BOX.surface
    alone = measure_depth(surface, observe([view], BOX, [], surface, reach_m=0.05), BOX.T_world_obj)
    known = measure_depth(
        surface, observe([view], BOX, [AHEAD, table()], surface, reach_m=0.05), BOX.T_world_obj
    )
    assert known.readings < alone.readings
    assert known.explained > 0.995 > alone.explained
