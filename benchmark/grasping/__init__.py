"""Grasps of a parallel jaw: what they are, whether they hit something, and whether they hold."""

from benchmark.grasping.grasp import Grasps
from benchmark.grasping.gripper import GRASPNET, PANDA, Gripper

__all__ = ["GRASPNET", "PANDA", "Grasps", "Gripper"]
