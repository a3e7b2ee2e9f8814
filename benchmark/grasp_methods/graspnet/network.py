"""GraspNet (Fang et al., CVPR 2020) from a cloud to grasps of its points.

Written from the published description, not from the authors' program: its weights do not fit.
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor, nn

from benchmark.grasp_methods.graspnet.config import GraspNetConfig
from benchmark.grasp_methods.graspnet.cylinder import group_cylinders
from benchmark.grasp_methods.graspnet.heads import (
    Approaches,
    ApproachHead,
    OperationHead,
    Operations,
)
from benchmark.pointnet import FeaturePropagation, Scale, SetAbstraction


class Seeds(NamedTuple):
    """Points of the cloud, and from where to approach them.

    Attributes:
        chosen: (b, s) which points of the cloud.
        points: (b, s, 3) metres.
        approaches: what is said of them.
    """

    chosen: Tensor
    points: Tensor
    approaches: Approaches


class GraspNetwork(nn.Module):
    """Two steps: `seeds(cloud)`, and `operations(cloud, points, rotations)` of chosen views.

    Between them somebody chooses a view of each seed: the best one, or in training one of which
    the answers are known.
    """

    def __init__(self, config: GraspNetConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or GraspNetConfig()
        half, full, double = config.width // 2, config.width, 2 * config.width
        levels, inputs = [], 0
        for level, (points, radius, neighbours) in enumerate(
            zip(config.level_points, config.level_radii, config.level_neighbours, strict=True)
        ):
            widths = (half, half, full) if level == 0 else (full, full, double)
            scale = Scale(radius, neighbours, widths)
            levels.append(SetAbstraction(points, [scale], inputs, normalise=True))
            inputs = widths[-1]
        self.levels = nn.ModuleList(levels)
        self.back = nn.ModuleList(
            FeaturePropagation(2 * double, (double, double)) for _ in range(2)
        )
        self.approach = ApproachHead(config)
        self.operation = OperationHead(config)

    def seeds(self, cloud: Tensor) -> Seeds:
        """Of clouds (b, n, 3), camera frame, metres, in an order that does not follow place."""
        points, features, within = cloud, None, []
        chosen = None
        for level, abstraction in enumerate(self.levels):
            points, features, index = abstraction(points, features)
            within.append((points, features))
            if level < 2:
                chosen = index if chosen is None else chosen.gather(1, index)
        assert chosen is not None and features is not None
        for propagation, (wanted, before) in zip(self.back, within[2:0:-1], strict=True):
            features = propagation(points, features, wanted, before)
            points = wanted
        return Seeds(chosen, points, self.approach(features))

    def operations(self, cloud: Tensor, points: Tensor, rotations: Tensor) -> Operations:
        """Of grippers at points (b, s, 3) of the cloud, turned by (b, s, 3, 3)."""
        config = self.config
        cylinders = group_cylinders(
            cloud,
            points,
            rotations,
            radius=config.cylinder_radius,
            behind=config.cylinder_behind,
            ends=config.depths,
            count=config.cylinder_points,
        )
        return self.operation(cylinders)
