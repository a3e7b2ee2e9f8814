"""GraspNet's average precision: hand-worked rankings, and scenes whose answers are evident."""

import numpy as np
import pytest
import trimesh

from benchmark.metrics.grasp import ap
from benchmark.metrics.grasp.ap import (
    JudgedObject,
    average_precision,
    judge_grasps,
    precision_at,
)
from benchmark.metrics.grasp.force_closure import FRICTIONS
from benchmark.metrics.grasp.grasp import Grasps
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3

DOWN = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])  # approach -z, closing y
SIDE = np.array([[0, 1.0, 0], [0, 0, 1], [1, 0, 0]])  # approach z, closing x
TABLE = SE3.identity()


def box_on_table(x: float = 0.0) -> tuple[JudgedObject, SE3]:
    """A box 4 cm wide, 8 cm high; its own frame is in its middle."""
    box = trimesh.creation.box((0.04, 0.04, 0.08))
    points = trimesh.sample.sample_surface(box, 4000, seed=0)[0]
    thing = JudgedObject(np.asarray(box.vertices), np.asarray(box.faces), np.asarray(points))
    return thing, SE3(np.eye(3), np.array([x, 0, 0.04]))


def down_at(x: list[float], height: list[float], scores: list[float], turn: float = 0.0) -> Grasps:
    """Grasps from above whose tips end at these heights, 3 cm beyond the translation."""
    t = np.zeros((len(x), 3))
    t[:, 0], t[:, 2] = x, np.asarray(height) + 0.03
    c, s = np.cos(turn), np.sin(turn)
    R = DOWN @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return Grasps.make(np.tile(R, (len(x), 1, 1)), t, widths=0.06, depths=0.03, scores=scores)


def test_one_of_each_fate() -> None:
    thing, T = box_on_table()
    # Good; through the table beside nothing; in the air above, where nothing is between.
    grasps = Grasps.concatenated(
        [
            down_at([0], [0.05], [3]),
            down_at([0], [-0.02], [2]),  # the palm is in the box, the fingers in the table
            down_at([0], [0.12], [1]),
        ]
    )
    judged = judge_grasps(grasps, [thing], [T], TABLE)
    assert judged.grasps.scores.tolist() == [3, 2, 1]
    assert judged.collided.tolist() == [False, True, False]
    assert judged.empty.tolist() == [False, False, True]
    assert judged.friction.tolist() == [0.2, -1, -1]
    assert judged.grasps.object_ids.tolist() == [0, 0, 0]


def test_through_the_table_collides_only_where_there_is_one() -> None:
    thing, _ = box_on_table()
    low = down_at([0], [-0.01], [1])
    # Two centimetres high, so that the palm stays above it.
    flat = JudgedObject(thing.vertices * [1, 1, 0.25], thing.faces, thing.points * [1, 1, 0.25])
    T_flat = SE3(np.eye(3), np.array([0, 0, 0.01]))
    assert judge_grasps(low, [flat], [T_flat]).friction.tolist() == [-1]  # below the box: air
    deeper = down_at([0], [0.005], [1])
    assert judge_grasps(deeper, [flat], [T_flat]).friction.tolist() == [0.2]
    assert judge_grasps(deeper, [flat], [T_flat], TABLE).friction.tolist() == [0.2]
    assert judge_grasps(low, [flat], [T_flat], TABLE).collided.tolist() == [True]


def test_a_turned_hand_needs_more_friction() -> None:
    thing, T = box_on_table()
    # 25 degrees: tan = 0.47.
    turned = down_at([0], [0.05], [1], turn=np.radians(25)).replaced(widths=[0.07])
    assert judge_grasps(turned, [thing], [T], TABLE).friction.tolist() == [pytest.approx(0.6)]


def test_the_camera_may_stand_anywhere() -> None:
    from scipy.spatial.transform import Rotation

    thing, T = box_on_table()
    grasps = Grasps.concatenated([down_at([0], [0.05], [3]), down_at([0], [-0.02], [2])])
    T_cam_world = SE3(Rotation.from_euler("xyz", [2, 0.3, 1]).as_matrix(), np.array([0.1, 0, 0.8]))
    judged = judge_grasps(
        grasps.transformed(T_cam_world), [thing], [T_cam_world @ T], T_cam_world @ TABLE
    )
    assert judged.friction.tolist() == [0.2, -1]


