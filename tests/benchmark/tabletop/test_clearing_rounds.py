"""A round: it ends when the table is empty, when nothing is found, or after ten attempts."""

import numpy as np
import pytest

from benchmark.evaluation.tasks.grasp_pictures import HEIGHT, PANELS, WIDTH, attempt_strip
from benchmark.evaluation.tasks.grasp_table import (
    ATTEMPT,
    GRASPED,
    KIND,
    LEFT,
    OBJECT,
    PRECISION,
    rows_of_round,
)
from benchmark.metrics.grasp import PANDA, Grasps
from benchmark.tabletop.arrange import Arrangement
from benchmark.tabletop.oracle import plan_from_surfaces, surfaces_of
from benchmark.tabletop.round import GivenDepth, clear_table, reachable
from benchmark.tabletop.sense import camera_pose
from tests.benchmark.tabletop.clearing_cases import (
    TrueCamera,
    box,
    from_above,
    standing,
    table_object,
)

pytest.importorskip("mujoco")
THINGS = [box((0.04, 0.06, 0.07), "tall"), box((0.05, 0.05, 0.04), "low")]
ARRANGEMENT = Arrangement(
    5,
    tuple(table_object(t, k) for k, t in enumerate(THINGS)),
    (standing(THINGS[0], x=-0.08), standing(THINGS[1], x=0.08)),
)


def given(observation):
    return GivenDepth(
        observation.frame.color, observation.frame.depth_true, observation.frame.camera
    )


def oracle(_view, state):
    surfaces = surfaces_of([o.body for o in state.objects], state.poses)
    return plan_from_surfaces(surfaces).transformed(camera_pose().inverse())


def always(grasps):
    return lambda _view, _state: grasps


def _round(plan, attempts=10):
    return list(clear_table(ARRANGEMENT, TrueCamera(), given, plan, color=False, attempts=attempts))


@pytest.mark.slow
def test_who_knows_the_objects_clears_the_table():
    attempts = _round(oracle)
    assert [a.outcome for a in attempts] == ["held", "held"]
    assert {n for a in attempts for n in a.removed} == {0, 1}
    # The second view shows what is left, where it stood.
    assert [len(a.before.objects) for a in attempts] == [2, 1]
    left = attempts[1].before.poses[0].t
    start = ARRANGEMENT.poses[attempts[1].before.objects[0].number].t
    assert np.allclose(left, start, atol=0.003)
    rows = rows_of_round(3, ARRANGEMENT, attempts, camera_pose())
    fates = [(r["fate"], r["material"]) for r in rows if r[KIND] == OBJECT]
    assert fates == [(GRASPED, "specular")] * 2
    strip = attempt_strip(attempts[0])
    assert strip.shape[1] == len(PANELS) * WIDTH and strip.shape[0] > HEIGHT
    # The hand is in the pictures of what it did, and not in that of the camera.
    orange = (strip[..., 0].astype(int) - strip[..., 2]) > 60
    assert orange[:, 2 * WIDTH :].sum() > 1000 > 5 > orange[20:, :WIDTH].sum()


def test_a_blind_planner_ends_the_round_after_three_views():
    attempts = _round(always(Grasps.empty()))
    assert [a.outcome for a in attempts] == ["no-grasp"] * 3
    rows = rows_of_round(0, ARRANGEMENT, attempts, camera_pose())
    assert [r["fate"] for r in rows if r[KIND] == OBJECT] == [LEFT, LEFT]


def test_what_was_planned_on_the_first_view_is_judged_by_the_meshes():
    air, right = from_above((0.0, 0.15, 0.03)), from_above((-0.08, 0.0, 0.06), width=0.07)
    for planned, friction in ((right, 0.2), (air, None), (Grasps.empty(), None)):
        attempts = _round(always(planned.transformed(camera_pose().inverse())), attempts=2)
        rows = rows_of_round(0, ARRANGEMENT, attempts, camera_pose())
        first, *others = [r for r in rows if r[KIND] == ATTEMPT]
        # One grasp of the fifty that count, first of all: 1 / 50 of 1, 1/2, 1/3, ... at every
        # friction, since a box's parallel sides need none.
        expected = np.mean(1 / np.arange(1, 51)) if friction else 0.0
        assert [first[n] for n in PRECISION] == pytest.approx([expected] * 3)
        assert all(np.isnan(r["ap"]) for r in others)


def test_a_grasp_that_failed_is_tried_after_all_others():
    air, right = from_above((0.0, 0.15, 0.03)), from_above((-0.08, 0.0, 0.04), width=0.078)
    both = Grasps.concatenated([air, right]).transformed(camera_pose().inverse())
    attempts = _round(always(both), attempts=3)
    # First the planner's best, then the other one, and what failed only when nothing else is left.
    assert [a.outcome for a in attempts[:2]] == ["nothing-between", "held"]
    tips = [a.grasp.tips[0] for a in attempts]
    assert np.allclose(tips[0], [0, 0.15, 0.03], atol=1e-9)
    assert np.allclose(tips[1], [-0.08, 0, 0.04], atol=1e-9)


@pytest.mark.slow
def test_ten_attempts_at_most():
    air = from_above((0.0, 0.15, 0.03)).transformed(camera_pose().inverse())
    assert len(_round(always(air))) == 10


def test_only_grasps_from_above_the_table_can_be_come_to():
    good, deep = from_above((0, 0, 0.02)), from_above((0, 0, -0.01))
    turned = good.replaced(rotations=good.rotations @ np.diag([-1.0, 1.0, -1.0]))
    all_three = Grasps.concatenated([good, deep, turned])
    assert reachable(all_three, PANDA).tolist() == [True, False, False]
    assert reachable(Grasps.empty(), PANDA).shape == (0,)
