"""The antipodal planner and its settings."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.methods.grasp.antipodal import contact_pairs
from benchmark.methods.grasp.antipodal.hands import (
    Obstacles,
    filled_pads,
    hands_at,
    obstacles_of,
    unknown_share,
)
from benchmark.methods.grasp.antipodal.surface import surface_of, table_of
from benchmark.methods.protocol import GraspView
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.grasp.grasp import Grasps, suppress_similar
from benchmark.metrics.grasp.gripper import get_gripper
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.plugins import configured

Floats = NDArray[np.float64]


def check_limits(settings: object, *limits: tuple[str, float, float]) -> None:
    """Refuse a setting outside its limits.

    Args:
        settings: with a field for each limit.
        limits: name of the field, least and largest value.

    Raises:
        ToolkitError: a field outside of them, or NaN.
    """
    for name, low, high in limits:
        value = getattr(settings, name)
        if not (low <= value <= high):  # not (NaN) either
            raise ToolkitError(f"must lie between {low} and {high}", field=name, value=value)


@dataclass(frozen=True, kw_only=True)
class AntipodalSettings:
    """How grasps are looked for.

    Attributes:
        gripper: `panda` or `graspnet`.
        seed: of all that is drawn; the same view and seed give the same grasps.
        points: largest number of surface points among which contacts are looked for.
        friction: coefficient at which two contacts must hold: half the opening of their cones.
        pairs: largest number of pairs of contacts that hands are fitted to.
        grasps: largest number of grasps that are given back.
        least_height: metres above the table from which on a point belongs to an object.
        least_top: metres that an object is high, at the least.
        least_area: square metres of an object that the camera sees, at the least.
        unknown: what a grasp loses whose fingers are all where the depth has holes; 0 takes holes
            for free space.
        table_room: metres that the hand stays above the table.
        room: metres that each open finger stays away from what it is to grasp; half of it where
            there is no more.
    """

    gripper: str = "panda"
    seed: int = 0
    points: int = 2500
    friction: float = 0.5
    pairs: int = 600
    grasps: int = 50
    least_height: float = 0.006
    least_top: float = 0.01
    least_area: float = 3e-4
    unknown: float = 1.0
    table_room: float = 0.003
    room: float = 0.012

    def __post_init__(self) -> None:
        get_gripper(self.gripper)
        check_limits(
            self,
            ("points", 10, 20_000),
            ("friction", 0.05, 3.0),
            ("pairs", 1, 20_000),
            ("grasps", 1, 10_000),
            ("least_height", 0.0, 0.1),
            ("least_top", 0.0, 0.1),
            ("least_area", 0.0, 0.1),
            ("unknown", 0.0, 100.0),
            ("table_room", 0.0, 0.1),
            ("room", 0.001, 0.05),
        )

    @property
    def cone(self) -> float:
        """Cosine of the angle of friction."""
        return math.cos(math.atan(self.friction))


class Antipodal:
    """Grasps from geometry alone; nothing is learned, and no object is known.

    Pairs of seen points whose normals look away from each other within the friction cones are
    held by a hand that comes from above, where it hits neither what is seen, nor what must lie
    beneath that, nor the table. Space that the camera cannot judge, because there is no depth,
    counts against a hand.

    Args:
        options: settings as in `AntipodalSettings`.

    Raises:
        ToolkitError: a setting that it does not have or that cannot be.
    """

    settings_type = AntipodalSettings

    def __init__(self, options: MethodOptions | None = None) -> None:
        given = (options or MethodOptions()).settings
        self.settings = configured(AntipodalSettings(), given)
        self.gripper = get_gripper(self.settings.gripper)

    def plan(self, view: GraspView) -> Grasps:
        rng = np.random.default_rng(self.settings.seed)
        T_cam_table = table_of(view, rng)
        grasps = self._plan_on_table(view, T_cam_table, rng)
        return grasps.transformed(T_cam_table)

    def _plan_on_table(self, view: GraspView, T_cam_table: SE3, rng: np.random.Generator) -> Grasps:
        s = self.settings
        surface = surface_of(
            view,
            T_cam_table,
            least_height=s.least_height,
            least_top=s.least_top,
            least_area=s.least_area,
            count=s.points,
            rng=rng,
        )
        points, normals = surface.points, surface.normals
        places, faces, trust = contact_pairs.with_edges(
            points, normals, surface.outwards, surface.at_edge
        )
        widest = self.gripper.max_width
        pairs = contact_pairs.Pairs.concatenated(
            [
                contact_pairs.antipodal_pairs(
                    places, faces, widest=widest, cone=s.cone, trust=trust
                ),
                contact_pairs.round_pairs(points, normals, widest=widest),
                contact_pairs.rim_pairs(points, normals, surface.at_edge, surface.eye),
            ]
        )
        if not len(pairs):
            return Grasps.empty()
        obstacles = obstacles_of(surface.obstacles)
        worth = _worth(pairs, obstacles)
        pairs = contact_pairs.best_spread(pairs, s.pairs, worth)
        grasps, of_pair = hands_at(
            pairs, obstacles, self.gripper, surface.eye, room=s.room, table_room=s.table_room
        )
        score = (
            _worth(pairs[of_pair], obstacles)
            - 0.5 * (1 + grasps.approaches[:, 2])
            + 2 * filled_pads(grasps, obstacles, self.gripper)
        )
        if s.unknown:
            seen = grasps.transformed(T_cam_table)
            score -= s.unknown * unknown_share(seen, self.gripper, view.depth, view.camera)
        kept = suppress_similar(grasps.replaced(scores=score), swapped_fingers=True)
        return kept.top(s.grasps)


def _worth(pairs: contact_pairs.Pairs, obstacles: Obstacles) -> Floats:
    """(K,) how good pairs are before hands are fitted: square to the surface, level, central."""
    if not len(pairs):
        return np.zeros(0)
    slope = np.abs(pairs.closings[:, 2])
    return pairs.quality - 2 * slope - 6 * off_middle(pairs.middles, obstacles)


def off_middle(points: Floats, obstacles: Obstacles) -> Floats:
    """(K,) how far points lie from the middle of their object, seen from above, metres."""
    from scipy.spatial import cKDTree

    nearest = cKDTree(obstacles.visible).query(points)[1]
    return np.linalg.norm(points[:, :2] - obstacles.middles[obstacles.object_of[nearest]], axis=1)
