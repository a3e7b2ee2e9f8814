"""The network of SPD.

Source: Tian, Ang, Lee, "Shape Prior Deformation for Categorical 6D Object Pose and Size
Estimation", ECCV 2020.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from benchmark.pointnet import SharedMLP
from benchmark.pose_methods.deformation import Deformed, Deformer
from benchmark.pose_methods.patch_features import PatchFeatures
from benchmark.pose_methods.priors.file import load_priors
from benchmark.pose_methods.spd.config import PriorNetworkConfig, SPDConfig
from std_toolkit.errors import ToolkitError


class PriorNetwork(nn.Module):
    """What knows the priors and sees objects as the configuration says.

    Raises:
        ToolkitError: no priors, or of another number of points.
    """

    prior: Tensor

    def __init__(self, config: PriorNetworkConfig) -> None:
        super().__init__()
        self.config = config
        points = load_priors(config.priors).of(config.categories)
        if points.shape[1] != config.prior_points:
            raise ToolkitError(
                f"the priors have {points.shape[1]} points",
                field="prior_points",
                value=config.prior_points,
            )
        if config.side % 8:
            raise ToolkitError("must be a multiple of 8", field="side", value=config.side)
        # Kept with the weights: another prior would be another network.
        self.register_buffer("prior", torch.from_numpy(points))

    def seen(self, points: Tensor) -> Tensor:
        """Points as the network sees them."""
        if not self.config.centred:
            return points
        apart = points - points.mean(dim=1, keepdim=True)
        return apart / apart.norm(dim=2).mean(dim=1).clamp(min=1e-6)[:, None, None]

    def color_features(self) -> PatchFeatures:
        """A new network over colour."""
        config = self.config
        return PatchFeatures(
            width=config.color_width,
            blocks=config.color_blocks,
            decoder=config.color_decoder,
            outputs=config.color,
        )

    def deformer(self, local: int, prior_local: int) -> Deformer:
        """New heads over features of these channels."""
        config = self.config
        return Deformer(
            local,
            prior_local,
            width=config.width,
            hidden=config.hidden,
            categories=len(config.categories),
            prior_points=config.prior_points,
        )


class SPDNetwork(PriorNetwork):
    """Patches and points of objects to `Deformed`.

    Raises:
        ToolkitError: no priors, or of another number of points.
    """

    def __init__(self, config: SPDConfig) -> None:
        super().__init__(config)
        g = config.geometry
        self.color = self.color_features()
        self.geometry = SharedMLP(3, (g, g, g), normalised=False)
        self.prior_geometry = SharedMLP(3, (g, g, g), normalised=False)
        self.heads = self.deformer(config.color + g, g)

    def forward(self, color: Tensor, points: Tensor, pixels: Tensor, category: Tensor) -> Deformed:
        """Objects.

        Args:
            color: (b, 3, s, s) RGB in [0, 1].
            points: (b, n, 3) metres in the camera frame.
            pixels: (b, n) place of each point in the patch.
            category: (b,) place of its category in the configuration's.
        """
        points, prior = self.seen(points), self.prior[category]
        local = torch.cat([self.geometry(points.transpose(1, 2)), self.color(color, pixels)], dim=1)
        prior_local = self.prior_geometry(prior.transpose(1, 2))
        return self.heads(local, prior_local, prior, points, category)
