"""Figures of many choices of frames: the same as those of each choice by itself."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.metrics.pose import (
    PosePrediction,
    PoseTruth,
    get_pose_protocol,
    match_poses,
    score_matches,
)
from benchmark.metrics.pose.resampling import resampled_scores, scene_weights, side_by_side
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3

FRAMES = 12


def some_frames(
    seed: int, *, scores: str = "distinct"
) -> tuple[list[PoseTruth], list[PosePrediction]]:
    """Frames with boxes, and predictions that are near, far, missing or too many."""
    rng = np.random.default_rng(seed)
    truths, found = [], []
    for _ in range(FRAMES):
        n = int(rng.integers(0, 5))
        classes = rng.integers(1, 5, n)
        RT = np.array(
            [SE3.exp([*rng.normal(0, 0.1, 3), *rng.normal(0, 1, 3)]).matrix() for _ in range(n)]
        ).reshape(-1, 4, 4)
        sizes = rng.uniform(0.1, 0.3, (n, 3))
        truths.append(PoseTruth(classes, RT, sizes))
        keep = rng.random(n) < 0.8
        moved = [
            T @ SE3.exp([*rng.normal(0, 0.02, 3), *rng.normal(0, 0.1, 3)]).matrix()
            for T in RT[keep]
        ]
        m = len(moved)
        confidence = {
            "distinct": rng.random(m),
            "equal": np.ones(m),
            "few": rng.integers(0, 3, m) / 2,
        }[scores]
        found.append(PosePrediction(classes[keep], moved, sizes[keep], confidence))
    return truths, found


@pytest.mark.parametrize("name", ["strict", "paper", "nocs2019"])
@pytest.mark.parametrize("scores", ["distinct", "equal", "few"])
def test_each_draw_is_what_it_is_by_itself(
    name: str, scores: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Few ranks at once, so that both ways of summing are taken.
    monkeypatch.setattr("benchmark.metrics.pose.resampling._FEW_RANKS", 2)
    matches = match_poses(*some_frames(1, scores=scores), get_pose_protocol(name))
    weights = np.random.default_rng(0).integers(0, 3, (20, FRAMES)).astype(float)
    weights[3] = 0
    found = resampled_scores(matches, weights)
    for drawn, w in zip(found, weights, strict=True):
        expected = list(score_matches(matches, w).mean.values())
        np.testing.assert_allclose(drawn, expected, atol=1e-12, equal_nan=True)
    assert np.isnan(found[3]).all()
    assert len({tuple(row) for row in found.round(6).tolist()}) > 5


def test_two_methods_side_by_side() -> None:
    truths, first = some_frames(2)
    _, second = some_frames(2, scores="few")
    second[4] = PosePrediction([], [], [], [])
    protocol = get_pose_protocol("strict")
    a, b = match_poses(truths, first, protocol), match_poses(truths, second, protocol)
    both = side_by_side(a, b)
    ones, zeros = np.ones(FRAMES), np.zeros(FRAMES)
    swap = np.arange(FRAMES) % 2 == 0
    found = resampled_scores(
        both, [np.append(ones, zeros), np.append(zeros, ones), np.append(~swap, swap)]
    )
    mixed = [s if swapped else f for f, s, swapped in zip(first, second, swap, strict=True)]
    expected = [
        list(score_matches(m).mean.values()) for m in (a, b, match_poses(truths, mixed, protocol))
    ]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    with pytest.raises(ToolkitError, match="the same frames"):
        side_by_side(a, match_poses(truths[:3], first[:3], protocol))


def test_weights_that_are_none() -> None:
    matches = match_poses(*some_frames(3))
    with pytest.raises(ToolkitError, match="draws, frames"):
        resampled_scores(matches, np.ones(FRAMES))
    with pytest.raises(ToolkitError, match="not negative"):
        resampled_scores(matches, -np.ones((1, FRAMES)))
    assert scene_weights(["b", "a"], np.array([[3.0, 5.0]])).tolist() == [[5.0, 3.0]]
