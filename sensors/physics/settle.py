"""Objects dropped at random until they come to rest."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensors.physics.rigid_bodies import PhysicalObject, World, come_to_rest
from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.log import logger

# From the canonical frame, y up, to the world, z up.
UPRIGHT = so3_exp([np.pi / 2, 0, 0])
# Objects that stand start this far above the floor and apart from each other.
_GAP_M = 0.002
# Places tried for an object that stands before it is put on top of others.
_TRIALS = 50


@dataclass(frozen=True, kw_only=True)
class SettleOptions:
    """Options of the drop.

    Attributes:
        half_width_m: half the side of the square that they fall on, centred at the origin.
        spread_m: half the side of the square that their middles start above; None: all of the
            square. In a small one they fall on each other: clutter, and stacks.
        upright: the objects start upright, just above the floor and beside each other where there
            is room, so that most end standing; `tilt` is unused.
        tilt: largest initial rotation from upright about each horizontal axis, radians.
        longest_s: limit of the simulated time to come to rest, seconds per attempt.
        attempts: number of drops, each from another start, before giving up.
        deepest_m: largest overlap of collision bodies at rest that still counts as a contact.
    """

    half_width_m: float = 0.3
    spread_m: float | None = None
    upright: bool = False
    tilt: float = np.pi / 4
    longest_s: float = 6.0
    attempts: int = 8
    deepest_m: float = 0.0005

    def __post_init__(self) -> None:
        if not 0.05 <= self.half_width_m <= 5:
            raise ToolkitError(
                "must lie between 0.05 and 5", field="half_width_m", value=self.half_width_m
            )
        if self.attempts < 1:
            raise ToolkitError("must be at least 1", field="attempts", value=self.attempts)


@dataclass(frozen=True)
class Settled:
    """Objects at rest.

    Attributes:
        poses: T_world_obj of each, metres; z up, the floor at z = 0.
        attempts: number of drops used.
        simulated_s: simulated time of the last one.
    """

    poses: tuple[SE3, ...]
    attempts: int
    simulated_s: float


def settle(
    objects: Sequence[PhysicalObject], seed: int, options: SettleOptions | None = None
) -> Settled:
    """Drop objects on the floor and wait until they come to rest.

    Invisible walls confine them while they fall; no object touches one at the end. The same objects
    and seed give the same poses, bit for bit, on the same machine.

    Args:
        objects: scaled, with their convex parts.
        seed: of the starting poses; later attempts derive from it.

    Raises:
        ToolkitError: no attempt came to rest within the square, for example with too many objects.
    """
    options = options or SettleOptions()
    world = World(objects, half_width_m=options.half_width_m)
    reasons: list[str] = []
    for attempt in range(options.attempts):
        rng = np.random.default_rng([seed, attempt])
        if attempt:
            world = World(objects, half_width_m=options.half_width_m)
        start = _stand if options.upright else _start
        world.place(start(objects, rng, options))
        reason = _fall(world, options)
        if reason is None:
            return Settled(tuple(world.poses()), attempt + 1, float(world.data.time))
        logger.debug("drop %d of seed %d: %s", attempt + 1, seed, reason)
        reasons.append(reason)
    raise ToolkitError(
        f"the objects did not settle in {options.attempts} attempts (last: {reasons[-1]})",
        field="seed",
        value=seed,
        hint="fewer objects or a larger half_width_m",
    )


def _fall(world: World, options: SettleOptions) -> str | None:
    """Simulate one attempt; the reason of its failure, or None."""
    if not come_to_rest(world, options.longest_s):
        return "did not come to rest"
    if world.touches_wall():
        world.remove_walls()
        if not come_to_rest(world, options.longest_s):
            return "did not come to rest without walls"
    if world.depth() > options.deepest_m:
        return f"overlap of {1000 * world.depth():.2f} mm"
    centres = np.array([T.t for T in world.poses()])
    if np.abs(centres[:, :2]).max() > options.half_width_m or centres[:, 2].min() < 0:
        return "an object left the square"
    return None


def _start(
    objects: Sequence[PhysicalObject], rng: np.random.Generator, options: SettleOptions
) -> list[SE3]:
    """Poses above the floor, at heights where the bounding spheres do not touch."""
    poses: list[SE3] = []
    placed: list[tuple[Array, float]] = []
    for obj in objects:
        radius = obj.diagonal_m / 2
        room = max(options.half_width_m - radius, 0.0)
        if options.spread_m is not None:
            room = min(room, options.spread_m)
        x, y = rng.uniform(-room, room, 2)
        a, b = rng.uniform(-options.tilt, options.tilt, 2)
        turn = rng.uniform(-np.pi, np.pi)
        height = radius + 0.01
        for centre, other in placed:
            reach = radius + other + 0.005
            beside = float(np.hypot(centre[0] - x, centre[1] - y))
            if beside < reach:
                height = max(height, float(centre[2] + np.sqrt(reach**2 - beside**2)))
        R = so3_exp([0, 0, turn]) @ so3_exp([a, 0, 0]) @ so3_exp([0, b, 0]) @ UPRIGHT
        at = np.array([x, y, height])
        placed.append((at, radius))
        poses.append(SE3(R, at))
    return poses


def _stand(
    objects: Sequence[PhysicalObject], rng: np.random.Generator, options: SettleOptions
) -> list[SE3]:
    """Upright poses `_GAP_M` above the floor, or above the objects below them."""
    poses: list[SE3] = []
    placed: list[tuple[Array, float, float]] = []  # middle, radius around it, top
    for obj in objects:
        corners = np.concatenate(obj.parts) * obj.diagonal_m
        radius = float(np.hypot(corners[:, 0], corners[:, 2]).max())
        lowest, highest = corners[:, 1].min(), corners[:, 1].max()
        room = max(options.half_width_m - radius, 0.0)
        if options.spread_m is not None:
            room = min(room, options.spread_m)
        for _ in range(_TRIALS):
            at = rng.uniform(-room, room, 2)
            below = [
                top
                for middle, other, top in placed
                if np.hypot(*(middle - at)) < radius + other + _GAP_M
            ]
            if not below:
                break
        floor = max(below, default=0.0) + _GAP_M
        placed.append((at, radius, floor + highest - lowest))
        turn = so3_exp([0, 0, rng.uniform(-np.pi, np.pi)])
        poses.append(SE3(turn @ UPRIGHT, np.array([*at, floor - lowest])))
    return poses
