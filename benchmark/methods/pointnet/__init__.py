"""PointNet++ (Qi et al., NeurIPS 2017) in plain torch: networks on sets of points.

Everywhere points are (b, n, 3), features (b, c, n) as convolutions want them, and indices (b, ...)
count the points of one set.
"""

from benchmark.methods.pointnet.grouping import at, ball_query, farthest_points, group, nearest
from benchmark.methods.pointnet.layers import (
    Abstracted,
    FeaturePropagation,
    Scale,
    SetAbstraction,
    SharedMLP,
    interpolated,
)

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
