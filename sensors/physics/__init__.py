"""Objects dropped on a floor until they come to rest."""

from sensors.physics.convex import convex_parts
from sensors.physics.graspnet import GraspNetScenes
from sensors.physics.rigid_bodies import PhysicalObject, drift, settle_from
from sensors.physics.settle import Settled, SettleOptions, settle

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
