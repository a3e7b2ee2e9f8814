"""ClearGrasp as a restorer: three networks, then the global optimization."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import interpolate, normalize

from benchmark.data.frame import resize_nearest
from benchmark.methods import protocol, registry, weights
from benchmark.methods.depth.cleargrasp import cleargrasp_network, global_optimization
from benchmark.methods.network import NetworkRestorer, torch_device
from std_toolkit import plugins
from std_toolkit.errors import ToolkitError

_TRANSPARENT = 1  # class of the mask

_OCCLUSION = 1  # class of the boundaries


class ClearGrasp(NetworkRestorer):
    """Depth from predicted normals and boundaries; settings are those of `ClearGraspConfig`.

    It takes views of any size. Depth is optimised at `depth_size`; of a larger view, what was
    measured outside the mask stays as it is, at its own resolution.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = cleargrasp_network.ClearGraspConfig

    def __init__(self, options: registry.MethodOptions) -> None:
        self.config = plugins.configured(
            registry.preset_of(cleargrasp_network.PRESETS, options.preset), options.settings
        )
        torch_device(options.device)
        if self.config.grow_px < 0:
            raise ToolkitError("must not be negative", field="grow_px", value=self.config.grow_px)
        network = cleargrasp_network.ClearGraspNetwork(self.config)
        weights.load_weights(network, weights.weights_for("cleargrasp", options))
        super().__init__(network, options, None)
        self.needs_mask = self.config.mask == "given"
        self._depth = DepthOfMaps(self.config)

    def inputs(self, views: Sequence[protocol.View]) -> tuple[Tensor, ...]:
        """Colour at the networks' size."""
        w, h = self.config.input_size
        colors = []
        for view in views:
            shrinks = view.color.shape[0] >= h and view.color.shape[1] >= w
            way = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
            colors.append(cv2.resize(view.color, (w, h), interpolation=way))
        color = torch.from_numpy(np.stack(colors)).to(self.device)
        return (color.permute(0, 3, 1, 2).float() / 255,)

    def answers(self, outputs: Any, views: Sequence[protocol.View]) -> list[protocol.Restored]:
        """Optimise the depth of each view with the networks' maps."""
        return [protocol.Restored(depth) for depth in self._depth(outputs, views)]


class DepthOfMaps:
    """The global optimisation, at `depth_size`, and what was measured around it.

    Args:
        config: which mask drops measurements, by how much it is widened, and the size.
    """

    def __init__(self, config: cleargrasp_network.ClearGraspConfig) -> None:
        self.config = config
        # The mask is widened here, for what is kept of the view depends on it, too.
        self._optimization = global_optimization.OptimizationOptions(grow_px=0)

    def __call__(
        self, maps: cleargrasp_network.ClearGraspMaps, views: Sequence[protocol.View]
    ) -> list[NDArray[np.float32]]:
        """(h, w) metres of each view, whose maps may have any size.

        Raises:
            ToolkitError: a view has no mask, which `mask=given` needs.
        """
        size = self.config.depth_size[::-1]
        chosen = (
            maps.normals.float(),
            maps.masks.float().softmax(dim=1)[:, _TRANSPARENT, None],
            maps.boundaries.float().softmax(dim=1)[:, _OCCLUSION, None],
        )
        sized = [interpolate(i, size=size, mode="bilinear", align_corners=False) for i in chosen]
        sized[0] = normalize(sized[0], dim=1)
        normals, chances, boundaries = (i.permute(0, 2, 3, 1).cpu().numpy() for i in sized)
        found = []
        for index, view in enumerate(views):
            mask = chances[index, ..., 0] > 0.5
            if self.config.mask == "given":
                mask = resize_nearest(_given(view), self.config.depth_size)
            boundary = boundaries[index, ..., 0].clip(0, 1)
            found.append(self._optimized(view, normals[index], boundary, mask))
        return found

    def _optimized(
        self,
        view: protocol.View,
        normals: NDArray[np.float32],
        boundary: NDArray[np.float32],
        mask: NDArray[np.bool_],
    ) -> NDArray[np.float32]:
        size = self.config.depth_size
        reach = 2 * self.config.grow_px + 1
        doubted = cv2.dilate(mask.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
        measured = np.isfinite(view.depth) & (view.depth >= self._optimization.nearest_m)
        depth = np.where(measured, view.depth, np.float32(0))
        optimized = global_optimization.optimize_depth(
            resize_nearest(depth, size),
            global_optimization.normals_to_opencv(normals),
            boundary,
            doubted,
            view.camera.resized(*size),
            self._optimization,
        )
        own = (view.camera.width, view.camera.height)
        kept = measured & ~resize_nearest(doubted, own)
        return np.where(kept, depth, resize_nearest(optimized, own))


def _given(view: protocol.View) -> NDArray[np.bool_]:
    if view.mask is None:
        raise ToolkitError(
            "method `cleargrasp` with mask=given needs to know the pixels of the objects, and this "
            "view has no mask",
            field="mask",
            hint="use mask=predicted, or data whose frames have instance masks",
        )
    return view.mask
