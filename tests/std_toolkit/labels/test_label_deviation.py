"""Reported deviations of refined labels are true."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from deviation_study import recorded_study, shares, study

from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.refine.edges.system import SCALE, NormalEquations, WeightedRows
from std_toolkit.labels.refine.edges.uncertainty import disagreement, pose_covariances
from std_toolkit.labels.refine.problem import RefineObject, RefineView


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_errors_are_as_large_as_labels_say(synthetic_table: Path, tmp_path: Path) -> None:
    # This seed has wrong meshes and wrong cameras.
    rows = study(synthetic_table, tmp_path / "scene", seed=155, propagated=True)
    assert len(rows) == 6
    one, two, scale = shares(rows)
    assert one > 0.4
    assert two > 0.85
    assert 0.4 < scale < 1.7


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_shares_of_200_objects_within_one_and_two_deviations(tmp_path: Path) -> None:
    rows = []
    for seed in range(160, 194):
        rows += recorded_study(tmp_path / f"recording_{seed}", tmp_path / f"scene_{seed}", seed)
    assert len(rows) >= 200
    one, two, _ = shares(rows)
    assert 0.60 <= one <= 0.76
    assert two >= 0.92


BOX = trimesh.creation.box((2.0, 2, 2))


def rows_of_a_view(view: int, rng: np.random.Generator, error: np.ndarray) -> WeightedRows:
    """Residuals of 400 independent samples of deviation 0.25, with a shared motion `error`."""
    J = np.hstack([rng.normal(size=(400, 6)), np.zeros((400, 1))])
    residual = J[:, :6] @ error + rng.normal(0, 0.25, 400)
    points, weights = np.zeros((400, 3)), np.full(400, 4.0)
    return WeightedRows("contour", 0, view, residual, J, (SCALE,), weights, points, spacing=50.0)


def solved(rows: list[WeightedRows]) -> tuple[NormalEquations, np.ndarray, list[WeightedRows]]:
    """The normal equations, the step that solves them, and what it leaves of the rows."""
    system = NormalEquations(1)
    system.add_prior(system.SCALE, 1e16, 0.0)
    system.add_prior(system.FACTOR, 1e4, 0.0)
    for one in rows:
        system.add(one)
    step = system.solve([1.0])[:6]
    left = [replace(r, residual=r.residual - r.jacobian[:, :6] @ step) for r in rows]
    return system, step, left


def view_with(T_world_cam: SE3, covariance: np.ndarray | None) -> RefineView:
    image = np.zeros((4, 4, 3), np.uint8)
    return RefineView(
        Camera(4, 4, 1.0, 1.0, 1.5, 1.5), T_world_cam, image, pose_covariance=covariance
    )


def cube(pose: SE3) -> RefineObject:
    return RefineObject("cube", np.asarray(BOX.vertices), np.asarray(BOX.faces), pose)


def test_errors_of_cameras_are_part_of_the_covariance() -> None:
    rng = np.random.default_rng(4)
    camera = np.diag([0.3, 0.1, 0.2, 0.1, 0.2, 0.1]) ** 2
    T = SE3.exp([0.3, -0.2, 1.0, 0.4, 0.2, -0.3])
    views = [view_with(SE3.exp(rng.normal(0, 0.5, 6)), camera) for _ in range(3)]
    steps, reported = [], []
    for _ in range(100):
        rows = []
        for k, view in enumerate(views):
            motion = (T.inverse() @ view.T_world_cam).adjoint()
            shaken = motion @ rng.multivariate_normal(np.zeros(6), camera)
            rows.append(rows_of_a_view(k, rng, shaken))
        system, step, left = solved(rows)
        steps.append(step)
        reported += pose_covariances(system, left, views, [T], [cube(T)], [[]])
    true, mean = np.cov(np.array(steps).T), np.mean(reported, axis=0)
    ratio = np.linalg.eigvals(np.linalg.solve(mean, true)).real
    assert ratio.min() > 0.4
    assert ratio.max() < 1.3


def rows_beside(views: int, seed: int, size: float) -> list[WeightedRows]:
    """Rows of points on both sides of the centre of an object that is larger by `size`."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(views):
        one = rows_of_a_view(k, rng, np.zeros(6))
        points = np.zeros((400, 3))
        points[:, 0] = np.where(rng.random(400) < 0.8, 100.0, -100.0)
        larger = size * one.jacobian[:, 0] * points[:, 0]
        rows.append(replace(one, points=points, residual=one.residual - larger))
    return rows


def test_a_mesh_of_another_size_is_an_error_that_views_share() -> None:
    """Residuals tell by how much, and the deviation says what that does to the pose."""
    T = SE3.identity()

    def deviations(rows: list[WeightedRows]) -> np.ndarray:
        system, _, left = solved(rows)
        seen = [view_with(T, None)] * len(rows)
        (found,) = pose_covariances(system, left, seen, [T], [cube(T)], [[]])
        return np.sqrt(np.diag(found))[:3]

    exact, wrong = deviations(rows_beside(32, 6, 0.0)), deviations(rows_beside(32, 6, 0.01))
    # Four of five points are on one side, so the pose follows it by 60 % of 1 m.
    assert 0.3 < wrong[0] < 0.8
    assert exact[0] < 0.1
    assert (wrong[1:] < wrong[0] / 10).all()


def test_the_texture_of_one_side_may_be_shifted_on_the_mesh() -> None:
    """Many exact matches on one side determine where its texture is, not where the object is."""
    rng = np.random.default_rng(8)
    T = SE3.identity()
    rows = []
    for k in range(6):
        one = rows_of_a_view(k, rng, np.zeros(6))
        points = np.column_stack([np.ones(400), rng.uniform(-0.9, 0.9, (400, 2))])
        residual = rng.normal(0, 1e-6, 400)
        rows.append(replace(one, kind="texture", points=points, residual=residual))
    system, _, left = solved(rows)
    (found,) = pose_covariances(system, left, [view_with(T, None)] * 6, [T], [cube(T)], [[]])
    assert np.sqrt(np.diag(found)[1:3]) == pytest.approx([0.0003] * 2, rel=0.1)


def test_other_ends_of_the_refinement_enlarge_the_covariance() -> None:
    rng = np.random.default_rng(7)
    T = SE3.identity()
    system, _, left = solved([rows_of_a_view(k, rng, np.zeros(6)) for k in range(3)])
    ends = [np.array([0.1, 0, 0, 0, 0, 0]), np.array([-0.1, 0, 0, 0, 0, 0])]
    seen = [view_with(T, None)] * 3
    (alone,) = pose_covariances(system, left, seen, [T], [cube(T)], [[]])
    (spread,) = pose_covariances(system, left, seen, [T], [cube(T)], [ends])
    assert np.allclose(spread - alone, np.diag([0.01, 0, 0, 0, 0, 0]), atol=1e-9)


def test_views_that_disagree_enlarge_the_covariance() -> None:
    rng = np.random.default_rng(5)
    expected = np.eye(6)

    def factor(size: float) -> float:
        return disagreement([(expected, size * rng.normal(size=6)) for _ in range(9)])

    assert np.median([factor(1.0) for _ in range(50)]) < 1.3
    assert 2.5 < np.median([factor(2.0) for _ in range(50)]) < 5
    assert disagreement([(expected, 100 * np.ones(6))]) == 1
