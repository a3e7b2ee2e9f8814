"""The network of SGPA.

Source: Chen, Dou, "SGPA: Structure-Guided Prior Adaptation for Category-Level 6D Object Pose
Estimation", ICCV 2021.
"""

from __future__ import annotations

import torch
from torch import Tensor

from benchmark.pose_methods.deformation import Deformed
from benchmark.pose_methods.sgpa.config import SGPAConfig
from benchmark.pose_methods.sgpa.geometry import GeometryFeatures
from benchmark.pose_methods.sgpa.structure import Adaptation, StructurePoints
from benchmark.pose_methods.spd.network import PriorNetwork
from std_toolkit.errors import ToolkitError


class SGPANetwork(PriorNetwork):
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

    def forward(self, color: Tensor, points: Tensor, pixels: Tensor, category: Tensor) -> Deformed:
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
    )
