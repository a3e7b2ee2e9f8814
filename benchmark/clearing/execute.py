"""One grasp carried out with contact physics: pre-grasp, approach, closing, lift, hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.clearing.hand import AXES, CLOSED, FINGERS, add_hand
from benchmark.grasping.grasp import Grasps
from benchmark.grasping.gripper import PANDA, Gripper
from sensors.physics.world import TIMESTEP_S, PhysicalObject, objects_on_floor
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3

Array = NDArray[np.float64]

# Way of the fingertips from the pre-grasp to the grasp, and of the lift.
APPROACH_M, LIFT_M = 0.10, 0.25
_APPROACH_M_S, _LIFT_M_S = 0.12, 0.25
_CLOSE_S, _HOLD_S = 0.6, 1.0
# A carriage that stays behind so far has met something that it cannot push away.
_LAG_M = 0.004
# Overlap of the hand with something in the pre-grasp that is taken for a touch.
_TOUCH_M = 0.001
# Fingers nearer than this to each other hold nothing.
_SHUT_M = 0.0015
# An object counts as held when all of it is so high above the table.
HELD_M = 0.10
_CONTROL_STEPS = 5


@dataclass(frozen=True, eq=False)
class Stage:
    """Where everything was at one moment.

    Attributes:
        name: `pre-grasp`, `closed` or `lifted`.
        T_world_hand: the hand's pose, in the convention of `Grasps` with depth 0.
        opening: between the fingers, metres.
        poses: T_world_obj.
    """

    name: str
    T_world_hand: SE3
    opening: float
    poses: tuple[SE3, ...]


@dataclass(frozen=True, eq=False)
class Executed:
    """What became of a grasp.

    Attributes:
        outcome: `held`, or why nothing was: `start-hits-table`, `start-hits-object`,
            `blocked-by-table`, `blocked-by-object`, `nothing-between`, `slipped`.
        held: indices of the objects that were in the hand after holding.
        touched: indices of the objects that the closed fingers touched before the lift.
        pushed_m: farthest that an object was moved by the approach.
        poses: T_world_obj of all objects when the hand is taken away.
        stages: as far as it came.
    """

    outcome: str
    held: tuple[int, ...]
    touched: tuple[int, ...]
    pushed_m: float
    poses: tuple[SE3, ...]
    stages: tuple[Stage, ...]


def execute(
    objects: Sequence[PhysicalObject],
    poses: Sequence[SE3],
    grasp: Grasps,
    *,
    masses_kg: Sequence[float] | None = None,
    gripper: Gripper = PANDA,
) -> Executed:
    """Carry out a grasp. The same input gives the same outcome, bit for bit.

    Args:
        objects: on the table, whose plane is z = 0.
        poses: T_world_obj, at rest.
        grasp: one, in the world's frame.
        masses_kg: of the objects; equal by default.
        gripper: the hand.

    Raises:
        ToolkitError: more or less than one grasp, or MuJoCo is not installed.
    """
    if len(grasp) != 1:
        raise ToolkitError("takes one grasp at a time", value=len(grasp))
    return _Attempt(objects, poses, grasp, masses_kg, gripper).run()


class _Attempt:
    def __init__(
        self,
        objects: Sequence[PhysicalObject],
        poses: Sequence[SE3],
        grasp: Grasps,
        masses_kg: Sequence[float] | None,
        gripper: Gripper,
    ) -> None:
        import mujoco

        self._mujoco = mujoco
        self.objects, self.start = tuple(objects), tuple(poses)
        self.R, self.approach = grasp.rotations[0], grasp.approaches[0]
        self.tip = grasp.tips[0]
        width = float(np.clip(grasp.widths[0], 2 * _SHUT_M, gripper.max_width))
        spec = objects_on_floor(self.objects, masses_kg=masses_kg)
        # Flat pads on flat sides need more than one point of contact: since MuJoCo 4 that is so
        # without asking.
        spec.option.enableflags |= int(getattr(mujoco.mjtEnableBit, "mjENBL_MULTICCD", 0))
        add_hand(spec, gripper, self.R)
        self.model = spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        self.stages: list[Stage] = []
        self._name_bodies()
        for i, T in enumerate(self.start):
            self.data.qpos[7 * i : 7 * i + 3] = T.t
            self.data.qpos[7 * i + 3 : 7 * i + 7] = T.quat()
        first = 7 * len(self.objects)
        self._carriage, self._fingers = slice(first, first + 3), slice(first + 3, first + 5)
        self.data.qpos[self._carriage] = self.tip - APPROACH_M * self.approach
        self.data.qpos[self._fingers] = width / 2
        self.data.ctrl[:3] = self.data.qpos[self._carriage]
        self.data.ctrl[3:] = width / 2
        mujoco.mj_forward(self.model, self.data)

    def _name_bodies(self) -> None:
        """For each body: -1 the table, -2 the hand, else the index of the object."""
        self.owner = np.full(self.model.nbody, -2)
        self.owner[0] = -1
        for i in range(len(self.objects)):
            self.owner[self.model.body(f"object{i}").id] = i
        if [self.model.actuator(k).name for k in range(self.model.nu)] != [*AXES, *FINGERS]:
            raise AssertionError("the servos are not in the order that their targets are")

    def run(self) -> Executed:
        self._keep("pre-grasp")
        start = self._met(deeper=_TOUCH_M)
        if start:
            return self._ended("start-hits-table" if -1 in start else "start-hits-object")
        if not self._move(self.tip, _APPROACH_M_S, stops=True):
            met = self._met()
            self._keep("stopped")
            return self._ended("blocked-by-table" if -1 in met else "blocked-by-object")
        self.pushed = max((float(np.linalg.norm(b.t - a.t)) for a, b in self._pairs()), default=0.0)
        self._close()
        self._keep("closed")
        touched = tuple(sorted(i for i in self._touched_by_fingers() if i >= 0))
        nothing = self._opening() < 2 * _SHUT_M or not touched
        self._move(self.tip + np.array([0, 0, LIFT_M]), _LIFT_M_S)
        self._wait(_HOLD_S)
        self._keep("lifted")
        held = tuple(i for i, low in enumerate(self._lowest()) if low > HELD_M)
        if held:
            return self._ended("held", held, touched)
        return self._ended("nothing-between" if nothing else "slipped", (), touched)

    def _ended(
        self, outcome: str, held: tuple[int, ...] = (), touched: tuple[int, ...] = ()
    ) -> Executed:
        return Executed(
            outcome, held, touched, getattr(self, "pushed", 0.0), self._poses(), tuple(self.stages)
        )

    def _move(self, target: Array, speed: float, *, stops: bool = False) -> bool:
        """Go straight to a place; False if something was in the way and `stops` is asked for."""
        begin = self.data.ctrl[:3].copy()
        # The fastest moment of this smooth course is 15/8 of its mean.
        seconds = 15 / 8 * float(np.linalg.norm(target - begin)) / speed
        steps = max(1, round(seconds / TIMESTEP_S / _CONTROL_STEPS))
        for k in range(1, steps + 1):
            s = k / steps
            self.data.ctrl[:3] = begin + (target - begin) * s**3 * (10 - 15 * s + 6 * s**2)
            self._step(_CONTROL_STEPS)
            if stops and self._lag() > _LAG_M:
                self.data.ctrl[:3] = self.data.qpos[self._carriage]
                return False
        self._step(50)
        return not (stops and self._lag() > _LAG_M)

    def _close(self) -> None:
        self.data.ctrl[3:] = CLOSED
        self._wait(_CLOSE_S)

    def _wait(self, seconds: float) -> None:
        self._step(round(seconds / TIMESTEP_S))

    def _step(self, count: int) -> None:
        self._mujoco.mj_step(self.model, self.data, count)

    def _lag(self) -> float:
        return float(np.linalg.norm(self.data.ctrl[:3] - self.data.qpos[self._carriage]))

    def _opening(self) -> float:
        return float(self.data.qpos[self._fingers].sum())

    def _poses(self) -> tuple[SE3, ...]:
        rows = self.data.qpos[: 7 * len(self.objects)].reshape(-1, 7)
        return tuple(SE3.from_quat(row[3:], row[:3]) for row in rows)

    def _pairs(self) -> list[tuple[SE3, SE3]]:
        return list(zip(self.start, self._poses(), strict=True))

    def _keep(self, name: str) -> None:
        T = SE3(self.R, self.data.qpos[self._carriage].copy())
        self.stages.append(Stage(name, T, max(self._opening(), 0.0), self._poses()))

    def _met(self, *, deeper: float = 0.0) -> set[int]:
        """What the hand touches: object indices, -1 for the table."""
        return self._touched(lambda _: True, deeper)

    def _touched_by_fingers(self) -> set[int]:
        ids = {self.model.body(name).id for name in FINGERS}
        return self._touched(lambda body: body in ids, 0.0)

    def _touched(self, wanted: Any, deeper: float) -> set[int]:
        met: set[int] = set()
        for contact in self.data.contact:
            bodies = [int(self.model.geom_bodyid[g]) for g in (contact.geom1, contact.geom2)]
            for mine, other in (bodies, bodies[::-1]):
                is_hand = self.owner[mine] == -2 and wanted(mine)
                if is_hand and self.owner[other] != -2 and contact.dist < -deeper:
                    met.add(int(self.owner[other]))
        return met

    def _lowest(self) -> list[float]:
        """Height of every object's lowest point."""
        return [
            min(float((T @ (part * o.diagonal_m))[:, 2].min()) for part in o.parts)
            for o, T in zip(self.objects, self._poses(), strict=True)
        ]