def test_each_object_keeps_its_ten_best() -> None:
    (one, T1), (two, T2) = box_on_table(0.0), box_on_table(0.3)
    rng = np.random.default_rng(0)
    # 3.1 cm apart in height, so that none is thinned out; 15 belong to the first object.
    heights = 0.05 + 0.031 * np.arange(15)
    first = down_at([0.0] * 15, heights.tolist(), rng.permutation(15).tolist())
    second = down_at([0.3], [0.05], [-1])
    judged = judge_grasps(Grasps.concatenated([first, second]), [one, two], [T1, T2], TABLE)
    assert (judged.grasps.object_ids == 0).sum() == 10
    assert judged.grasps.scores.tolist() == [*range(14, 4, -1), -1]
    assert judged.friction[-1] == 0.2


def test_wide_hands_are_cut_and_like_ones_thinned() -> None:
    thing, T = box_on_table()
    grasps = down_at([0, 0.001], [0.05, 0.05], [1, 2]).replaced(widths=[0.3, 0.3])
    judged = judge_grasps(grasps, [thing], [T], TABLE)
    assert judged.grasps.scores.tolist() == [2]
    assert judged.grasps.widths.tolist() == [0.1]


def test_precision_by_hand() -> None:
    # Best first: holds at 0.2; fails; holds from 0.8 on.
    table = precision_at([0.2, -1, 0.8])
    assert table.shape == (50, 6)
    at_02 = [1 / k for k in range(1, 51)]
    at_08 = [1, 1 / 2, 2 / 3] + [2 / k for k in range(4, 51)]
    assert np.allclose(table[:, 0], at_02) and np.allclose(table[:, 2], at_02)
    assert np.allclose(table[:, 3], at_08) and np.allclose(table[:, 5], at_08)
    found = average_precision([table, np.zeros((50, 6))])
    # 0.2, 0.4 and 0.6 as the first, 0.8, 1.0 and 1.2 as the second; half, for the empty image.
    assert found.ap == pytest.approx(100 * (3 * np.mean(at_02) + 3 * np.mean(at_08)) / 6 / 2)
    assert found.ap04 == pytest.approx(100 * np.mean(at_02) / 2)
    assert found.ap08 == pytest.approx(100 * np.mean(at_08) / 2)
    assert found.frames == 2


def test_the_extremes() -> None:
    assert average_precision([precision_at([0.2] * 50)]).ap == pytest.approx(100)
    assert average_precision([precision_at([])]).ap == 0
    assert average_precision([precision_at([0.2] * 80)]).ap == pytest.approx(100)
    # Frictions that a file rounded to float32 count as they were.
    for mu in FRICTIONS:
        assert precision_at([float(np.float32(mu))], [mu])[0, 0] == 1
    with pytest.raises(ToolkitError, match="no image"):
        average_precision([])


def test_no_grasps_and_no_objects() -> None:
    thing, T = box_on_table()
    judged = judge_grasps(Grasps.empty(), [thing], [T], TABLE)
    assert len(judged.grasps) == 0 and judged.friction.shape == (0,)
    with pytest.raises(ToolkitError, match="objects"):
        judge_grasps(Grasps.empty(), [], [])


def test_each_object_has_its_own_best_grasps() -> None:
    box, left = box_on_table(-0.3)
    _, right = box_on_table(0.3)
    # Too far apart to suppress each other: the better half on the right box.
    heights = np.linspace(0.0, 0.36, 12)
    grasps = Grasps.concatenated(
        [
            down_at([0.3] * 12, heights.tolist(), np.linspace(24, 13, 12).tolist()),
            down_at([-0.3] * 12, heights.tolist(), np.linspace(12, 1, 12).tolist()),
        ]
    )
    counted = ap._counted(grasps, [box, box], [left, right])
    assert np.bincount(counted.object_ids).tolist() == [ap.PER_OBJECT, ap.PER_OBJECT]
    assert counted.scores.tolist() == [*range(24, 14, -1), *range(12, 2, -1)]
