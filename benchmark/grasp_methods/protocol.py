"""What a grasp planner is to the benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.grasping.grasp import Grasps
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera


@dataclass(frozen=True)
class GraspView:
    """What a planner may see; the maps have the camera's size.

    Attributes:
        color: (h, w, 3) uint8 RGB.
        depth: (h, w) float32 metres, z-depth, 0 nothing known: measured, restored or true.
        camera: intrinsics at this size.
        mask: (h, w) bool pixels that belong to objects; None where nobody knows: a planner may
            then look at everything above the table.
        T_cam_table: (4, 4) pose of the table, whose plane is z = 0 and whose z points up; None
            where it is unknown.

    Raises:
        ToolkitError: maps of another size than the camera's, or a pose of another shape.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    camera: Camera
    mask: NDArray[np.bool_] | None = None
    T_cam_table: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        shapes = {"color": (*size, 3), "depth": size, "mask": size, "T_cam_table": (4, 4)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                raise ToolkitError(f"must have the shape {shape}", field=name, value=array.shape)


class GraspPlanner(Protocol):
    """A method that finds grasps."""

    def plan(self, view: GraspView) -> Grasps:
        """Grasps of what is seen, in the camera's frame, best first; none where it finds none.

        The same view gives the same grasps.
        """
        ...
