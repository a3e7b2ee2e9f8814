"""ClearGrasp as a restorer: three networks, then the global optimisation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from benchmark.methods.cleargrasp.config import PRESETS
from benchmark.methods.cleargrasp.network import ClearGraspNetwork
from benchmark.methods.cleargrasp.optimized import DepthOfMaps
from benchmark.methods.network import NetworkRestorer, device_called
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.weights import load_weights, weights_for
from std_toolkit.errors import ToolkitError


class ClearGrasp(NetworkRestorer):
    """Depth from predicted normals and boundaries; settings are those of `ClearGraspConfig`.

    It takes views of any size. Depth is optimised at `depth_size`; of a larger view, what was
    measured outside the mask stays as it is, at its own resolution.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(preset_of(PRESETS, options.preset), options.settings)
        device_called(options.device)
        if self.config.grow_px < 0:
            raise ToolkitError("must not be negative", field="grow_px", value=self.config.grow_px)
        network = ClearGraspNetwork(self.config)
        load_weights(network, weights_for("cleargrasp", options))
        super().__init__(network, options, None)
        self.needs_mask = self.config.mask == "given"
        self._depth = DepthOfMaps(self.config)

    def inputs(self, views: Sequence[View]) -> tuple[Tensor, ...]:
        """Colour at the networks' size."""
        w, h = self.config.input_size
        colors = []
        for view in views:
            shrinks = view.color.shape[0] >= h and view.color.shape[1] >= w
            way = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
            colors.append(cv2.resize(view.color, (w, h), interpolation=way))
        color = torch.from_numpy(np.stack(colors)).to(self.device)
        return (color.permute(0, 3, 1, 2).float() / 255,)

    def answers(self, outputs: Any, views: Sequence[View]) -> list[Restored]:
        """Optimise the depth of each view with the networks' maps."""
        return [Restored(depth) for depth in self._depth(outputs, views)]
