"""Grasps of a parallel jaw: what they are, whether they hit something, and whether they hold."""

from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import GRASPNET, PANDA, Gripper

__all__ = ["GRASPNET", "PANDA", "Grasps", "Gripper"]
