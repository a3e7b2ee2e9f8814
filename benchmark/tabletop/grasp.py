"""Execution of a grasp in MuJoCo: approach, closing, lift, hold.

The parallel-jaw gripper consists of the boxes of a `Gripper`. Servos of limited force move it along
the three world axes with fixed orientation, as an arm with a stiff wrist in a straight move. A
guarded move stops where it feels a contact, backs off, and closes there. A straight move pushes
obstacles until the force limit is reached, which ends the attempt. The fingers are coupled, as in
the Panda gripper, and close with limited force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import PANDA, Gripper
from sensors.physics.rigid_bodies import TIMESTEP_S, PhysicalObject, objects_on_floor
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3

CARRIAGE, HAND = "carriage", "hand"

FINGERS = ("finger-", "finger+")

AXES = ("along-x", "along-y", "along-z")

# The Panda's hand weighs 0.73 kg, of which each finger has 0.015 (its maker's description).
HAND_KG, FINGER_KG = 0.7, 0.015

# The Panda's hand grips with up to 70 N continuously; rubber pads on glass and metal.
GRIP_N = 40.0

PAD_FRICTION = (0.8, 0.005, 0.0001)

# An arm with a collision reflex stops at about this.
PUSH_N = 40.0

# A guarded move stops at this force of contact, and backs off by this way.
TOUCH_N, BACK_OFF_M = 8.0, 0.006

# Servo of the carriage: N/m and N s/m, critically damped for hand and armature together.
_STIFFNESS, _ARMATURE_KG = 20_000.0, 0.5

_DAMPING = 2 * np.sqrt(_STIFFNESS * (HAND_KG + 2 * FINGER_KG + _ARMATURE_KG))

# Servo of a finger; against the damping alone it closes at 0.2 m/s.
_FINGER_STIFFNESS, _FINGER_ARMATURE_KG = 10_000.0, 0.05

_FINGER_DAMPING = GRIP_N / 0.2

# Target beyond the closed position, so that a finger presses with its full force.
CLOSED = -0.01

_SOLREF = (0.004, 1.0)

Array = NDArray[np.float64]

# Distance of the fingertips from the pre-grasp to the grasp, and height of the lift.
APPROACH_M, LIFT_M = 0.10, 0.25

_APPROACH_M_S, _LIFT_M_S = 0.12, 0.25

_CLOSE_S, _HOLD_S = 0.6, 1.0

# A carriage with this lag is blocked by an obstacle.
_LAG_M = 0.004

# Smallest overlap of the gripper in the pre-grasp that counts as contact.
_TOUCH_M = 0.001

# Fingers closer than this hold no object.
_SHUT_M = 0.0015

# An object counts as held if all of it is at least this high above the table.
HELD_M = 0.10

_CONTROL_STEPS = 5


def add_hand(spec: Any, gripper: Gripper, R: Array) -> None:
    """Add a gripper to a model specification.

    Its origin is the translation of a grasp of depth 0 (fingertips at x = 0). Its joints are the
    three of the carriage, metres in the world, then the distance of each finger from the centre.

    Args:
        spec: a `mujoco.MjSpec`.
        gripper: sizes of the gripper.
        R: (3, 3) orientation: approach, closing direction and height of the fingers as columns.
    """
    import mujoco

    box, slide = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtJoint.mjJNT_SLIDE
    pads = {"condim": 6, "friction": PAD_FRICTION, "solref": _SOLREF}
    carriage = spec.worldbody.add_body(name=CARRIAGE, gravcomp=1.0)
    for name, axis in zip(AXES, np.eye(3), strict=True):
        carriage.add_joint(
            name=name, type=slide, axis=axis, damping=_DAMPING, armature=_ARMATURE_KG
        )
        _servo(spec, name, _STIFFNESS, PUSH_N)
    quat = SE3(np.asarray(R, dtype=np.float64), np.zeros(3)).quat()
    hand = carriage.add_body(name=HAND, quat=quat, gravcomp=1.0)
    low, high = (boxes[0] for boxes in gripper.boxes([0.0], [0.0]))
    hand.add_geom(
        name="palm", type=box, pos=(low[-1] + high[-1]) / 2, size=(high[-1] - low[-1]) / 2,
        mass=HAND_KG, **pads,
    )  # fmt: skip
    # The boxes of a closed gripper: finger at -y, finger at +y for each section, the palm last.
    volumes = np.prod(high - low, axis=1)
    for side, (name, sign) in enumerate(zip(FINGERS, (-1.0, 1.0), strict=True)):
        finger = hand.add_body(name=name, gravcomp=1.0)
        finger.add_joint(
            name=name, type=slide, axis=[0, sign, 0], limited=True,
            range=[0, gripper.max_width / 2 + 1e-4], solref_limit=_SOLREF,
            damping=_FINGER_DAMPING, armature=_FINGER_ARMATURE_KG,
        )  # fmt: skip
        _servo(spec, name, _FINGER_STIFFNESS, GRIP_N)
        mine = range(side, 2 * len(gripper.finger_sections), 2)
        whole = sum(float(volumes[k]) for k in mine)
        for k in mine:
            finger.add_geom(
                name=f"{name}{k // 2}", type=box,
                pos=(low[k] + high[k]) / 2, size=(high[k] - low[k]) / 2,
                mass=FINGER_KG * float(volumes[k]) / whole, **pads,
            )  # fmt: skip
    coupled = spec.add_equality(
        name="coupled", type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=FINGERS[0], name2=FINGERS[1], solref=_SOLREF,
    )  # fmt: skip
    # The first finger's place is this polynomial of the second's; how long it is differs between
    # versions of MuJoCo.
    coupled.data = np.eye(1, len(coupled.data), 1)[0]
    spec.add_exclude(bodyname1=FINGERS[0], bodyname2=FINGERS[1])


def _servo(spec: Any, joint: str, stiffness: float, force: float) -> None:
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
        name: `pre-grasp`, `stopped`, `closed` or `lifted`.
        T_world_hand: pose of the gripper, in the convention of `Grasps` with depth 0.
        opening: distance between the fingers, metres.
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
            `blocked-by-table`, `blocked-by-object`, `nothing-between`, `slipped`. A guarded move
            that was stopped and holds nothing in the end is blocked.
        held: indices of the objects in the gripper after holding.
        touched: indices of the objects that the closed fingers touched before the lift.
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


def execute(
    objects: Sequence[PhysicalObject],
    poses: Sequence[SE3],
    grasp: Grasps,
    *,
    masses_kg: Sequence[float] | None = None,
    gripper: Gripper = PANDA,
    guarded: bool = True,
) -> Execution:
    """Execute a grasp. The same input gives the same outcome, bit for bit.

    Args:
        objects: objects on the table, whose plane is z = 0.
        poses: T_world_obj, at rest.
        grasp: one grasp, in the world frame.
        masses_kg: masses of the objects; equal by default.
        gripper: the gripper.
        guarded: stop at a contact, back off and close, instead of giving up.

    Raises:
        ToolkitError: not exactly one grasp, or MuJoCo is not installed.
    """
    if len(grasp) != 1:
        raise ToolkitError("takes one grasp at a time", value=len(grasp))
    return _Attempt(objects, poses, grasp, masses_kg, gripper, guarded).run()


class _Attempt:
    def __init__(
        self,
        objects: Sequence[PhysicalObject],
        poses: Sequence[SE3],
        grasp: Grasps,
        masses_kg: Sequence[float] | None,
        gripper: Gripper,
        guarded: bool = True,
    ) -> None:
        import mujoco

        self._mujoco, self._guarded = mujoco, guarded
        self.objects, self.start = tuple(objects), tuple(poses)
        self.R, self.approach = grasp.rotations[0], grasp.approaches[0]
        self.tip = grasp.tips[0]
        width = float(np.clip(grasp.widths[0], 2 * _SHUT_M, gripper.max_width))
        spec = objects_on_floor(self.objects, masses_kg=masses_kg)
        # Flat pads on flat sides need several contact points, which is the default since MuJoCo 4.
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
        """Number each body: -1 the table, -2 the gripper, otherwise the index of the object."""
        self.owner = np.full(self.model.nbody, -2)
        self.owner[0] = -1
        for i in range(len(self.objects)):
            self.owner[self.model.body(f"object{i}").id] = i
        if [self.model.actuator(k).name for k in range(self.model.nu)] != [*AXES, *FINGERS]:
            raise AssertionError("the servos are not in the order that their targets are")

    def run(self) -> Execution:
        self._keep("pre-grasp")
        start = self._met(deeper=_TOUCH_M)
        if start:
            return self._ended("start-hits-table" if -1 in start else "start-hits-object")
        blocked = ""
        if not self._move(self.tip, _APPROACH_M_S, stops=True):
            blocked = "blocked-by-table" if -1 in self._met() else "blocked-by-object"
            if not self._guarded:
                self._keep("stopped")
                return self._ended(blocked)
            self._back_off()
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
        return self._ended(blocked or ("nothing-between" if nothing else "slipped"), (), touched)

    def _ended(
        self, outcome: str, held: tuple[int, ...] = (), touched: tuple[int, ...] = ()
    ) -> Execution:
        return Execution(
            outcome, held, touched, getattr(self, "pushed", 0.0), self._poses(), tuple(self.stages)
        )

    def _move(self, target: Array, speed: float, *, stops: bool = False) -> bool:
        """Move straight to a target; False if blocked and `stops` is set."""
        begin = self.data.ctrl[:3].copy()
        # The maximum speed of this smooth motion is 15/8 of its mean.
        seconds = 15 / 8 * float(np.linalg.norm(target - begin)) / speed
        steps = max(1, round(seconds / TIMESTEP_S / _CONTROL_STEPS))
        for k in range(1, steps + 1):
            s = k / steps
            self.data.ctrl[:3] = begin + (target - begin) * s**3 * (10 - 15 * s + 6 * s**2)
            self._step(_CONTROL_STEPS)
            if stops and (self._lag() > _LAG_M or (self._guarded and self._pressed() > TOUCH_N)):
                self.data.ctrl[:3] = self.data.qpos[self._carriage]
                return False
        self._step(50)
        return not (stops and self._lag() > _LAG_M)

    def _back_off(self) -> None:
        """Move back along the approach, until nothing presses."""
        here = self.data.qpos[self._carriage].copy()
        self._move(here - BACK_OFF_M * self.approach, _APPROACH_M_S)

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
        """Return what the gripper touches: object indices, -1 for the table."""
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
        """Return the height of the lowest point of every object."""
        return [
            min(float((T @ (part * o.diagonal_m))[:, 2].min()) for part in o.parts)
            for o, T in zip(self.objects, self._poses(), strict=True)
        ]
