"""A tool on a carriage above a table in MuJoCo: moves, contacts, and what they leave behind.

Servos of limited force move the tool along the three world axes with fixed orientation, as an arm
with a stiff wrist in a straight move.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.grasp.grasp import Grasps
from sensors.physics.rigid_bodies import TIMESTEP_S, PhysicalObject, objects_on_floor
from std_toolkit.geometry.se3 import SE3
from std_toolkit.settings import NOT_RECORDED, Settings, limit

CARRIAGE, HAND = "carriage", "hand"

AXES = ("along-x", "along-y", "along-z")

# The Panda's hand weighs 0.73 kg, of which each finger has 0.015 (its maker's description).
HAND_KG, FINGER_KG = 0.7, 0.015

# Sliding, torsional and rolling friction of rubber on glass and metal.
PAD_FRICTION = (0.8, 0.005, 0.0001)

# An arm with a collision reflex stops at about this.
PUSH_N = 40.0

# A guarded move backs off by this way.
BACK_OFF_M = 0.006

# Servo of the carriage: N/m and N s/m, critically damped for hand and armature together.
_STIFFNESS, _ARMATURE_KG = 20_000.0, 0.5

_DAMPING = 2 * np.sqrt(_STIFFNESS * (HAND_KG + 2 * FINGER_KG + _ARMATURE_KG))

SOLREF = (0.004, 1.0)

Array = NDArray[np.float64]

# Distance of the tips from the pre-grasp to the grasp, and height of the lift.
APPROACH_M, LIFT_M = 0.10, 0.25

APPROACH_M_S, LIFT_M_S = 0.12, 0.25

HOLD_S = 1.0


CONTROL_STEPS = 5


@dataclass(frozen=True, kw_only=True)
class TrialSettings(Settings):
    """When a tool is blocked, and when an object is held."""

    touch_n: float = limit(8.0, unit="N", source=NOT_RECORDED)
    """a guarded move stops at this force of contact"""
    lag_m: float = limit(0.004, unit="m", source=NOT_RECORDED)
    """a carriage with this lag is blocked by an obstacle"""
    touch_m: float = limit(0.001, unit="m", source=NOT_RECORDED)
    """smallest overlap of the tool in the pre-grasp that counts as contact"""
    held_m: float = limit(0.10, unit="m", source=NOT_RECORDED)
    """an object counts as held if all of it is at least this high above the table"""


def add_carriage(spec: Any, R: Array) -> Any:
    """Add a carriage with its servos to a model specification, and return the body of its hand.

    Its joints are the three of the carriage, metres in the world.

    Args:
        spec: a `mujoco.MjSpec`.
        R: (3, 3) orientation of the hand: the axes of a grasp as columns.
    """
    import mujoco

    slide = mujoco.mjtJoint.mjJNT_SLIDE
    carriage = spec.worldbody.add_body(name=CARRIAGE, gravcomp=1.0)
    for name, axis in zip(AXES, np.eye(3), strict=True):
        carriage.add_joint(
            name=name, type=slide, axis=axis, damping=_DAMPING, armature=_ARMATURE_KG
        )
        add_servo(spec, name, _STIFFNESS, PUSH_N)
    quat = SE3(np.asarray(R, dtype=np.float64), np.zeros(3)).quat()
    return carriage.add_body(name=HAND, quat=quat, gravcomp=1.0)


def add_servo(spec: Any, joint: str, stiffness: float, force: float) -> None:
    """Add a servo of limited force to a joint."""
    import mujoco

    actuator = spec.add_actuator(
        name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT,
        forcelimited=True, forcerange=[-force, force],
    )  # fmt: skip
    actuator.set_to_position(kp=stiffness)


@dataclass(frozen=True, eq=False)
class Stage:
    """Poses of gripper and objects at one moment.

    Attributes:
        name: `pre-grasp`, `stopped`, `closed`, `sealed` or `lifted`.
        T_world_hand: pose of the gripper, in the convention of `Grasps` with depth 0.
        opening: distance between the fingers, metres; 0 of a suction cup.
        poses: T_world_obj.
    """

    name: str
    T_world_hand: SE3
    opening: float
    poses: tuple[SE3, ...]


@dataclass(frozen=True, eq=False)
class Execution:
    """Result of a grasp.

    Attributes:
        outcome: `held`, or the reason of failure: `start-hits-table`, `start-hits-object`,
            `blocked-by-table`, `blocked-by-object`, `slipped`; of a jaw `nothing-between`; of a
            suction cup `no-contact`, `no-seal`. A guarded move of a jaw that was stopped and
            holds nothing in the end is blocked.
        held: indices of the objects in the gripper after holding.
        touched: indices of the objects that the closed fingers, or the cup, touched before the
            lift.
        pushed_m: largest displacement of an object by the approach, metres.
        poses: T_world_obj of all objects when the gripper is removed.
        stages: the stages reached.
    """

    outcome: str
    held: tuple[int, ...]
    touched: tuple[int, ...]
    pushed_m: float
    poses: tuple[SE3, ...]
    stages: tuple[Stage, ...]


class Trial:
    """One attempt with a tool, from the pre-grasp to the end of the lift.

    Args:
        objects: objects on the table, whose plane is z = 0.
        poses: T_world_obj, at rest.
        grasp: one grasp, in the world frame.
        masses_kg: masses of the objects; equal by default.
        tool: that grasps.
        guarded: a jaw stops at a contact, backs off and closes, instead of giving up.
    """

    # Names of all servos, those of the carriage first.
    servos: tuple[str, ...] = AXES

    def __init__(
        self,
        objects: Sequence[PhysicalObject],
        poses: Sequence[SE3],
        grasp: Grasps,
        masses_kg: Sequence[float] | None,
        tool: Any,
        guarded: bool = True,
    ) -> None:
        import mujoco

        self._mujoco = mujoco
        self.tool, self.grasp, self.guarded = tool, grasp, guarded
        self.objects, self.start = tuple(objects), tuple(poses)
        self.R, self.approach = grasp.rotations[0], grasp.approaches[0]
        self.tip = grasp.tips[0]
        spec = objects_on_floor(self.objects, masses_kg=masses_kg)
        # Flat pads on flat sides need several contact points, which is the default since MuJoCo 4.
        spec.option.enableflags |= int(getattr(mujoco.mjtEnableBit, "mjENBL_MULTICCD", 0))
        self.add_tool(spec)
        self.model = spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        self.stages: list[Stage] = []
        self._pushed = 0.0
        self._name_bodies()
        for i, T in enumerate(self.start):
            self.data.qpos[7 * i : 7 * i + 3] = T.t
            self.data.qpos[7 * i + 3 : 7 * i + 7] = T.quat()
        first = 7 * len(self.objects)
        self._carriage = slice(first, first + 3)
        self.data.qpos[self._carriage] = self.tip - APPROACH_M * self.approach
        self.data.ctrl[:3] = self.data.qpos[self._carriage]
        self.open_tool(first + 3)
        mujoco.mj_forward(self.model, self.data)

    def add_tool(self, spec: Any) -> None:
        """Add the tool, and the carriage that it is on, to the model."""
        raise NotImplementedError

    def open_tool(self, place: int) -> None:
        """Set the joints of the tool, which begin at `place` in the state."""

    def run(self) -> Execution:
        """Do all of it."""
        raise NotImplementedError

    def opening(self) -> float:
        """Return the opening of the tool, metres."""
        return 0.0

    def _name_bodies(self) -> None:
        """Number each body: -1 the table, -2 the tool, otherwise the index of the object."""
        self.owner = np.full(self.model.nbody, -2)
        self.owner[0] = -1
        for i in range(len(self.objects)):
            self.owner[self.model.body(f"object{i}").id] = i
        if [self.model.actuator(k).name for k in range(self.model.nu)] != list(self.servos):
            raise AssertionError("the servos are not in the order that their targets are")

    def _hits_at_start(self) -> str:
        """Outcome of a tool that is in something before it moves, or ""."""
        start = self._met(deeper=TrialSettings.current().touch_m)
        if not start:
            return ""
        return "start-hits-table" if -1 in start else "start-hits-object"

    def _blocked(self) -> str:
        return "blocked-by-table" if -1 in self._met() else "blocked-by-object"

    def _note_push(self) -> None:
        """Keep how far the approach moved objects."""
        pairs = zip(self.start, self._poses(), strict=True)
        self._pushed = max((float(np.linalg.norm(b.t - a.t)) for a, b in pairs), default=0.0)

    def _held(self) -> tuple[int, ...]:
        limits = TrialSettings.current()
        return tuple(i for i, low in enumerate(self._lowest()) if low > limits.held_m)

    def _ended(
        self, outcome: str, held: tuple[int, ...] = (), touched: tuple[int, ...] = ()
    ) -> Execution:
        return Execution(outcome, held, touched, self._pushed, self._poses(), tuple(self.stages))

    def _move(
        self, target: Array, speed: float, *, stops: bool = False, guarded: bool = False
    ) -> bool:
        """Move straight to a target; False if blocked and `stops` is set.

        A guarded move is also blocked by a light touch.
        """
        limits = TrialSettings.current()
        begin = self.data.ctrl[:3].copy()
        # The maximum speed of this smooth motion is 15/8 of its mean.
        seconds = 15 / 8 * float(np.linalg.norm(target - begin)) / speed
        steps = max(1, round(seconds / TIMESTEP_S / CONTROL_STEPS))
        for k in range(1, steps + 1):
            s = k / steps
            self.data.ctrl[:3] = begin + (target - begin) * s**3 * (10 - 15 * s + 6 * s**2)
            self._advance()
            if stops and (
                self._lag() > limits.lag_m or (guarded and self._pressed() > limits.touch_n)
            ):
                self.data.ctrl[:3] = self.data.qpos[self._carriage]
                return False
        self._step(50)
        return not (stops and self._lag() > limits.lag_m)

    def _back_off(self) -> None:
        """Move back along the approach, until nothing presses."""
        here = self.data.qpos[self._carriage].copy()
        self._move(here - BACK_OFF_M * self.approach, APPROACH_M_S)

    def _pressed(self) -> float:
        """Return the force, in newtons, with which contacts push against the approach."""
        total, wrench = np.zeros(3), np.zeros(6)
        for k, contact in enumerate(self.data.contact):
            owners = [self.owner[self.model.geom_bodyid[g]] for g in (contact.geom1, contact.geom2)]
            if (owners[0] == -2) == (owners[1] == -2):
                continue
            self._mujoco.mj_contactForce(self.model, self.data, k, wrench)
            # The first axis of the frame points from the first geometry to the second.
            force = contact.frame.reshape(3, 3).T @ wrench[:3]
            total += force if owners[1] == -2 else -force
        return float(-total @ self.approach)

    def _advance(self) -> None:
        """Advance the simulation by one step of control."""
        self._step(CONTROL_STEPS)

    def _wait(self, seconds: float) -> None:
        self._step(round(seconds / TIMESTEP_S))

    def _step(self, count: int) -> None:
        self._mujoco.mj_step(self.model, self.data, count)

    def _lag(self) -> float:
        return float(np.linalg.norm(self.data.ctrl[:3] - self.data.qpos[self._carriage]))

    def _poses(self) -> tuple[SE3, ...]:
        rows = self.data.qpos[: 7 * len(self.objects)].reshape(-1, 7)
        return tuple(SE3.from_quat(row[3:], row[:3]) for row in rows)

    def _keep(self, name: str) -> None:
        T = SE3(self.R, self.data.qpos[self._carriage].copy())
        self.stages.append(Stage(name, T, max(self.opening(), 0.0), self._poses()))

    def _met(self, *, deeper: float = 0.0) -> set[int]:
        """Return what the tool touches: object indices, -1 for the table."""
        return self._touched(lambda _: True, deeper)

    def _touched(self, wanted: Callable[[int], bool], deeper: float) -> set[int]:
        met: set[int] = set()
        for contact in self.data.contact:
            bodies = [int(self.model.geom_bodyid[g]) for g in (contact.geom1, contact.geom2)]
            for mine, other in (bodies, bodies[::-1]):
                is_hand = self.owner[mine] == -2 and wanted(mine)
                if is_hand and self.owner[other] != -2 and contact.dist < -deeper:
                    met.add(int(self.owner[other]))
        return met

    def _lowest(self) -> list[float]:
        """Return the height of the lowest point of every object."""
        return [
            min(float((T @ (part * o.diagonal_m))[:, 2].min()) for part in o.parts)
            for o, T in zip(self.objects, self._poses(), strict=True)
        ]
