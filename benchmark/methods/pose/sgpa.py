"""SGPA: configuration, network, pose estimator.

Geometry features come from PointNet++ with two radii at each level. Low-rank structure points adapt
the prior.

Source: Chen, Dou, "SGPA: Structure-Guided Prior Adaptation for Category-Level 6D Object Pose
Estimation", ICCV 2021.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from benchmark.methods.network import network_of
from benchmark.methods.pointnet.layers import FeaturePropagation, Scale, SetAbstraction, SharedMLP
from benchmark.methods.pose import deformation, spd
from benchmark.methods.pose.crop_estimator import CropEstimator
from benchmark.methods.pose.released_keys import sgpa_state
from benchmark.methods.registry import MethodOptions
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

_UP_RELEASED = ((64, 64), (128, 128), (256, 256), (512, 512))


@dataclass(frozen=True, kw_only=True)
class SGPAConfig(spd.PriorNetworkConfig):
    """The network; see `PriorNetworkConfig`.

    Attributes:
        centres: points that are left at each level of PointNet++.
        radii: two at each level, smaller and larger in turn, in the unit of the points.
        prior_radii: the same for the prior, whose diagonal is 1.
        neighbours: of a centre at the smaller and at the larger radius.
        thickness: by what the channels of PointNet++ are divided.
        structure: how many points stand for an object's structure.
        structure_widths: of the network that chooses them.
        heads: of the attention.
    """

    centres: tuple[int, ...] = (512, 256, 128, 64)
    radii: tuple[float, ...] = (0.01, 0.02, 0.02, 0.04, 0.04, 0.08, 0.08, 0.16)
    prior_radii: tuple[float, ...] = (0.01, 0.02, 0.02, 0.04, 0.04, 0.08, 0.08, 0.16)
    neighbours: tuple[int, ...] = (16, 32)
    thickness: int = 1
    structure: int = 256
    structure_widths: tuple[int, ...] = (256,)
    heads: int = 4


PRESETS = {
    "published": SGPAConfig(),
    "compact": SGPAConfig(
        **spd.COMPACT,
        # Of points that are a unit away from their middle on average.
        centres=(256, 128, 64, 32),
        radii=(0.1, 0.2, 0.2, 0.4, 0.4, 0.8, 0.8, 1.6),
        prior_radii=(0.04, 0.08, 0.08, 0.16, 0.16, 0.32, 0.32, 0.64),
        thickness=4,
        structure=64,
        structure_widths=(128, 128),
    ),
}


class SGPANetwork(spd.PriorNetwork):
    """Patches and points of objects to `Deformed`.

    Raises:
        ToolkitError: no priors or of another number of points, levels that do not belong together,
            or features of geometry and colour with different channels.
    """

    def __init__(self, config: SGPAConfig) -> None:
        super().__init__(config)
        if config.color != config.geometry or config.geometry % config.heads:
            raise ToolkitError(
                "features of geometry and colour must have as many channels, a multiple of heads",
                field="geometry",
                value=(config.geometry, config.color, config.heads),
            )
        g = config.geometry
        self.color = self.color_features()
        self.geometry = _geometry(config, config.radii)
        self.prior_geometry = _geometry(config, config.prior_radii)
        self.structure = StructurePoints(g, g, config.structure_widths, config.structure)
        self.adapt = Adaptation(g, config.heads)
        self.heads = self.deformer(2 * g, 2 * g)

    def forward(
        self, color: Tensor, points: Tensor, pixels: Tensor, category: Tensor
    ) -> deformation.Deformed:
        """Objects; see `SPDNetwork.forward`."""
        points, prior = self.seen(points), self.prior[category]
        of_points, of_pixels = self.geometry(points), self.color(color, pixels)
        structure = self.structure(points, of_points, of_pixels)
        adapted = self.adapt(self.prior_geometry(prior), structure)
        local = torch.cat([of_points, of_pixels], dim=1)
        return self.heads(local, adapted, prior, points, category, structure.points)


def _geometry(config: SGPAConfig, radii: tuple[float, ...]) -> GeometryFeatures:
    return GeometryFeatures(
        config.centres,
        radii,
        config.neighbours,
        thickness=config.thickness,
        outputs=config.geometry,
        released=config.form == "released",
    )


class GeometryFeatures(nn.Module):
    """Points (b, n, 3) to features (b, `outputs`, n).

    Args:
        centres: points that are left at each level, four at most.
        radii: two at each level.
        neighbours: of a centre at the first and the second radius.
        thickness: by what all channels are divided.
        outputs: channels.
        released: the form of the authors' program, whose channels are those of its last level.

    Raises:
        ToolkitError: levels that do not belong together, or other channels than the last level's.
    """

    def __init__(
        self,
        centres: Sequence[int],
        radii: Sequence[float],
        neighbours: Sequence[int],
        *,
        thickness: int,
        outputs: int,
        released: bool = False,
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
            widths = thin((_UP_RELEASED if released else _UP)[level])
            up = FeaturePropagation(carried + channels[level], widths, squared_weights=not released)
            self.up.append(up)
            carried = up.outputs
        if released and carried != outputs:
            raise ToolkitError(
                f"the last level has {carried} channels", field="geometry", value=outputs
            )
        self.last = (
            nn.Identity() if released else nn.Sequential(nn.Conv1d(carried, outputs, 1), nn.ReLU())
        )

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


class Structure(NamedTuple):
    """An object's structure.

    Attributes:
        points: (b, k, 3), each a weighted mean of the object's points.
        geometry, color: (b, k, c) features, means with the same weights.
    """

    points: Tensor
    geometry: Tensor
    color: Tensor


class StructurePoints(nn.Module):
    """Chooses points softly: weights over an object's points, learned from their features.

    Args:
        geometry, color: channels of the features.
        widths: of the network that gives the weights.
        count: of points.
    """

    def __init__(self, geometry: int, color: int, widths: Sequence[int], count: int) -> None:
        super().__init__()
        self.weigh = SharedMLP(
            geometry + color, (*widths, count), normalised=False, last_linear=True
        )

    def forward(self, points: Tensor, geometry: Tensor, color: Tensor) -> Structure:
        """Points (b, n, 3) with features (b, c, n)."""
        scores = self.weigh(torch.cat([geometry, color], dim=1))
        weights = scores.float().softmax(dim=2)
        with torch.autocast(points.device.type, enabled=False):
            return Structure(
                weights @ points,
                weights @ geometry.float().transpose(1, 2),
                weights @ color.float().transpose(1, 2),
            )


class Adaptation(nn.Module):
    """A transformer's attention from a prior's points to the structure of the object.

    Where a part of the prior looks like a part of the object by geometry, it takes the colour
    features of that part.

    Args:
        channels: of all features.
        heads: of the attention.
    """

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.attention = nn.MultiheadAttention(channels, heads, batch_first=True)

    def forward(self, prior: Tensor, structure: Structure) -> Tensor:
        """(b, 2c, m) of prior features (b, c, m): their own, and the attended colour."""
        asked = prior.transpose(1, 2)
        color, _ = self.attention(asked, structure.geometry, structure.color, need_weights=False)
        return torch.cat([prior, color.transpose(1, 2)], dim=1)


class SGPA(CropEstimator):
    """A prior adapted to the structure of the object and deformed; settings are those of
    `SGPAConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = SGPAConfig

    def __init__(self, options: MethodOptions) -> None:
        _, network = network_of("sgpa", PRESETS, SGPANetwork, options, renamed=sgpa_state)
        super().__init__(network, options)
