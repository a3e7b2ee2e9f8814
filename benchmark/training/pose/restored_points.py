"""Depth that a restorer makes of training batches, for networks trained on restored depth."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmark.methods.depth.full_size import at_full_size, sensor_view
from benchmark.methods.protocol import Restorer
from benchmark.methods.registry import MethodOptions, make_restorer, preset_for
from benchmark.training.step import ModelInput
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera


def restored_depth(inputs: ModelInput, restorer: str, weights: str | None) -> Tensor:
    """Restore the sensor's depth of a batch, as `std-bench pose --depth` does of a frame.

    Args:
        inputs: a batch.
        restorer: name of the restorer.
        weights: its weights; None for those that ship.

    Returns:
        (b, h, w) metres, 0 where there is no answer; without a gradient.

    Raises:
        ToolkitError: the restorer cannot be made, or needs a mask.
    """
    device = inputs.depth.device
    method = _restorer(restorer, weights, str(device))
    colors = (255 * inputs.color.permute(0, 2, 3, 1)).round().clamp(0, 255).byte().cpu().numpy()
    sensed = inputs.depth[:, 0].float().cpu().numpy()
    height, width = sensed.shape[1:]
    cameras = [
        Camera(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        for K in inputs.batch["K"].double().cpu().numpy()
    ]
    views = [
        sensor_view(color, depth, camera, method.input_size)
        for color, depth, camera in zip(colors, sensed, cameras, strict=True)
    ]
    answers = method.restore(views)
    found = [at_full_size(depth, answer) for depth, answer in zip(sensed, answers, strict=True)]
    return torch.from_numpy(np.stack(found)).to(device)


@cache
def _restorer(name: str, weights: str | None, device: str) -> Restorer:
    path = None if weights is None else Path(weights)
    made = make_restorer(
        name, MethodOptions(preset=preset_for(name, None, path), weights=path, device=device)
    )
    if made.needs_mask:
        raise ToolkitError("needs masks, which a pack lacks", field="restorer", value=name)
    return made
