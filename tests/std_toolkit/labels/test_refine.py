"""Refinement against images with known truth: a simple one here, the synthetic recording below."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tiny_camera import camera_pose

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.geometry.symmetry import Symmetry, mssd
from std_toolkit.labels.refine.caster import NONE, WorldCaster, cast_patch
from std_toolkit.labels.refine.directions import (
    covariance_at,
    weak_direction_upright,
    weakest_direction,
)
from std_toolkit.labels.refine.edges.contour import Kind, trace_contour
from std_toolkit.labels.refine.edges.solver import refine_poses
from std_toolkit.labels.refine.problem import RefineObject, RefineOptions, RefineView

CAMERA = Camera(320, 240, 330.0, 330.0, 161.0, 118.0)
TRUTH = SE3(so3_exp([0.0, 0.0, 0.4]), np.array([0.01, -0.02, 0.05]))
SMALL = SE3.exp(np.array([0.004, -0.003, 0.006, 0.03, -0.02, 0.03]))


def box(name: str = "box", pose: SE3 = TRUTH, **arguments) -> RefineObject:
    mesh = trimesh.creation.box((0.08, 0.05, 0.1))
    return RefineObject(name, np.asarray(mesh.vertices), np.asarray(mesh.faces), pose, **arguments)


def photograph(
    things: list[RefineObject], angle: float, *, depth_bias: float | None = None, seed: int = 0
) -> RefineView:
    """Shaded objects before noise, anti-aliased 3x3; depth too where a bias is given."""
    rng = np.random.default_rng([seed, round(1000 * (angle + 7))])
    pose = camera_pose(angle, radius=0.45, height=0.3)
    fine = CAMERA.resized(960, 720)
    caster = WorldCaster(things, [t.T_world_obj for t in things])
    hits = caster.cast(fine, pose, fine.pixel_grid())
    colours = np.array([[200, 80, 60], [60, 90, 200], [70, 170, 80]], float)
    light = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    shade = 0.5 + 0.5 * np.abs(hits.normal @ light)
    image = np.where(
        (hits.object != NONE)[..., None],
        colours[np.maximum(hits.object, 0)] * shade[..., None],
        rng.uniform(90, 150, (720, 960, 1)),
    )
    small = image.reshape(240, 3, 320, 3, 3).mean(axis=(1, 3)) + rng.normal(0, 2, (240, 320, 3))
    depth = None
    if depth_bias is not None:
        exact = caster.cast(CAMERA, pose, CAMERA.pixel_grid()).depth
        noisy = exact * depth_bias + rng.normal(0, 0.001, exact.shape)
        depth = np.where(np.isfinite(exact), noisy, 0).astype(np.float32)
    return RefineView.of(CAMERA, pose, np.clip(small, 0, 255).astype(np.uint8), depth)


def error_mm(found: SE3, thing: RefineObject, truth: SE3 = TRUTH) -> float:
    return 1000 * mssd(found, truth, thing.vertices, thing.symmetry)


ANGLES = (0.0, 0.7, 1.4, 2.1)


def test_contours_lie_on_the_projected_edges():
    thing = box()
    caster = WorldCaster([thing], [TRUTH])
    pose = camera_pose(0.3, radius=0.45, height=0.3)
    patch = cast_patch(caster, thing, TRUTH, CAMERA, pose, margin=10)
    contour = trace_contour(caster, patch, 0, CAMERA, pose)
    corners = CAMERA.project(pose.inverse() @ (TRUTH @ thing.vertices))
    segments = [
        (corners[i], corners[j])
        for i in range(8)
        for j in range(i)
        if np.sum(~np.isclose(thing.vertices[i], thing.vertices[j])) == 1
    ]
    distance = np.min([_to_segment(contour.pixels, a, b) for a, b in segments], axis=0)
    outer = contour.kind == Kind.SILHOUETTE
    assert np.percentile(distance[outer], 90) < 0.06
    assert (contour.kind == Kind.CREASE).any()
    again = CAMERA.project(pose.inverse() @ contour.points)
    assert np.abs(again - contour.pixels).max() < 1e-3


def _to_segment(p, a, b):
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - (a + t[:, None] * (b - a)), axis=1)


def test_images_alone_find_the_pose():
    start = box(pose=TRUTH @ SMALL)
    result = refine_poses([photograph([box()], a) for a in ANGLES], [start])
    found = result.objects[0]
    assert error_mm(start.T_world_obj, start) > 7
    assert error_mm(found.T_world_obj, start) < 0.7
    assert found.converged and found.views == 4 and found.depth_rms_m is None
    sigma = 1000 * np.sqrt(np.trace(covariance_at(found.covariance, start.centre)[:3, :3]))
    assert 0.02 < sigma < 2


def test_a_depth_bias_does_not_move_the_label():
    views = [photograph([box()], a, depth_bias=1.02) for a in ANGLES]
    result = refine_poses(views, [box(pose=TRUTH @ SMALL)])
    assert error_mm(result.objects[0].T_world_obj, box()) < 0.7
    assert abs(result.depth_factor * 1.02 - 1) < 0.002
    assert result.objects[0].depth_rms_m < 0.002


def test_depth_on_glass_is_not_believed():
    views = [photograph([box()], a, depth_bias=0.95) for a in ANGLES]
    result = refine_poses(views, [box(pose=TRUTH @ SMALL, material="transparent")])
    assert result.objects[0].depth_rms_m is None and result.depth_factor == 1
    assert error_mm(result.objects[0].T_world_obj, box()) < 0.7


def test_the_scale_of_the_camera_positions_is_found():
    views = []
    for a in ANGLES:
        v = photograph([box()], a)
        wrong = SE3(v.T_world_cam.R, v.T_world_cam.t * 0.985)
        views.append(RefineView.of(v.camera, wrong, v.color))
    result = refine_poses(views, [box(pose=TRUTH @ SMALL)], RefineOptions(refine_scale=True))
    assert abs(result.scale * 0.985 - 1) < 0.003
    assert error_mm(result.objects[0].T_world_obj, box()) < 1.5


def test_the_pose_at_another_scale_follows_from_the_coupling():
    """Against a refinement with the scale fixed there; the world's origin is far off."""
    far = SE3(np.eye(3), np.array([0.4, 0.2, 0.3]))
    wrong = []
    for angle in ANGLES:
        v = photograph([box()], angle)
        T = far @ v.T_world_cam
        wrong.append(RefineView.of(v.camera, SE3(T.R, T.t * 1.01), v.color))
    start = box(pose=far @ TRUTH @ SMALL)
    free = refine_poses(wrong, [start], RefineOptions(refine_scale=True))
    assert free.scale_converged
    assert abs(free.scale * 1.01 - 1) < 0.003
    fixed = refine_poses(wrong, [start]).objects[0].T_world_obj
    found = free.objects[0]
    moved = found.T_world_obj @ SE3.exp(-np.log(free.scale) * found.scale_coupling)
    before = error_mm(found.T_world_obj, start, fixed)
    assert before > 2
    assert error_mm(moved, start, fixed) < 0.25 * before


