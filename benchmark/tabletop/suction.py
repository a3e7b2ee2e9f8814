"""Execution of a grasp with a suction cup in MuJoCo: touch, seal, lift, hold.

The cup moves on along its axis until something presses on it. The seal is tested on the true
meshes where it stopped. A sealed cup is fixed to the object, and lets go once the force or the
torque between them is more than it holds.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmark.metrics.grasp.suction import SuctionCup, seal_at
from benchmark.tabletop.trial import (
    APPROACH_M_S,
    FINGER_KG,
    HAND,
    HAND_KG,
    HOLD_S,
    LIFT_M,
    LIFT_M_S,
    SOLREF,
    Array,
    Execution,
    Trial,
    add_carriage,
)
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.se3 import SE3
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# How far beyond its tip a grasp looks for the surface.
SEARCH_M = 0.02


@dataclass(frozen=True, kw_only=True)
class SuctionSettings(Settings):
    """When a suction cup lets go."""

    overloaded: int = limit(3, source=NOT_RECORDED)
    """steps of control in a row, 10 ms each, of overload"""


def add_cup(spec: Any, cup: SuctionCup, R: Array, objects: int) -> None:
    """Add a suction cup on a carriage, and a joint to each object that is not active yet.

    Args:
        spec: a `mujoco.MjSpec`.
        cup: its sizes.
        R: (3, 3) orientation: the axis and two others as columns.
        objects: number of objects.
    """
    import mujoco

    hand = add_carriage(spec, R)
    low, high = (boxes[0] for boxes in cup.boxes([0.0], [0.0]))
    lip = {"condim": 6, "friction": (cup.friction, 0.005, 0.0001), "solref": SOLREF}
    round_, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    # Cylinders have their axis along z.
    upright = [np.sqrt(0.5), 0, np.sqrt(0.5), 0]
    masses = (FINGER_KG, FINGER_KG, HAND_KG)
    for k, name in enumerate(("cup", "tube", "body")):
        middle, half = (low[k] + high[k]) / 2, (high[k] - low[k]) / 2
        if name == "body":
            hand.add_geom(name=name, type=box, pos=middle, size=half, mass=masses[k], **lip)
        else:
            size = [half[1], half[0], 0]
            hand.add_geom(
                name=name, type=round_, pos=middle, size=size, quat=upright, mass=masses[k], **lip
            )
    for i in range(objects):
        spec.add_equality(
            name=f"seal{i}", type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=HAND, name2=f"object{i}", active=False, solref=SOLREF,
        )  # fmt: skip


class SuctionTrial(Trial):
    """An attempt with a suction cup; see `benchmark.tabletop.grasp.execute`."""

    tool: SuctionCup
    _sealed: int | None = None
    _lip = np.zeros(3)
    _overload = 0

    def add_tool(self, spec: Any) -> None:
        add_cup(spec, self.tool, self.R, len(self.objects))

    def run(self) -> Execution:
        self._keep("pre-grasp")
        if start := self._hits_at_start():
            return self._ended(start)
        end = self.tip + SEARCH_M * self.approach
        touched_down = not self._move(end, APPROACH_M_S, stops=True, guarded=True)
        self._note_push()
        met = self._met()
        touched = tuple(sorted(i for i in met if i >= 0))
        if not touched_down and not touched:
            self._keep("stopped")
            return self._ended("no-contact")
        if -1 in met and not touched:
            self._keep("stopped")
            return self._ended("blocked-by-table")
        found = self._seal()
        if found is None:
            self._keep("stopped")
            return self._ended("no-seal", (), touched)
        self._fix(found)
        self._keep("sealed")
        here = self.data.qpos[self._carriage].copy()
        self._move(here + np.array([0, 0, LIFT_M]), LIFT_M_S)
        self._wait(HOLD_S)
        self._keep("lifted")
        if held := self._held():
            return self._ended("held", held, touched)
        return self._ended("slipped", (), touched)

    def _seal(self) -> int | None:
        """Return the object that the cup seals on, or None."""
        caster = RayCaster(threads=1)
        for obj, T in zip(self.objects, self._poses(), strict=True):
            caster.add(T @ (obj.asset.vertices * obj.diagonal_m), obj.asset.faces)
        at = SE3(self.R, self.data.qpos[self._carriage].copy())
        found = seal_at(caster, at, self.tool)
        return found.mesh if found.is_tight(self.tool) else None

    def _fix(self, index: int) -> None:
        """Fix the object to the cup where they are."""
        T_hand_obj = SE3(self.R, self.data.qpos[self._carriage]).inverse() @ self._poses()[index]
        k = self.model.equality(f"seal{index}").id
        self._lip = T_hand_obj.inverse().t  # the middle of the lip in the object's frame
        # Anchor in the object, the same point in the hand, and their relative orientation.
        self.model.eq_data[k][:10] = [*self._lip, 0, 0, 0, *SE3(T_hand_obj.R, np.zeros(3)).quat()]
        self.data.eq_active[k] = 1
        # Otherwise the lip would press against its own seal.
        lip = self.model.geom("cup").id
        self.model.geom_contype[lip] = self.model.geom_conaffinity[lip] = 0
        self._sealed = index

    def _step(self, count: int) -> None:
        """Advance the simulation; the cup lets go when it is overloaded."""
        if self._sealed is None:
            super()._step(count)
            return
        # Long waits are cut, so that the load is watched.
        for _ in range(0, count, 5):
            super()._step(min(5, count))
            self._overload = 0 if self.tool.holds(*self.load()) else self._overload + 1
            if self._overload >= SuctionSettings.current().overloaded:
                self.data.eq_active[self.model.equality(f"seal{self._sealed}").id] = 0
                self._sealed = None
                super()._step(count)
                return

    def load(self) -> tuple[Array, Array]:
        """Return force (N) and torque (N m) of the cup on the object, about the lip, cup's axes."""
        assert self._sealed is not None
        k, mujoco = self.model.equality(f"seal{self._sealed}").id, self._mujoco
        data = self.data
        rows = (data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)) & (data.efc_id == k)
        forces = np.where(rows, data.efc_force, 0.0)
        joints = np.zeros(self.model.nv)
        mujoco.mj_mulJacTVec(self.model, data, joints, forces)
        mine = joints[6 * self._sealed : 6 * self._sealed + 6]
        T = self._poses()[self._sealed]
        # A free joint's force is in the world's axes, its torque in those of the object.
        force, about_origin = mine[:3], T.R @ mine[3:]
        torque = about_origin + np.cross(T.t - T @ self._lip, force)
        return self.R.T @ force, self.R.T @ torque
