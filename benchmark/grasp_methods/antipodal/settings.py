"""Settings of the antipodal planner."""

from __future__ import annotations

import math
from dataclasses import dataclass

from benchmark.grasping.gripper import GRIPPERS
from std_toolkit.errors import ToolkitError


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
    table_room: float = 0.003
    room: float = 0.012

    def __post_init__(self) -> None:
        if self.gripper not in GRIPPERS:
            raise ToolkitError(
                "no such gripper",
                field="gripper",
                value=self.gripper,
                hint=f"known: {', '.join(GRIPPERS)}",
            )
        for name, low, high in (
            ("points", 10, 20_000),
            ("friction", 0.05, 3.0),
            ("pairs", 1, 20_000),
            ("grasps", 1, 10_000),
            ("least_height", 0.0, 0.1),
            ("table_room", 0.0, 0.1),
            ("room", 0.001, 0.05),
        ):
            value = getattr(self, name)
            if not (low <= value <= high):  # not (NaN) either
                raise ToolkitError(f"must lie between {low} and {high}", field=name, value=value)

    @property
    def cone(self) -> float:
        """Cosine of the angle of friction."""
        return math.cos(math.atan(self.friction))