@pytest.mark.slow
def test_objects_hide_each_other():
    ahead = SE3(TRUTH.R, TRUTH.t + np.array([0.03, -0.08, 0.0]))
    truth = [box("back"), box("front", ahead)]
    views = [photograph(truth, a) for a in (-0.8, -0.3, 0.2, 0.7)]
    start = [box("back", TRUTH @ SMALL), box("front", ahead @ SMALL)]
    result = refine_poses(views, start)
    assert error_mm(result.objects[0].T_world_obj, start[0]) < 1.0
    assert error_mm(result.objects[1].T_world_obj, start[1], ahead) < 1.0


def test_a_fixed_object_stays():
    ahead = SE3(TRUTH.R, TRUTH.t + np.array([0.03, -0.08, 0.0]))
    views = [photograph([box("back"), box("front", ahead)], a) for a in (0.0, 0.8)]
    front = box("front", ahead, fixed=True)
    result = refine_poses(views, [box("back", TRUTH @ SMALL), front])
    assert np.array_equal(result.objects[1].T_world_obj.matrix(), ahead.matrix())


def test_nothing_in_view_is_said():
    away = SE3(TRUTH.R, np.array([5.0, 5.0, 5.0]))
    with pytest.raises(ToolkitError, match="no object is visible"):
        refine_poses([photograph([box()], 0.0)], [box(pose=away)])
    with pytest.raises(ToolkitError, match="at least one view"):
        refine_poses([], [box()])


