"""Execution of a grasp in MuJoCo: approach, closing, lift, hold.

The parallel-jaw gripper consists of the boxes of a `Gripper`. A guarded move stops where it feels
a contact, backs off, and closes there. A straight move pushes obstacles until the force limit is
reached, which ends the attempt. The fingers are coupled, as in the Panda gripper, and close with
limited force.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import PANDA, Gripper
from benchmark.metrics.grasp.suction import SuctionCup
from benchmark.tabletop.suction import SuctionTrial
from benchmark.tabletop.trial import (
    APPROACH_M_S,
    AXES,
    FINGER_KG,
    HAND_KG,
    HOLD_S,
    LIFT_M,
    LIFT_M_S,
    PAD_FRICTION,
    SOLREF,
    Execution,
    Trial,
    add_carriage,
    add_servo,
)
from sensors.physics import PhysicalObject
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.settings import NOT_RECORDED, Settings, limit

FINGERS = ("finger-", "finger+")

# The Panda's hand grips with up to 70 N continuously.
GRIP_N = 40.0

# Servo of a finger; against the damping alone it closes at 0.2 m/s.
_FINGER_STIFFNESS, _FINGER_ARMATURE_KG = 10_000.0, 0.05

_FINGER_DAMPING = GRIP_N / 0.2

# Target beyond the closed position, so that a finger presses with its full force.
CLOSED = -0.01

Array = NDArray[np.float64]

_CLOSE_S = 0.6


@dataclass(frozen=True, kw_only=True)
class JawSettings(Settings):
    """When a jaw holds an object."""

    shut_m: float = limit(0.0015, unit="m", source=NOT_RECORDED)
    """fingers closer than this hold no object"""


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
    pads = {"condim": 6, "friction": PAD_FRICTION, "solref": SOLREF}
    hand = add_carriage(spec, R)
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
            range=[0, gripper.max_width / 2 + 1e-4], solref_limit=SOLREF,
            damping=_FINGER_DAMPING, armature=_FINGER_ARMATURE_KG,
        )  # fmt: skip
        add_servo(spec, name, _FINGER_STIFFNESS, GRIP_N)
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
        name1=FINGERS[0], name2=FINGERS[1], solref=SOLREF,
    )  # fmt: skip
    # The first finger's place is this polynomial of the second's; how long it is differs between
    # versions of MuJoCo.
    coupled.data = np.eye(1, len(coupled.data), 1)[0]
    spec.add_exclude(bodyname1=FINGERS[0], bodyname2=FINGERS[1])


def execute(
    objects: Sequence[PhysicalObject],
    poses: Sequence[SE3],
    grasp: Grasps,
    *,
    masses_kg: Sequence[float] | None = None,
    gripper: Gripper | SuctionCup = PANDA,
    guarded: bool = True,
) -> Execution:
    """Execute a grasp. The same input gives the same outcome, bit for bit.

    Args:
        objects: objects on the table, whose plane is z = 0.
        poses: T_world_obj, at rest.
        grasp: one grasp, in the world frame.
        masses_kg: masses of the objects; equal by default.
        gripper: the gripper.
        guarded: a jaw stops at a contact, backs off and closes, instead of giving up.

    Raises:
        ToolkitError: not exactly one grasp, or MuJoCo is not installed.
    """
    if len(grasp) != 1:
        raise ToolkitError("takes one grasp at a time", value=len(grasp))
    if isinstance(gripper, SuctionCup):
        return SuctionTrial(objects, poses, grasp, masses_kg, gripper).run()
    return JawTrial(objects, poses, grasp, masses_kg, gripper, guarded).run()


class JawTrial(Trial):
    """An attempt with a parallel jaw; see `execute`."""

    servos = (*AXES, *FINGERS)
    tool: Gripper

    def add_tool(self, spec: Any) -> None:
        add_hand(spec, self.tool, self.R)

    def open_tool(self, place: int) -> None:
        shut = JawSettings.current().shut_m
        width = float(np.clip(self.grasp.widths[0], 2 * shut, self.tool.max_width))
        self._fingers = slice(place, place + 2)
        self.data.qpos[self._fingers] = width / 2
        self.data.ctrl[3:] = width / 2

    def run(self) -> Execution:
        self._keep("pre-grasp")
        if start := self._hits_at_start():
            return self._ended(start)
        blocked = ""
        if not self._move(self.tip, APPROACH_M_S, stops=True, guarded=self.guarded):
            blocked = self._blocked()
            if not self.guarded:
                self._keep("stopped")
                return self._ended(blocked)
            self._back_off()
        self._note_push()
        self._close()
        self._keep("closed")
        touched = tuple(sorted(i for i in self._touched_by_fingers() if i >= 0))
        nothing = self.opening() < 2 * JawSettings.current().shut_m or not touched
        self._move(self.tip + np.array([0, 0, LIFT_M]), LIFT_M_S)
        self._wait(HOLD_S)
        self._keep("lifted")
        if held := self._held():
            return self._ended("held", held, touched)
        return self._ended(blocked or ("nothing-between" if nothing else "slipped"), (), touched)

    def opening(self) -> float:
        return float(self.data.qpos[self._fingers].sum())

    def _close(self) -> None:
        self.data.ctrl[3:] = CLOSED
        self._wait(_CLOSE_S)

    def _touched_by_fingers(self) -> set[int]:
        ids = {self.model.body(name).id for name in FINGERS}
        return self._touched(lambda body: body in ids, 0.0)
