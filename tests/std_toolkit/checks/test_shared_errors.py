"""Edges beside an outline in all frames, and errors of camera poses, in the motion of a label."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from std_toolkit.checks.measure.motion import MotionEquations, pooled_support
from std_toolkit.checks.measure.motion_solver import Motion, solve_motion
from std_toolkit.checks.measure.object_motion import moved_item
from std_toolkit.checks.measure.shared_errors import SharedErrors, seen_error
from std_toolkit.checks.measure.textures import with_cameras
from std_toolkit.checks.result import ObjectCheck
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.labels.texture.motion import TextureMotion
from std_toolkit.options import CheckOptions

CENTRE = np.array([0.1, -0.05, 0.06])
RADIUS_M, FOCAL_PX = 0.06, 700.0
STEEL = SharedErrors(rim=0.7, foot=1.5, foot_part=0.3)


def camera(azimuth: float) -> SE3:
    """0.6 m from the object, 35 degrees above the table."""
    a, e = azimuth, np.deg2rad(35)
    back = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, back), -back], axis=1)
    return SE3(axes, CENTRE + 0.6 * back)


def views(beside_px: float = 0.0, foot_px: float = 0.0, seed: int = 0) -> list[MotionEquations]:
    """Outlines of a ball in eight frames, their edges beside them by these many pixels."""
    random = np.random.default_rng(seed)
    found = []
    for azimuth in np.linspace(-0.7, 0.7, 8):
        T = camera(azimuth)
        angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
        n = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) @ T.R.T
        force = n * FOCAL_PX / 0.6
        arm = RADIUS_M * n
        rows = [force, np.cross(arm, force), (force * arm).sum(1, keepdims=True)]
        jacobian = np.concatenate(rows, axis=1)
        down = SharedErrors().facing_down(jacobian)
        edges = beside_px + foot_px * down + random.normal(0, 0.3, len(angle))
        offsets = np.stack([edges, random.uniform(-15, 15, len(angle))], axis=1)
        arrays = offsets, np.full_like(offsets, 0.7), np.full(len(angle), 0.1), jacobian
        found.append(MotionEquations(*(a.astype(np.float32) for a in arrays), 600.0))
    return found


def mm(motion: Motion | None) -> float:
    assert motion is not None
    return 1000 * float(np.linalg.norm(motion.vector[:3]))


FREE = np.eye(6)[3:]


def test_edges_inside_of_an_outline_are_no_motion() -> None:
    equations = views(-0.8, -1.5)
    misled = mm(solve_motion(equations, FREE))
    found = solve_motion(equations, FREE, shared=STEEL)
    assert found is not None and misled > 0.8 and mm(found) < 0.5 * misled
    assert found.errors == pytest.approx([-0.8, -1.5], abs=0.3)
    # The share of points on edges is measured where the edges are.
    at_outline = pooled_support(equations, found.vector)
    beside = pooled_support(equations, found.vector, STEEL.beside(found.errors))
    assert beside.share > at_outline.share + 0.2


def test_the_deviation_covers_edges_that_face_down() -> None:
    exact, wide = (solve_motion(views(), FREE, shared=s) for s in (SharedErrors(), STEEL))
    assert exact is not None and wide is not None
    height = [float(np.sqrt(m.covariance[2, 2])) for m in (exact, wide)]
    assert height[1] > 1.3 * height[0] and mm(wide) < 0.5


def test_an_error_of_a_camera_looks_like_a_motion_of_the_object() -> None:
    T = camera(0.3)
    error = np.array([0.001, -0.002, 0.0015, 0.002, -0.001, 0.003])
    wrong = T @ SE3.exp(error)
    # Seen by the right camera, and put into the world by the wrong one.
    seen = wrong @ T.inverse()
    motion = np.concatenate([seen @ CENTRE - CENTRE, seen.log()[3:]])
    found = seen_error(np.outer(error, error), T, CENTRE)
    np.testing.assert_allclose(found, np.outer(motion, motion), atol=2e-8)


def test_known_errors_of_cameras_are_in_the_deviation() -> None:
    equations = views()
    random = np.random.default_rng(5)
    sigma = np.array([0.0002] * 3 + [0.0003] * 3)
    poses = [camera(a) for a in np.linspace(-0.7, 0.7, len(equations))]
    cameras = [seen_error(np.diag(sigma**2), T, CENTRE) for T in poses]
    exact = solve_motion(equations, FREE)
    noisy = solve_motion(equations, FREE, cameras=cameras)
    assert exact is not None and noisy is not None
    np.testing.assert_array_equal(exact.vector, noisy.vector)
    errors = []
    for _ in range(60):
        shaken = []
        for e, C in zip(equations, cameras, strict=True):
            moved = np.linalg.cholesky(C + 1e-14 * np.eye(6)) @ random.normal(size=6)
            along = (e.jacobian[:, :6] @ moved).astype(np.float32)
            shaken.append(replace(e, offsets=e.offsets + along[:, None]))
        found = solve_motion(shaken, FREE)
        assert found is not None
        errors.append(found.vector[:3] - exact.vector[:3])
    added = np.trace((noisy.covariance - exact.covariance)[:3, :3])
    assert (np.array(errors) ** 2).sum(axis=1).mean() == pytest.approx(added, rel=0.4)


def test_views_that_agree_have_smaller_deviations() -> None:
    equations = views()
    plain = solve_motion(equations, FREE)
    agreeing = solve_motion(equations, FREE, shared=SharedErrors(least_disagreement=0.5))
    assert plain is not None and agreeing is not None
    ratio = agreeing.covariance[0, 0] / plain.covariance[0, 0]
    assert ratio == pytest.approx(0.5, abs=0.05)


def test_turns_of_the_world_turn_the_facing() -> None:
    jacobian = np.random.default_rng(1).normal(size=(20, 7))
    R = so3_exp([0.4, -0.9, 0.2])
    turned = jacobian.copy()
    turned[:, :3] = jacobian[:, :3] @ R.T
    other = SharedErrors(up=R @ [0.0, 0.0, 1.0])
    np.testing.assert_allclose(other.facing_down(turned), SharedErrors().facing_down(jacobian))


def test_errors_of_cameras_widen_the_motion_of_a_texture() -> None:
    poses = {k: camera(a) for k, a in enumerate(np.linspace(-0.7, 0.7, 4))}
    stated = np.diag([1e-6] * 3 + [0.0] * 3)
    frames = [SimpleNamespace(frame=k, covariance=stated.ravel().tolist()) for k in poses]
    scene = SimpleNamespace(poses=SimpleNamespace(frames=frames), T_world_cam=poses.get)
    obj = SimpleNamespace(T_world_obj=SE3(np.eye(3), CENTRE), centre=np.zeros(3))
    # A turn about z is left open by a symmetry.
    known = np.diag([1e-8, 1e-8, 1e-8, 1e-5, 1e-5, 0.0])
    motion = TextureMotion(np.zeros(6), known, 0.9, tuple(poses))
    found = with_cameras(scene, obj, motion)  # type: ignore[arg-type]
    # 1 mm in each of four frames.
    np.testing.assert_allclose(np.diag(found.covariance)[:3], 1e-8 + 1e-6 / 4, rtol=1e-6)
    np.testing.assert_allclose(found.covariance[5], 0, atol=1e-15)
    frames[0].covariance = None
    less = with_cameras(scene, obj, motion)  # type: ignore[arg-type]
    assert less.covariance[0, 0] < found.covariance[0, 0]


@pytest.mark.parametrize(("beside_px", "seen"), [(1.2, "seen"), (1.6, "seen"), (4.0, "aside")])
def test_a_mesh_of_slightly_another_size_lies_beside_all_edges_and_is_seen(
    beside_px: float, seen: str
) -> None:
    """1.7, 2.3 and 5.7 % of the size of an opaque ball."""
    item = ObjectCheck(
        object=1, name="ball", model="ball", category="ball", material="diffuse", label="refined"
    )
    found = moved_item(
        item,
        views(beside_px),
        FREE,
        CheckOptions(),
        axes=np.eye(3),
        shared=SharedErrors(),
        cameras=[],
    )
    assert found.text("support") == seen
    assert found.value("size_error") == pytest.approx(beside_px / 70, rel=0.1)
