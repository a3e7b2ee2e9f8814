"""A batch of grasps: GraspNet's 17 numbers, order, frames, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.metrics.grasp import PANDA, Grasps
from benchmark.metrics.grasp.gripper import GRASPNET, GRIPPERS, get_gripper
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3


def some_grasps(count: int = 5, seed: int = 0) -> Grasps:
    rng = np.random.default_rng(seed)
    return Grasps.make(
        Rotation.random(count, rng=rng).as_matrix(),
        rng.normal(size=(count, 3)),
        widths=rng.uniform(0.01, 0.08, count),
        depths=rng.choice([0.01, 0.02, 0.03, 0.04], count),
        scores=rng.uniform(size=count),
        object_ids=rng.integers(-1, 5, count),
    )


def test_seventeen_numbers_are_those_of_graspnet() -> None:
    row = [0.7, 0.05, 0.02, 0.03, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0.1, 0.2, 0.3, 4]
    grasps = Grasps.from_array([row])
    assert grasps.scores[0] == 0.7 and grasps.widths[0] == 0.05
    assert grasps.heights[0] == 0.02 and grasps.depths[0] == 0.03 and grasps.object_ids[0] == 4
    # The rotation is stored row by row; its first column is the approach.
    assert grasps.approaches[0].tolist() == [0, 1, 0]
    assert grasps.closings[0].tolist() == [0, 0, 1]
    assert np.allclose(grasps.tips[0], [0.1, 0.23, 0.3])
    assert grasps.to_array().tolist() == [row]


def test_rows_come_back_as_they_were() -> None:
    grasps = some_grasps()
    again = Grasps.from_array(grasps.to_array())
    assert np.array_equal(again.to_array(), grasps.to_array())
    assert len(Grasps.from_array(np.zeros((0, 17)))) == 0
    assert Grasps.empty().to_array().shape == (0, 17)


def test_the_best_come_first_and_equals_stay_in_order() -> None:
    grasps = some_grasps(6).replaced(scores=[1, 3, 2, 3, 0, 2], object_ids=range(6))
    assert grasps.top(4).object_ids.tolist() == [1, 3, 2, 5]
    assert grasps[2].object_ids.tolist() == [2]
    assert grasps[grasps.scores > 2].object_ids.tolist() == [1, 3]
    assert len(Grasps.concatenated([grasps[:2], grasps[4], Grasps.empty()])) == 3


def test_another_frame_moves_tips_and_axes_together() -> None:
    grasps = some_grasps()
    T = SE3(Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_matrix(), np.array([1.0, -2.0, 0.5]))
    moved = grasps.transformed(T.matrix())
    assert np.allclose(moved.tips, T @ grasps.tips)
    assert np.allclose(moved.poses(), T.matrix() @ grasps.poses())
    assert np.allclose(moved.transformed(T.inverse()).to_array(), grasps.to_array())
    assert np.array_equal(moved.widths, grasps.widths)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"scores": [1.0]}, "shape"),
        ({"widths": np.full(5, np.nan)}, "finite"),
        ({"rotations": np.tile(np.diag([1.0, 1, -1]), (5, 1, 1))}, "rotation"),
        ({"rotations": np.tile(2 * np.eye(3), (5, 1, 1))}, "rotation"),
        ({"translations": np.zeros((5, 2))}, "shape"),
    ],
)
def test_what_is_no_grasp_is_refused(change: dict, told: str) -> None:
    with pytest.raises(ToolkitError, match=told):
        some_grasps().replaced(**change)


def test_arrays_of_another_width_are_refused() -> None:
    with pytest.raises(ToolkitError, match="17"):
        Grasps.from_array(np.zeros((3, 16)))
    with pytest.raises(ToolkitError, match="finite"):
        Grasps.from_array(np.full((3, 17), np.nan))


def test_graspnets_hand_is_that_of_its_evaluation() -> None:
    boxes = GRASPNET.boxes([0.06], [0.03])
    left, right, palm = boxes.low[0], boxes.high[0], None
    assert np.allclose(left[0], [-0.02, -0.04, -0.01]) and np.allclose(
        right[0], [0.03, -0.03, 0.01]
    )
    assert np.allclose(left[1], [-0.02, 0.03, -0.01]) and np.allclose(right[1], [0.03, 0.04, 0.01])
    palm = boxes.low[0, 2], boxes.high[0, 2]
    assert np.allclose(palm[0], [-0.03, -0.04, -0.01])
    assert np.allclose(palm[1], [-0.02, 0.04, 0.01])
    between = GRASPNET.between([0.06], [0.03])
    assert np.allclose(between.low[0, 0], [-0.02, -0.03, -0.01])
    assert np.allclose(between.high[0, 0], [0.03, 0.03, 0.01])


@pytest.mark.parametrize("name", GRIPPERS)
def test_no_box_of_a_gripper_overlaps_the_space_between_its_fingers(name: str) -> None:
    gripper = get_gripper(name)
    widths, depths = np.linspace(0, gripper.max_width, 5), np.full(5, 0.02)
    boxes, between = gripper.boxes(widths, depths), gripper.between(widths, depths)
    shared = np.minimum(boxes.high, between.high) - np.maximum(boxes.low, between.low)
    assert (shared.min(axis=-1) < 1e-12).all()
    # It is one body: mirrored in y, tips at the depth.
    assert np.allclose(boxes.low[:, :-1:2, 1], -boxes.high[:, 1::2, 1])
    assert np.allclose(boxes.high[..., 0].max(axis=1), depths)


def test_the_pandas_fingers_keep_their_length() -> None:
    assert PANDA.palm_front([0.01, 0.04]).tolist() == pytest.approx([-0.036, -0.006])
    with pytest.raises(ToolkitError, match="known: panda"):
        get_gripper("hand")
