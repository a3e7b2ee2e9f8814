"""Objects dropped on a floor until they lie still."""

from sensors.physics.graspnet import GraspNetScenes
from sensors.physics.parts import convex_parts
from sensors.physics.settle import Settled, SettleOptions, settle
from sensors.physics.world import PhysicalObject, drift, settle_from

__all__ = [
    "GraspNetScenes",
    "PhysicalObject",
    "SettleOptions",
    "Settled",
    "convex_parts",
    "drift",
    "settle",
    "settle_from",
]
