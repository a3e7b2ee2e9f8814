"""Reported deviations of refined labels are true."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from deviation_study import FRAMES, Row, shares, study

from sensors.synthetic import RecordingOptions, make_recording
from std_toolkit.geometry import SE3, Camera
from std_toolkit.jobs import JobOptions
from std_toolkit.labels.refine.edges.system import WeightedRows
from std_toolkit.labels.refine.edges.uncertainty import disagreement, pose_covariance
from std_toolkit.labels.refine.problem import RefineView


def recorded(folder: Path, seeds: range) -> list[Row]:
    rows = []
    for seed in seeds:
        recording = folder / f"recording_{seed}"
        options = RecordingOptions(frames=FRAMES, seed=seed)
        make_recording(recording, options, jobs=JobOptions(progress=False))
        rows += study(recording, folder / f"scene_{seed}", seed)
    return rows


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_errors_are_as_large_as_their_deviations_say(synthetic_table: Path, tmp_path: Path) -> None:
    # This seed has wrong meshes and wrong cameras.
    rows = study(synthetic_table, tmp_path / "scene", seed=155)
    one, two, scale = shares(rows)
    assert one > 0.4
    assert two > 0.85
    assert 0.4 < scale < 1.7


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_shares_of_200_objects_within_one_and_two_deviations(tmp_path: Path) -> None:
    rows = recorded(tmp_path, range(160, 194))
    assert len(rows) >= 200
    one, two, _ = shares(rows)
    assert 0.60 <= one <= 0.76
    assert two >= 0.92


def rows_of_a_view(view: int, rng: np.random.Generator, error: np.ndarray) -> WeightedRows:
    """Residuals of 400 independent samples of deviation 0.5, with a shared motion `error`."""
    J = rng.normal(size=(400, 6))
    residual = J @ error + rng.normal(0, 0.5, 400)
    return WeightedRows(0, view, residual, J, (), np.full(400, 4.0))


def view_with(T_world_cam: SE3, covariance: np.ndarray | None) -> RefineView:
    image = np.zeros((4, 4, 3), np.uint8)
    return RefineView(
        Camera(4, 4, 1.0, 1.0, 1.5, 1.5), T_world_cam, image, pose_covariance=covariance
    )


def test_errors_of_cameras_are_part_of_the_covariance() -> None:
    rng = np.random.default_rng(4)
    camera = np.diag([0.3, 0.1, 0.2, 0.1, 0.2, 0.1]) ** 2
    T_world_obj = SE3.exp([0.3, -0.2, 1.0, 0.4, 0.2, -0.3])
    views = [view_with(SE3.exp(rng.normal(0, 0.5, 6)), camera) for _ in range(3)]
    solved, reported = [], []
    for _ in range(400):
        rows = []
        for k, view in enumerate(views):
            motion = (T_world_obj.inverse() @ view.T_world_cam).adjoint()
            shaken = motion @ rng.multivariate_normal(np.zeros(6), camera)
            rows.append(rows_of_a_view(k, rng, shaken))
        formal = np.linalg.inv(sum(r.pose_information for r in rows))
        step = formal @ sum(r.pose_gradient for r in rows)
        solved.append(step)
        left = [
            WeightedRows(0, r.view, r.residual - r.jacobian @ step, r.jacobian, (), r.information)
            for r in rows
        ]
        reported.append(pose_covariance(formal, left, views, T_world_obj, "specular"))
    true, mean = np.cov(np.array(solved).T), np.mean(reported, axis=0)
    ratio = np.linalg.eigvals(np.linalg.solve(mean, true)).real
    assert ratio.min() > 0.4
    assert ratio.max() < 1.3


def test_views_that_disagree_enlarge_the_covariance() -> None:
    rng = np.random.default_rng(5)
    expected = np.eye(6)

    def factor(size: float) -> float:
        return disagreement([(expected, size * rng.normal(size=6)) for _ in range(9)])

    assert np.median([factor(1.0) for _ in range(50)]) < 1.3
    assert 2.5 < np.median([factor(2.0) for _ in range(50)]) < 5
    assert disagreement([(expected, 100 * np.ones(6))]) == 1
