"""Where the simulator's cameras stand: random viewpoints of a scene, and smooth ways around it."""

from sensors.viewpoints.in_view import ViewMargins, hidden_objects
from sensors.viewpoints.look_at import look_at
from sensors.viewpoints.random_views import Viewpoint, ViewpointOptions, random_viewpoints
from sensors.viewpoints.trajectory import TrajectoryOptions, smooth_trajectory

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
