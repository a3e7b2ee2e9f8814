"""PointNet++ (Qi et al., NeurIPS 2017) in plain torch: networks on sets of points.

Everywhere points are (b, n, 3), features (b, c, n) as convolutions want them, and indices (b, ...)
count the points of one set.
"""

from benchmark.pointnet.abstraction import Abstracted, Scale, SetAbstraction
from benchmark.pointnet.grouping import at, ball_query, group, nearest
from benchmark.pointnet.propagation import FeaturePropagation, interpolated
from benchmark.pointnet.sampling import farthest_points
from benchmark.pointnet.shared_mlp import SharedMLP

__all__ = [
    "Abstracted",
    "FeaturePropagation",
    "Scale",
    "SetAbstraction",
    "SharedMLP",
    "at",
    "ball_query",
    "farthest_points",
    "group",
    "interpolated",
    "nearest",
]
