"""A parallel-jaw hand in MuJoCo, made of the boxes of a `Gripper`.

The hand is carried along the world's three axes by servos of limited force and keeps its
orientation, as an arm with a stiff wrist does in a straight move: what it runs into is pushed until
the servos' force is reached, and then stops it. The fingers are coupled, as those of the Panda are,
and close with a limited force.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.grasping.gripper import Gripper
from std_toolkit.geometry.se3 import SE3

Array = NDArray[np.float64]

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
# Servo of the carriage: N/m and N s/m, critically damped for hand and armature together.
_STIFFNESS, _ARMATURE_KG = 20_000.0, 0.5
_DAMPING = 2 * np.sqrt(_STIFFNESS * (HAND_KG + 2 * FINGER_KG + _ARMATURE_KG))
# Servo of a finger; against the damping alone it closes at 0.2 m/s.
_FINGER_STIFFNESS, _FINGER_ARMATURE_KG = 10_000.0, 0.05
_FINGER_DAMPING = GRIP_N / 0.2
# Told to close so far beyond shut, a finger presses with all of its force on what is between.
CLOSED = -0.01
_SOLREF = (0.004, 1.0)


def add_hand(spec: Any, gripper: Gripper, R: Array) -> None:
    """Add a hand to a world under construction.

    Its origin is the translation of a grasp of depth 0 (fingertips at x = 0); its joints are the
    three of the carriage, metres in the world, then the distance of each finger from the middle.

    Args:
        spec: a `mujoco.MjSpec`.
        gripper: its sizes.
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
    # The boxes of a shut gripper: finger at -y, finger at +y for each section, the palm last.
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
