"""Sizes of the network, and how its grasps are chosen."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, kw_only=True)
class GraspNetConfig:
    """GraspNet (Fang et al., CVPR 2020); the defaults are the published network.

    Attributes:
        points: of the cloud that the network sees; a larger cloud is thinned out, of a smaller one
            points are repeated.
        level_points: points of the backbone's four levels; those of the second are the seeds.
        level_radii: metres, of the balls around them.
        level_neighbours: points of a ball, at most.
        width: channels of the backbone: of its first level half as many, of its features and of
            those of the cylinders twice as many.
        views: approach directions.
        angles: turns about the approach direction, over half a turn.
        depths: metres that the fingers reach beyond the seed; cylinders end there.
        cylinder_radius, cylinder_behind: metres; cylinders begin so far before the seed.
        cylinder_points: points of a cylinder, at most.
        max_width: metres, the widest grasp.
        max_tolerance: metres, the largest tolerance.
        width_margin: how much wider than predicted the fingers open.
        voxel: metres; the cloud that the network sees has at most one point per such cube, 0 for
            all points.
        margin: metres around the objects that are looked at too.
        lowest, highest: metres above the table that are looked at, where it is known.
        standing: metres above the table from which on something is an object, where no mask tells.
        gripper: the one that is to grasp: its opening and size, not the network's.
        collision: whether grasps are left out that would touch the cloud.
        collision_voxel: metres, side of the cubes that the cloud is thinned to for that.
        collision_share: of the gripper's volume that may be taken.
        nms_distance, nms_angle: metres and degrees; of two grasps nearer than both the better one
            is kept.
        most: grasps that are kept.

    Raises:
        ToolkitError: a number that makes no sense.
    """

    points: int = 20_000
    level_points: tuple[int, int, int, int] = (2048, 1024, 512, 256)
    level_radii: tuple[float, float, float, float] = (0.04, 0.1, 0.2, 0.3)
    level_neighbours: tuple[int, int, int, int] = (64, 32, 16, 16)
    width: int = 128
    views: int = 300
    angles: int = 12
    depths: tuple[float, ...] = (0.01, 0.02, 0.03, 0.04)
    cylinder_radius: float = 0.05
    cylinder_behind: float = 0.02
    cylinder_points: int = 64
    max_width: float = 0.1
    max_tolerance: float = 0.05
    width_margin: float = 1.2
    voxel: float = 0.0
    margin: float = 0.1
    lowest: float = -0.02
    highest: float = 0.4
    standing: float = 0.01
    gripper: Literal["panda", "graspnet"] = "panda"
    collision: bool = True
    collision_voxel: float = 0.01
    collision_share: float = 0.01
    nms_distance: float = 0.03
    nms_angle: float = 30.0
    most: int = 50

    def __post_init__(self) -> None:
        for name in ("points", "width", "views", "angles", "cylinder_points", "most"):
            if getattr(self, name) < 1:
                raise ToolkitError("must be at least 1", field=name, value=getattr(self, name))
        sizes = (self.points, *self.level_points)
        if any(later > earlier for earlier, later in pairwise(sizes)):
            raise ToolkitError(
                "a level cannot have more points than the one before it, nor the first more than "
                f"the cloud, {self.points}",
                field="level_points",
                value=self.level_points,
            )
        if not self.depths or min(self.depths) <= -self.cylinder_behind:
            raise ToolkitError("must end beyond the cylinder", field="depths", value=self.depths)


PRESETS = {
    "published": GraspNetConfig(),
    "compact": GraspNetConfig(
        points=6000,
        level_points=(1024, 384, 128, 64),
        level_neighbours=(32, 32, 16, 16),
        width=48,
        cylinder_points=32,
    ),
}
