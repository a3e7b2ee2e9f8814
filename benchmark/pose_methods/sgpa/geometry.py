"""Geometry features of every point, by PointNet++ with two radii at each of several levels."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from benchmark.pointnet import FeaturePropagation, Scale, SetAbstraction
from std_toolkit.errors import ToolkitError

# Widths at the smaller and the larger radius of each level, and of the way back, as PointNet++ has
# them for the segmentation of scenes.
_DOWN = (
    ((16, 16, 32), (32, 32, 64)),
    ((64, 64, 128), (64, 96, 128)),
    ((128, 196, 256), (128, 196, 256)),
    ((256, 256, 512), (256, 384, 512)),
)
_UP = ((128, 128), (256, 256), (512, 512), (512, 512))


class GeometryFeatures(nn.Module):
    """Points (b, n, 3) to features (b, `outputs`, n).

    Args:
        centres: points that are left at each level, four at most.
        radii: two at each level.
        neighbours: of a centre at the first and the second radius.
        thickness: by what all channels are divided.
        outputs: channels.

    Raises:
        ToolkitError: levels that do not belong together.
    """

    def __init__(
        self,
        centres: Sequence[int],
        radii: Sequence[float],
        neighbours: Sequence[int],
        *,
        thickness: int,
        outputs: int,
    ) -> None:
        super().__init__()
        if not 1 <= len(centres) <= len(_DOWN) or len(radii) != 2 * len(centres):
            raise ToolkitError(
                f"needs one to {len(_DOWN)} levels and two radii for each",
                field="centres",
                value=(tuple(centres), tuple(radii)),
            )
        if len(neighbours) != 2:
            raise ToolkitError("needs two numbers", field="neighbours", value=tuple(neighbours))

        def thin(widths: Sequence[int]) -> tuple[int, ...]:
            return tuple(max(4, width // thickness) for width in widths)

        self.down = nn.ModuleList()
        channels = [0]
        for level, count in enumerate(centres):
            scales = [
                Scale(radii[2 * level + k], neighbours[k], thin(_DOWN[level][k])) for k in (0, 1)
            ]
            layer = SetAbstraction(count, scales, channels[-1])
            self.down.append(layer)
            channels.append(layer.outputs)
        self.up = nn.ModuleList()
        carried = channels[-1]
        for level in reversed(range(len(centres))):
            up = FeaturePropagation(carried + channels[level], thin(_UP[level]))
            self.up.append(up)
            carried = up.outputs
        self.last = nn.Sequential(nn.Conv1d(carried, outputs, 1), nn.ReLU())

    def forward(self, points: Tensor) -> Tensor:
        places, features = [points], [None]
        for down in self.down:
            fewer = down(places[-1], features[-1])
            places.append(fewer.points)
            features.append(fewer.features)
        carried = features[-1]
        for step, up in enumerate(self.up):
            level = len(places) - 2 - step
            carried = up(places[level + 1], carried, places[level], features[level])
        return self.last(carried)
