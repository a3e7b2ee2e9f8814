"""Rigid bodies on a floor, in MuJoCo: settings that let them come to rest without overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sensors.assets.asset import Asset
from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, rotation_angle

if TYPE_CHECKING:
    import mujoco

TIMESTEP_S = 0.002
# Sliding, torsional and rolling friction. Without rolling friction, bottles never stop rolling.
_FRICTION = (0.7, 0.005, 0.003)
_SOLREF = (0.004, 1.0)
# Equal masses: stacks of unequal masses converge slowly.
_MASS_KG = 0.3
_WALL = "wall"


@dataclass(frozen=True, eq=False)
class PhysicalObject:
    """An asset at a size, with the convex parts used for collision.

    Attributes:
        asset: canonical shape.
        diagonal_m: bounding-box diagonal, metres.
        parts: corners of the convex parts, canonical (`convex_parts`).
    """

    asset: Asset
    diagonal_m: float
    parts: tuple[Array, ...]

    def __post_init__(self) -> None:
        if not 0.003 <= self.diagonal_m <= 3:
            raise ToolkitError(
                "an object on a table is 3 mm to 3 m large",
                field="diagonal_m",
                value=self.diagonal_m,
            )
        if not self.parts:
            raise ToolkitError("an object needs a convex part", value=self.asset.id)


class World:
    """A floor at z = 0, objects, and four walls that confine them.

    Args:
        objects: at least one.
        half_width_m: distance of the walls from the origin along x and y; None for no walls.

    Raises:
        ToolkitError: MuJoCo is not installed or refuses a part.
    """

    def __init__(
        self, objects: Sequence[PhysicalObject], *, half_width_m: float | None = None
    ) -> None:
        if not objects:
            raise ToolkitError("there are no objects to simulate")
        self.objects = tuple(objects)
        mujoco = _mujoco()
        self._mujoco = mujoco
        self.model = self._compiled(half_width_m)
        self.data: Any = mujoco.MjData(self.model)
        self._radius = np.array([o.diagonal_m / 2 for o in self.objects])

    def _compiled(self, half_width_m: float | None) -> mujoco.MjModel:
        spec = objects_on_floor(self.objects, half_width_m=half_width_m)
        try:
            return spec.compile()
        except ValueError as error:
            raise ToolkitError(f"MuJoCo cannot simulate these objects: {error}") from error

    def place(self, poses: Sequence[SE3]) -> None:
        """Put all objects at poses T_world_obj, at rest."""
        self._mujoco.mj_resetData(self.model, self.data)
        for i, T in enumerate(poses):
            self.data.qpos[7 * i : 7 * i + 3] = T.t
            self.data.qpos[7 * i + 3 : 7 * i + 7] = T.quat()
        self._mujoco.mj_forward(self.model, self.data)

    def poses(self) -> list[SE3]:
        """T_world_obj of all objects: z up, metres, object frames centred and y up."""
        rows = self.data.qpos.reshape(-1, 7)
        return [SE3.from_quat(row[3:], row[:3]) for row in rows]

    def run(self, seconds: float) -> None:
        """Advance the simulation by this time."""
        self._mujoco.mj_step(self.model, self.data, round(seconds / TIMESTEP_S))

    def push_apart(self) -> None:
        """Resolve overlaps slowly; otherwise they would throw the objects apart."""
        for _ in range(100):
            self.run(2 * TIMESTEP_S)
            self.data.qvel[:] = 0

    def speed(self) -> float:
        """Upper bound of the speed of any point of any object, m/s."""
        v = self.data.qvel.reshape(-1, 6)
        spin = np.linalg.norm(v[:, 3:], axis=1) * self._radius
        return float((np.linalg.norm(v[:, :3], axis=1) + spin).max())

    def is_finite(self) -> bool:
        """Whether the simulation is still finite (MuJoCo resets a diverged state)."""
        warned = sum(int(w.number) for w in self.data.warning)
        return bool(np.isfinite(self.data.qpos).all()) and warned == 0

    def touches_wall(self) -> bool:
        """Whether an object touches a wall."""
        walls = self._walls()
        return any(c.geom1 in walls or c.geom2 in walls for c in self.data.contact)

    def remove_walls(self) -> None:
        """Disable the collisions with the walls."""
        for k in self._walls():
            self.model.geom_contype[k] = self.model.geom_conaffinity[k] = 0

    def depth(self) -> float:
        """Deepest overlap of the collision bodies with each other or the floor, metres."""
        return max([0.0, *(-float(c.dist) for c in self.data.contact)])

    def _walls(self) -> set[int]:
        names = (self.model.geom(k).name for k in range(self.model.ngeom))
        return {k for k, name in enumerate(names) if name.startswith(_WALL)}


def objects_on_floor(
    objects: Sequence[PhysicalObject],
    *,
    half_width_m: float | None = None,
    masses_kg: Sequence[float] | None = None,
) -> mujoco.MjSpec:
    """A floor at z = 0 and free bodies `object0`, `object1`, ..., to which more can be added.

    Args:
        objects: with their parts, which become their geometries in the order given.
        half_width_m: distance of the walls from the origin along x and y; None for no walls.
        masses_kg: of the objects; None makes all equal.

    Raises:
        ToolkitError: MuJoCo is not installed.
    """
    mujoco = _mujoco()
    masses = [_MASS_KG] * len(objects) if masses_kg is None else masses_kg
    spec = mujoco.MjSpec()
    spec.option.timestep = TIMESTEP_S
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # With soft contacts, leaning objects creep indefinitely; these two options prevent it.
    spec.option.impratio = 10.0
    spec.option.noslip_iterations = 3
    spec.memory = 2**28
    contact = {"condim": 6, "friction": _FRICTION, "solref": _SOLREF}
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name="floor", type=plane, size=[0, 0, 1], **contact)
    if half_width_m is not None:
        for k, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
            spec.worldbody.add_geom(
                name=f"{_WALL}{k}",
                type=plane,
                size=[0, 0, 1],
                pos=[-half_width_m * x, -half_width_m * y, 0],
                # A plane's normal is its z axis.
                quat=[np.sqrt(0.5), -y * np.sqrt(0.5), x * np.sqrt(0.5), 0],
                **contact,
            )
    for i, (obj, mass) in enumerate(zip(objects, masses, strict=True)):
        body = spec.worldbody.add_body(name=f"object{i}")
        body.add_freejoint()
        volumes = np.array([_volume(p) for p in obj.parts])
        for k, part in enumerate(obj.parts):
            mesh = spec.add_mesh(name=f"{i}-{k}", uservert=(part * obj.diagonal_m).ravel().tolist())
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=f"{i}-{k}",
                mass=float(mass * volumes[k] / volumes.sum()),
                **contact,
            )
    return spec


def motion(before: Sequence[SE3], after: Sequence[SE3], radius: Sequence[float]) -> float:
    """Upper bound of the displacement of any point between two sets of poses, metres."""
    return max(
        float(np.linalg.norm(b.t - a.t)) + r * rotation_angle(a.R.T @ b.R)
        for a, b, r in zip(before, after, radius, strict=True)
    )


def drift(objects: Sequence[PhysicalObject], poses: Sequence[SE3], seconds: float = 0.5) -> float:
    """Displacement of objects released at rest at these poses, without walls, metres."""
    world = World(objects)
    world.place(poses)
    world.run(seconds)
    return motion(poses, world.poses(), [o.diagonal_m / 2 for o in objects])


def settle_from(
    objects: Sequence[PhysicalObject], poses: Sequence[SE3], *, longest_s: float = 3.0
) -> list[SE3]:
    """Poses near the given ones at which the objects are at rest, e.g. of a measured arrangement.

    Args:
        objects: with their parts.
        poses: T_world_obj, z up, the floor at z = 0; small overlaps are pushed apart.
        longest_s: limit of the simulated time.

    Raises:
        ToolkitError: they do not come to rest in that time.
    """
    world = World(objects)
    world.place(poses)
    world.push_apart()
    if not come_to_rest(world, longest_s):
        raise ToolkitError(f"the objects did not come to rest in {longest_s:g} s of simulated time")
    return world.poses()


# At rest: no point is faster than this, and none moves further than this in half a second.
_REST_SPEED, _REST_DRIFT_M, _REST_S = 0.01, 0.0005, 0.5


def come_to_rest(world: World, longest_s: float) -> bool:
    """Simulate until no object moves for half a second; False if the time limit is reached."""
    radius = [o.diagonal_m / 2 for o in world.objects]
    passed = 0.0
    while passed < longest_s:
        world.run(0.1)
        passed += 0.1
        if not world.is_finite():
            return False
        if world.speed() > _REST_SPEED:
            continue
        before = world.poses()
        world.run(_REST_S)
        passed += _REST_S
        if world.is_finite() and motion(before, world.poses(), radius) < _REST_DRIFT_M:
            return True
    return False


def _volume(corners: Array) -> float:
    from scipy.spatial import ConvexHull

    return float(ConvexHull(corners).volume)


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError as error:
        raise ToolkitError(
            "MuJoCo is not installed", hint="pip install 'std-toolkit[sim]'"
        ) from error
    return mujoco
