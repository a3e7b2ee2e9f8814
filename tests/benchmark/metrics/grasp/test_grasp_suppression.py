"""Non-maximum suppression of grasps."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from benchmark.metrics.grasp.grasp import Grasps, suppress_similar


def grasps_at(x: list[float], turns_deg: list[float], scores: list[float]) -> Grasps:
    t = np.zeros((len(x), 3))
    t[:, 0] = x
    R = Rotation.from_rotvec(np.outer(np.radians(turns_deg), [0, 0, 1])).as_matrix()
    return Grasps.make(R, t, widths=0.05, depths=0.02, scores=scores, object_ids=range(len(x)))


def test_near_and_alike_goes_far_or_turned_stays() -> None:
    grasps = grasps_at([0, 0.029, 0.031, 0.0], [0, 29, 0, 31], [4, 3, 2, 1])
    assert suppress_similar(grasps).object_ids.tolist() == [0, 2, 3]


def test_what_was_dropped_drops_nothing() -> None:
    # 1 is dropped by 0; 2 is near 1 alone.
    grasps = grasps_at([0, 0.02, 0.04], [0, 0, 0], [3, 2, 1])
    assert suppress_similar(grasps).object_ids.tolist() == [0, 2]


def test_the_best_comes_first_whatever_the_order() -> None:
    grasps = grasps_at([0.02, 0.04, 0.0], [0, 0, 0], [2, 1, 3])
    assert suppress_similar(grasps).object_ids.tolist() == [2, 1]


def test_swapped_fingers_are_the_same_grasp_if_asked() -> None:
    R = np.stack([np.eye(3), np.diag([1.0, -1, -1])])
    grasps = Grasps.make(R, np.zeros((2, 3)), widths=0.05, depths=0.02, scores=[2, 1])
    assert len(suppress_similar(grasps)) == 2
    assert len(suppress_similar(grasps, swapped_fingers=True)) == 1


def test_as_a_plain_loop() -> None:
    rng = np.random.default_rng(0)
    n = 120
    grasps = Grasps.make(
        Rotation.from_rotvec(rng.normal(0, 0.5, (n, 3))).as_matrix(),
        rng.uniform(-0.05, 0.05, (n, 3)),
        widths=0.05,
        depths=0.02,
        scores=rng.uniform(size=n),
        object_ids=np.arange(n),
    )
    kept: list[int] = []
    for i in np.argsort(-grasps.scores):
        for k in kept:
            turn = Rotation.from_matrix(grasps.rotations[k].T @ grasps.rotations[i]).magnitude()
            away = np.linalg.norm(grasps.translations[k] - grasps.translations[i])
            if away < 0.03 and turn < math.radians(30):
                break
        else:
            kept.append(int(i))
    assert 5 < len(kept) < n
    assert suppress_similar(grasps).object_ids.tolist() == kept
    assert len(suppress_similar(Grasps.empty())) == 0
