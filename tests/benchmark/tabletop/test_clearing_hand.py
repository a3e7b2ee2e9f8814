"""The hand: what it holds, what it misses, what stops it."""

import numpy as np
import pytest

from benchmark.metrics.grasp import Grasps
from benchmark.metrics.grasp.gripper import PANDA
from benchmark.tabletop.grasp import GRIP_N, JawTrial, execute
from benchmark.tabletop.trial import LIFT_M, PAD_FRICTION
from std_toolkit.errors import ToolkitError
from tests.benchmark.tabletop.clearing_cases import box, from_above, standing

pytest.importorskip("mujoco")
CUBE = box((0.05, 0.05, 0.05), "cube")


def _try(grasp: Grasps, *, mass: float = 0.15, things=(CUBE,), poses=None):
    poses = poses or [standing(t) for t in things]
    return execute(things, poses, grasp, masses_kg=[mass] * len(things))


def test_a_cube_between_the_fingers_is_lifted_and_held():
    done = _try(from_above((0, 0, 0.015)))
    assert done.outcome == "held"
    assert done.held == (0,)
    assert done.poses[0].t[2] == pytest.approx(0.025 + LIFT_M, abs=0.01)
    assert [s.name for s in done.stages] == ["pre-grasp", "closed", "lifted"]
    # Closed on 5 cm: not through it, and not short of it.
    assert done.stages[1].opening == pytest.approx(0.05, abs=0.002)
    assert done.pushed_m < 0.002


def test_an_object_off_the_middle_is_drawn_into_it():
    done = _try(from_above((0, 0.006, 0.015)))
    assert done.outcome == "held"


def test_free_air_holds_nothing():
    done = _try(from_above((0, 0.15, 0.02)))
    assert done.outcome == "nothing-between"
    assert done.stages[1].opening < 0.002
    assert np.allclose(done.poses[0].t, standing(CUBE).t, atol=1e-3)


def test_the_table_stops_the_hand():
    assert _try(from_above((0, 0.15, -0.02))).outcome == "blocked-by-table"


def test_a_finger_that_comes_down_on_an_object_is_stopped():
    # The jaw is narrower than the cube: both fingers land on its top.
    assert _try(from_above((0, 0, 0.015), width=0.03)).outcome == "blocked-by-object"


def test_a_hand_that_starts_in_an_object_does_not_move():
    tall = box((0.03, 0.03, 0.25), "tower")
    done = _try(from_above((0, 0, 0.03)), things=(tall,))
    assert done.outcome == "start-hits-object"
    assert len(done.stages) == 1


def test_what_is_heavier_than_friction_holds_slips():
    # Two pads hold at most twice their friction's share of the grip.
    limit = 2 * PAD_FRICTION[0] * GRIP_N / 9.81
    assert _try(from_above((0, 0, 0.015)), mass=0.3 * limit).outcome == "held"
    assert _try(from_above((0, 0, 0.015)), mass=1.5 * limit).outcome == "slipped"


def test_the_neighbour_stays():
    other = box((0.05, 0.05, 0.05), "other-cube")
    poses = [standing(CUBE), standing(other, x=0.15)]
    done = _try(from_above((0, 0, 0.015)), things=(CUBE, other), poses=poses)
    assert done.held == (0,)
    assert np.allclose(done.poses[1].t, poses[1].t, atol=1e-3)


def test_the_same_grasp_ends_the_same_to_the_bit():
    first, second = (_try(from_above((0, 0.004, 0.02))) for _ in range(2))
    assert first.poses[0].t.tobytes() == second.poses[0].t.tobytes()
    assert first.poses[0].R.tobytes() == second.poses[0].R.tobytes()


def test_several_grasps_at_once_are_refused():
    two = Grasps.concatenated([from_above((0, 0, 0.02))] * 2)
    with pytest.raises(ToolkitError, match="one grasp"):
        _try(two)


def test_a_move_ends_where_it_was_sent():
    hand = JawTrial([CUBE], [standing(CUBE)], from_above((0, 0, 0.015)), [0.15], PANDA)
    target = hand.data.ctrl[:3] + np.array([0.01, -0.02, 0.05])
    hand._move(target, 0.2)
    np.testing.assert_allclose(hand.data.ctrl[:3], target, atol=1e-12)


def test_a_hand_that_starts_in_the_table_does_not_move():
    done = _try(from_above((0, 0.15, -0.2)))
    assert done.outcome == "start-hits-table"
    assert len(done.stages) == 1


def test_a_guarded_move_holds_what_stopped_the_palm():
    # The palm meets the top of the tower, whose sides the fingers have passed: they close 6 mm
    # higher. A straight move ends there.
    tall = box((0.03, 0.03, 0.12), "tower")
    grasp = from_above((0, 0, 0.06))
    assert _try(grasp, things=(tall,)).outcome == "held"
    straight = execute([tall], [standing(tall)], grasp, masses_kg=[0.15], guarded=False)
    assert straight.outcome == "blocked-by-object"
    assert [s.name for s in straight.stages] == ["pre-grasp", "stopped"]


def test_a_guarded_move_stops_at_a_light_touch():
    # Both fingers land on the top of a cube; it is not pressed into the table, and stays.
    done = _try(from_above((0, 0, 0.015), width=0.03))
    assert done.outcome == "blocked-by-object"
    assert np.allclose(done.poses[0].t, standing(CUBE).t, atol=1e-3)
