"""One round of clearing: capture, restore, plan, grasp, until the table is empty or ten attempts
are made."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmark.methods.protocol import GraspView
from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import PANDA, Gripper
from benchmark.metrics.grasp.suction import SuctionCup
from benchmark.tabletop.arrange import Arrangement, TableObject, off_table
from benchmark.tabletop.grasp import execute
from benchmark.tabletop.sense import Observation, TableCamera
from benchmark.tabletop.trial import APPROACH_M, Execution
from sensors.physics.rigid_bodies import World, come_to_rest
from std_toolkit.geometry import SE3, Camera, rotation_angle
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

MOST_ATTEMPTS = 10
NO_GRASP = "no-grasp"
_LONGEST_REST_S = 4.0


@dataclass(frozen=True, kw_only=True)
class RoundSettings(Settings):
    """Grasps that are tried, and when a round ends."""

    blind_views: int = limit(3, source=NOT_RECORDED)
    """consecutive views without any grasp that end a round"""
    steepest: float = limit(
        np.deg2rad(80.0),
        unit="rad",
        source="an arm does not approach from below",
    )
    """largest angle between approach and straight down"""
    same_m: float = limit(0.012, unit="m", source=NOT_RECORDED)
    """a grasp this close to one that failed is tried after all others"""
    same_rad: float = limit(np.deg2rad(25.0), unit="rad", source=NOT_RECORDED)
    """the same for its orientation"""
    below_m: float = limit(0.002, unit="m", source=NOT_RECORDED)
    """how far below the table the gripper may reach"""


@dataclass(frozen=True, eq=False)
class GivenDepth:
    """Input of a planner: depth with colour and camera of its size."""

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    camera: Camera


@dataclass(frozen=True, eq=False)
class State:
    """Objects on the table before an attempt."""

    objects: tuple[TableObject, ...]
    poses: tuple[SE3, ...]


Restore = Callable[[Observation], GivenDepth]
# Returns grasps in the camera frame; only planners with ground truth use the state.
Plan = Callable[[GraspView, State], Grasps]


@dataclass(frozen=True, eq=False)
class Attempt:
    """One view and its attempt.

    Attributes:
        number: 0, 1, ... within the round.
        before: state of the table.
        observation, given: camera view, and input of the planner.
        planned: grasps of the planner, in the camera frame.
        grasp: the executed grasp, in the world frame; None without a usable grasp.
        executed: its result.
        removed: numbers of the objects that were held and removed.
        lost: numbers of the objects that fell or rolled off the table.
    """

    number: int
    before: State
    observation: Observation
    given: GivenDepth
    planned: Grasps
    grasp: Grasps | None = None
    executed: Execution | None = None
    removed: tuple[int, ...] = ()
    lost: tuple[int, ...] = ()

    @property
    def found(self) -> int:
        """Number of grasps of the planner."""
        return len(self.planned)

    @property
    def outcome(self) -> str:
        """`held`, or the reason of failure."""
        return NO_GRASP if self.executed is None else self.executed.outcome


@dataclass
class _Memory:
    """Grasps that failed, as (tips, rotations) in the world."""

    failed: list[tuple[Array, Array]] = field(default_factory=list)

    def knows(self, tip: Array, R: Array) -> bool:
        limits = RoundSettings.current()
        return any(
            np.linalg.norm(tip - t) < limits.same_m and _turn(R, Q) < limits.same_rad
            for t, Q in self.failed
        )


def clear_table(
    arrangement: Arrangement,
    camera: TableCamera,
    restore: Restore,
    plan: Plan,
    *,
    color: bool,
    gripper: Gripper | SuctionCup = PANDA,
    attempts: int = MOST_ATTEMPTS,
    guarded: bool = True,
) -> Iterator[Attempt]:
    """Yield the attempts of a round. The same input gives the same attempts.

    Args:
        arrangement: the table at the start.
        camera: camera, used before every attempt.
        restore: returns the input of the planner.
        plan: the planner.
        color: whether colour is used.
        gripper: the gripper.
        attempts: maximum number of attempts.
        guarded: see `execute`.
    """
    state = State(arrangement.objects, arrangement.poses)
    memory, blind = _Memory(), 0
    for number in range(attempts):
        if not state.objects or blind == RoundSettings.current().blind_views:
            return
        observation = camera.observe(state.objects, state.poses, number, color=color)
        given = restore(observation)
        T_world_cam = camera.T_world_cam
        view = GraspView(
            given.color, given.depth, given.camera, T_cam_table=T_world_cam.inverse().matrix()
        )
        planned = plan(view, state)
        chosen = choose(planned.transformed(T_world_cam), memory, gripper)
        if chosen is None:
            blind += 1
            yield Attempt(number, state, observation, given, planned)
            continue
        blind = 0
        executed = execute(
            [o.body for o in state.objects], state.poses, chosen,
            masses_kg=[o.mass_kg for o in state.objects], gripper=gripper, guarded=guarded,
        )  # fmt: skip
        if not executed.held:
            memory.failed.append((chosen.tips[0], chosen.rotations[0]))
        following, lost = _after(state, executed)
        yield Attempt(
            number, state, observation, given, planned, chosen, executed,
            tuple(state.objects[k].number for k in executed.held), lost,
        )  # fmt: skip
        state = following


def choose(grasps: Grasps, memory: _Memory, gripper: Gripper | SuctionCup) -> Grasps | None:
    """Return the best grasp that an arm above the table can reach; None if there is none.

    Grasps similar to failed ones of this round come last. Otherwise the same grasp would be
    repeated if the camera has no noise.
    """
    fine = grasps[reachable(grasps, gripper)]
    for k in range(len(fine)):
        if not memory.knows(fine.tips[k], fine.rotations[k]):
            return fine[k]
    return fine[0] if len(fine) else None


def reachable(grasps: Grasps, gripper: Gripper | SuctionCup) -> NDArray[np.bool_]:
    """Return the (N,) mask of grasps in the world frame from above and without table contact."""
    limits = RoundSettings.current()
    if not len(grasps):
        return np.zeros(0, bool)
    steep = grasps.approaches[:, 2] < -np.cos(limits.steepest)
    boxes = gripper.boxes(np.minimum(grasps.widths, gripper.max_width), grasps.depths)
    up = grasps.rotations[:, 2]  # z component of each gripper axis
    lowest = np.minimum(boxes.low * up[:, None], boxes.high * up[:, None]).sum(axis=2).min(axis=1)
    return steep & (lowest + grasps.translations[:, 2] > -limits.below_m)


def _after(state: State, executed: Execution) -> tuple[State, tuple[int, ...]]:
    """State of the table after gripper and held objects are removed and the rest is at rest."""
    left = [k for k in range(len(state.objects)) if k not in executed.held]
    if not left:
        return State((), ()), ()
    world = World([state.objects[k].body for k in left])
    world.place([executed.poses[k] for k in left])
    # Objects that still roll after that keep their current pose.
    come_to_rest(world, _LONGEST_REST_S)
    poses = world.poses()
    gone = set(off_table(poses))
    lost = tuple(state.objects[k].number for i, k in enumerate(left) if i in gone)
    kept = [(state.objects[k], poses[i]) for i, k in enumerate(left) if i not in gone]
    return State(tuple(o for o, _ in kept), tuple(T for _, T in kept)), lost


def _turn(R: Array, Q: Array) -> float:
    """Angle between two grasps, modulo half a turn about the approach."""
    half = np.diag([1.0, -1.0, -1.0])
    return min(rotation_angle(R.T @ Q), rotation_angle(half @ R.T @ Q))


def target_of(attempt: Attempt, points: Sequence[Array]) -> int | None:
    """Return the index of the object whose surface is nearest to the target of the fingertips; None
    without a grasp.

    Args:
        attempt: the attempt.
        points: (N, 3) surface points of each object on the table, world frame.
    """
    if attempt.grasp is None:
        return None
    middle = attempt.grasp.tips[0] - 0.01 * attempt.grasp.approaches[0]
    return int(np.argmin([np.linalg.norm(p - middle, axis=1).min() for p in points]))


__all__ = ["APPROACH_M", "Attempt", "GivenDepth", "State", "clear_table", "target_of"]
