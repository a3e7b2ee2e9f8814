"""LIDF as a restorer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from benchmark.methods.lidf.config import PRESETS
from benchmark.methods.lidf.network import LIDFNetwork
from benchmark.methods.network import NetworkRestorer, color_and_depth, device_called
from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.weights import load_weights, weights_for
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import pixel_rays


class LIDF(NetworkRestorer):
    """Where the rays of pixels end among voxels; settings are those of `LIDFConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(preset_of(PRESETS, options.preset), options.settings)
        device_called(options.device)
        network = LIDFNetwork(self.config)
        load_weights(network, weights_for("lidf", options))
        super().__init__(network, options, self.config.input_size)
        self.needs_mask = self.config.mask == "objects"

    def inputs(self, views: Sequence[View]) -> tuple[Tensor, ...]:
        """Colour, depth, rays, which depth is believed and which pixels are asked for.

        Raises:
            ToolkitError: a view without a mask, which `mask=objects` needs.
        """
        color, depth = (self.resized(i) for i in color_and_depth(views, self.device))
        h, w = depth.shape[-2:]
        rays = np.stack([pixel_rays(view.camera.resized(w, h)) for view in views])
        directions = torch.from_numpy(rays).to(self.device, torch.float32).permute(0, 3, 1, 2)
        # Pixels that no ray reaches through the lens.
        reached = directions.isfinite().all(dim=1, keepdim=True)
        directions = torch.where(
            reached, directions, directions.new_tensor((0, 0, 1.0))[:, None, None]
        )
        believed = (depth > 0) & reached
        if self.needs_mask:
            believed &= ~self.resized(self._masks(views)).bool()
        asked = reached if self.config.predict == "all" else reached & ~believed
        return color, depth, directions, believed, asked

    def _masks(self, views: Sequence[View]) -> Tensor:
        masks = []
        for view in views:
            if view.mask is None:
                raise ToolkitError(
                    "method `lidf` with mask=objects needs to know the pixels of the objects, and "
                    "this view has no mask",
                    field="mask",
                    hint="use mask=holes, or data whose frames have instance masks",
                )
            masks.append(view.mask)
        return torch.from_numpy(np.stack(masks)).to(self.device)[:, None].float()
