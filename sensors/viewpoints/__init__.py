"""Where the simulator's cameras stand: random viewpoints of a scene, and smooth ways around it."""

from sensors.viewpoints.camera_path import TrajectoryOptions, smooth_trajectory
from sensors.viewpoints.views import (
    ViewMargins,
    Viewpoint,
    ViewpointOptions,
    hidden_objects,
    look_at,
    random_viewpoints,
)

__all__ = [
    "TrajectoryOptions",
    "ViewMargins",
    "Viewpoint",
    "ViewpointOptions",
    "hidden_objects",
    "look_at",
    "random_viewpoints",
    "smooth_trajectory",
]
