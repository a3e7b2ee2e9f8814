"""What the network says of seeds and of what lies in their cylinders."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor, nn

from benchmark.grasp_methods.graspnet.config import GraspNetConfig
from benchmark.pointnet import SharedMLP


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