def test_one_view_leaves_the_distance_weak():
    result = refine_poses([photograph([box()], 0.0)], [box(pose=TRUTH)])
    found = result.objects[0]
    ray = TRUTH.t - camera_pose(0.0, radius=0.45, height=0.3).t
    values, vectors = np.linalg.eigh(covariance_at(found.covariance, np.zeros(3))[:3, :3])
    along = found.T_world_obj.R @ vectors[:, -1]
    assert abs(along @ ray) / np.linalg.norm(ray) > 0.9
    assert values[-1] > 4 * values[0]


def test_the_weak_direction_in_words():
    C = np.diag([1e-8, 4e-6, 1e-8, 1e-6, 1e-6, 1e-6])
    text = weakest_direction(C, np.zeros(3), 0.05, Symmetry())
    assert "shift along object axis (0.00, 1.00, 0.00)" in text and "2.00 mm" in text
    C = np.diag([1e-8, 1e-8, 1e-8, 1e-6, 1e-6, 1e-2])
    assert "turn about object axis (0.00, 0.00, 1.00)" in weakest_direction(
        C, np.zeros(3), 0.05, Symmetry()
    )
    free = Symmetry(continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),))
    assert "(0.00, 0.00, 1.00)" not in weakest_direction(C, np.zeros(3), 0.05, free)


def test_the_weak_direction_is_said_along_a_view_or_upright():
    image = np.zeros((480, 640, 3), np.uint8)
    views = [
        RefineView.of(Camera(640, 480, 600.0, 600.0, 320.0, 240.0), pose, image, frame=7 + i)
        for i, pose in enumerate((SE3.identity(), SE3.exp([0.5, 0, 0, 0, -0.7, 0])))
    ]
    # The object's y axis points away from the first camera; its z axis is upright.
    T_world_obj = SE3(so3_exp([np.pi / 2, 0, 0]), np.array([0.0, 0.0, 0.6]))
    up = np.array([0.0, 0.0, 1.0])

    def sentence(*variances: float) -> str:
        C = np.diag(np.array(variances))
        return weakest_direction(
            C, np.zeros(3), 0.05, Symmetry(), T_world_obj=T_world_obj, views=views
        )

    away = sentence(1e-8, 4e-6, 1e-8, 1e-8, 1e-8, 1e-8)
    assert "shift along the view of frame 7, object axis (0.00, 1.00, 0.00)" in away
    assert weak_direction_upright(away, up) == away
    rise = weak_direction_upright(sentence(1e-8, 1e-8, 4e-6, 1e-8, 1e-8, 1e-8), up)
    assert "shift up or down, object axis (0.00, 0.00, 1.00)" in rise and "2.00 mm" in rise
    yaw = weak_direction_upright(sentence(1e-8, 1e-8, 1e-8, 1e-8, 1e-8, 1e-2), up)
    assert "turn about its upright axis, object axis (0.00, 0.00, 1.00)" in yaw
    assert "deg" in yaw
    roll = sentence(1e-8, 1e-8, 1e-8, 1e-8, 1e-2, 1e-8)
    assert "turn in the image of frame 7, object axis (0.00, 1.00, 0.00)" in roll
    tilt = weak_direction_upright(sentence(1e-8, 1e-8, 1e-8, 1e-2, 1e-8, 1e-8), up)
    assert "turn of its upright axis (tilt), object axis (1.00, 0.00, 0.00)" in tilt
    assert weak_direction_upright("depth is weak", up) == "depth is weak"
