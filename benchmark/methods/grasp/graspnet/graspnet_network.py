"""GraspNet (Fang et al., CVPR 2020): the network, its heads and cylinder grouping.

Written from the paper; the authors' weights do not fit.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from benchmark.methods.grasp.graspnet.cloud import GraspNetConfig
from benchmark.methods.pointnet.layers import FeaturePropagation, Scale, SetAbstraction, SharedMLP

# Numbers in memory at once, about; several tensors of this many are.
_AT_ONCE = 4_000_000


class Approaches(NamedTuple):
    """What is said of s seeds from their features.

    Attributes:
        objectness: (b, 2, s) logits: table or nothing, object.
        views: (b, s, v) how well each approach view does, the best grasp's score there.
    """

    objectness: Tensor
    views: Tensor


class Operations(NamedTuple):
    """What is said of s seeds and one view each, for a turns about the view and d depths.

    Attributes:
        scores: (b, s, a, d).
        turns: (b, s, a, d) logits over the a turns.
        widths: (b, s, a, d) metres.
        tolerances: (b, s, a, d) metres.
    """

    scores: Tensor
    turns: Tensor
    widths: Tensor
    tolerances: Tensor


class ApproachHead(nn.Module):
    """Objectness and views of seeds."""

    def __init__(self, config: GraspNetConfig) -> None:
        super().__init__()
        inner, outputs = 2 * config.width, 2 + config.views
        self.net = nn.Sequential(
            SharedMLP(inner, (inner, outputs)), nn.Conv1d(outputs, outputs, kernel_size=1)
        )

    def forward(self, features: Tensor) -> Approaches:
        """Of features (b, c, s)."""
        found = self.net(features)
        return Approaches(found[:, :2], found[:, 2:].transpose(1, 2))


class OperationHead(nn.Module):
    """The points of cylinders to the best turns, their scores, widths and tolerances."""

    def __init__(self, config: GraspNetConfig) -> None:
        super().__init__()
        inner = 2 * config.width
        self.radius, self.angles = config.cylinder_radius, config.angles
        self.points = SharedMLP(3, (config.width // 2, config.width, inner), dimensions=2)
        self.operation = _trunk(inner, config.width, 3 * config.angles)
        self.tolerance = _trunk(inner, config.width, config.angles)

    def forward(self, cylinders: Tensor) -> Operations:
        """Of points (b, s, d, k, 3), metres in the frames of the grippers."""
        b, s, d, k, _ = cylinders.shape
        local = cylinders.reshape(b, s * d, k, 3).permute(0, 3, 1, 2) / self.radius
        features = self.points(local).amax(dim=3)
        operation = self._by_turn(self.operation(features), s, d)
        tolerances = self._by_turn(self.tolerance(features), s, d)
        scores, turns, widths = operation.split(self.angles, dim=2)
        return Operations(scores, turns, widths, tolerances)

    @staticmethod
    def _by_turn(found: Tensor, s: int, d: int) -> Tensor:
        """(b, s, c, d) of (b, c, s d)."""
        return found.unflatten(2, (s, d)).transpose(1, 2)


def _trunk(inputs: int, width: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(SharedMLP(inputs, (width, width)), nn.Conv1d(width, outputs, 1))


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


@torch.no_grad()
def group_cylinders(
    cloud: Tensor,
    seeds: Tensor,
    rotations: Tensor,
    *,
    radius: float,
    behind: float,
    ends: Sequence[float],
    count: int,
) -> Tensor:
    """Up to `count` points of each cylinder, the first ones of the cloud.

    Cylinders of one seed have a common axis, x of the gripper, and a common beginning. Where there
    are fewer points the first is repeated, which a maximum over them does not see.

    Args:
        cloud: (b, n, 3) metres, in any order that has nothing to do with place.
        seeds: (b, s, 3) points of the cloud.
        rotations: (b, s, 3, 3) of grippers; columns are their x, y and z.
        radius: metres.
        behind: metres before the seed where cylinders begin.
        ends: metres beyond the seed where they end.
        count: of points.

    Returns:
        (b, s, d, count, 3) metres from the seed along the gripper's axes.
    """
    b, n, _ = cloud.shape
    s = seeds.shape[1]
    at_once = max(1, _AT_ONCE // n)
    found = cloud.new_empty(b, s, len(ends), count, 3)
    for image in range(b):
        for begin in range(0, s, at_once):
            part = slice(begin, begin + at_once)
            own = rotations[image, part]
            # p R of all rotations in one product: (n, 3) (3, 3 r).
            turned = cloud[image] @ own.permute(1, 0, 2).reshape(3, -1)
            turned = turned.reshape(n, -1, 3).permute(1, 2, 0)
            origin = torch.einsum("rij,ri->rj", own, seeds[image, part])
            local = turned - origin[:, :, None]
            x, y, z = local.unbind(1)
            inside = (y * y + z * z < radius * radius) & (x > -behind)
            for k, end in enumerate(ends):
                index = _first(inside & (x < end), count)
                index = index[:, None].expand(-1, 3, -1)
                found[image, part, k] = local.gather(2, index).transpose(1, 2)
    return found


def _first(inside: Tensor, count: int) -> Tensor:
    """(r, count) columns of the first true values of each of (r, n) rows.

    The first one stands for those that there are not, and column 0 where there is none at all.
    """
    rank = inside.cumsum(1, dtype=torch.int32)
    row, column = (inside & (rank <= count)).nonzero(as_tuple=True)
    found = column.new_full((len(inside), count), -1)
    found[row, rank[row, column].long() - 1] = column
    return torch.where(found < 0, found[:, :1].clamp(min=0), found)
