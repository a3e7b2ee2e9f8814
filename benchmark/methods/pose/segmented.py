"""Segmented objects of an image, and their crops for networks.

A crop is a colour patch, and points with their positions in the patch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from benchmark.data.frame import Instance, resize_nearest
from std_toolkit.errors import ToolkitError

# With fewer pixels that have depth, points would be the same few again and again.
LEAST_PIXELS = 32

# The patch's side over the longer side of the mask's box.
_MARGIN = 1.1


@dataclass(frozen=True, eq=False)
class Segmented:
    """N objects of an image.

    Attributes:
        class_ids: (N,) int64, 1 bottle to 7 aeroplane.
        scores: (N,) float64 confidences in [0, 1].
        masks: (N, h, w) bool pixels of each; they may overlap.

    Raises:
        ToolkitError: arrays that do not belong together.
    """

    class_ids: NDArray[np.int64]
    scores: NDArray[np.float64]
    masks: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n = len(self.class_ids)
        if self.scores.shape != (n,) or self.masks.ndim != 3 or len(self.masks) != n:
            raise ToolkitError(
                f"classes, scores and masks of {n} objects do not belong together",
                value=(self.class_ids.shape, self.scores.shape, self.masks.shape),
            )

    def __len__(self) -> int:
        return len(self.class_ids)

    def resized(self, size: tuple[int, int]) -> Segmented:
        """The same at (width, height), by the nearest pixel."""
        if self.masks.shape[:0:-1] == size:
            return self
        masks = [resize_nearest(mask, size) for mask in self.masks]
        return Segmented(self.class_ids, self.scores, _stacked(masks, size[::-1]))


def true_segments(mask: NDArray[np.uint8], instances: Sequence[Instance]) -> Segmented:
    """The objects of a frame's own mask, those of no class (0) left out; scores are 1.

    Args:
        mask: (h, w) instance ids.
        instances: the objects of `mask`.
    """
    there = [i for i in instances if i.class_id > 0 and (mask == i.mask_id).any()]
    return Segmented(
        np.array([i.class_id for i in there], np.int64),
        np.ones(len(there)),
        _stacked([mask == i.mask_id for i in there], mask.shape),
    )


def _stacked(masks: Sequence[NDArray[np.bool_]], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.stack(masks) if masks else np.zeros((0, *shape), bool)


class Crop(NamedTuple):
    """One object, or a batch of them with b in front.

    Attributes:
        color: (3, s, s) RGB in [0, 1].
        points: (n, 3) metres in the camera frame.
        pixels: (n,) place of each point in the patch, row * s + column.
        chosen: (n,) place of each point in the image, row * width + column.
    """

    color: Tensor
    points: Tensor
    pixels: Tensor
    chosen: Tensor


def crop_object(
    color: Tensor,
    depth: Tensor,
    mask: Tensor,
    K: Tensor,
    *,
    side: int,
    points: int,
    generator: torch.Generator | None = None,
) -> Crop | None:
    """Cut an object out: a square around its mask, and points drawn from its pixels with depth.

    No point is drawn twice before all were drawn once.

    Args:
        color: (3, h, w) RGB in [0, 1].
        depth: (h, w) metres, 0 where there is none.
        mask: (h, w) bool pixels of the object.
        K: (3, 3) intrinsics.
        side: of the patch, pixels.
        points: how many.
        generator: of the draw, on the CPU; torch's global one by default.

    Returns:
        None if fewer than `LEAST_PIXELS` pixels have depth.
    """
    h, w = depth.shape
    there = (mask & torch.isfinite(depth) & (depth > 0)).flatten().nonzero()[:, 0]
    if len(there) < LEAST_PIXELS:
        return None
    rounds = -(-points // len(there))
    order = torch.cat([torch.randperm(len(there), generator=generator) for _ in range(rounds)])
    chosen = there[order[:points].to(there.device)]
    row, column = chosen // w, chosen % w
    top, left, size = _square(mask)
    # The middle of pixel (u, v) of the image is at (u + 0.5 - left) / size of the patch.
    theta = torch.tensor(
        [
            [size / w, 0.0, (2 * left + size) / w - 1],
            [0.0, size / h, (2 * top + size) / h - 1],
        ],
        device=color.device,
    )
    grid = affine_grid(theta[None], [1, 3, side, side], align_corners=False)
    patch = grid_sample(color[None].float(), grid, align_corners=False)[0]
    z = depth.flatten()[chosen].float()
    x = (column - K[0, 2]) * z / K[0, 0]
    y = (row - K[1, 2]) * z / K[1, 1]
    at_row = ((row + 0.5 - top) * side / size).floor().long().clamp(0, side - 1)
    at_column = ((column + 0.5 - left) * side / size).floor().long().clamp(0, side - 1)
    return Crop(patch, torch.stack([x, y, z], dim=1), at_row * side + at_column, chosen)


def stacked(crops: list[Crop]) -> Crop:
    """Crops of one size as a batch."""
    return Crop(*(torch.stack(list(part)) for part in zip(*crops, strict=True)))


def _square(mask: Tensor) -> tuple[float, float, float]:
    """Top, left and side of the square around a mask; it may reach beyond the image."""
    rows, columns = mask.any(dim=1).nonzero()[:, 0], mask.any(dim=0).nonzero()[:, 0]
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    left, right = int(columns[0]), int(columns[-1]) + 1
    size = _MARGIN * max(bottom - top, right - left)
    return (top + bottom - size) / 2, (left + right - size) / 2, size
