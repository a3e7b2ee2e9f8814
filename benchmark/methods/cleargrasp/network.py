"""ClearGrasp's three networks (Sajjan et al., ICRA 2020): masks, normals and boundaries."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor, nn
from torch.nn.functional import normalize

from benchmark.methods.cleargrasp.config import ClearGraspConfig
from benchmark.methods.cleargrasp.deeplab import DeepLab

_CLASSES = (0.5, 0.1)  # dropout of the two that classify


class ClearGraspMaps(NamedTuple):
    """What the networks say of every pixel.

    Attributes:
        masks: (b, 2, h, w) logits: other, of a transparent object.
        normals: (b, 3, h, w) unit normals, y up and z towards the camera.
        boundaries: (b, 3, h, w) logits: none, occlusion boundary, contact edge.
    """

    masks: Tensor
    normals: Tensor
    boundaries: Tensor


class ClearGraspNetwork(nn.Module):
    """`network(color)` to `ClearGraspMaps`. The three share nothing; each can be trained alone."""

    def __init__(self, config: ClearGraspConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or ClearGraspConfig()
        self.masks = DeepLab(2, config, _CLASSES)
        self.normals = DeepLab(3, config, None)
        self.boundaries = DeepLab(3, config, _CLASSES)

    def forward(self, color: Tensor) -> ClearGraspMaps:
        """Maps of (b, 3, h, w) RGB in [0, 1]."""
        return ClearGraspMaps(
            self.masks(color),
            normalize(self.normals(color).float(), dim=1),
            self.boundaries(color),
        )
