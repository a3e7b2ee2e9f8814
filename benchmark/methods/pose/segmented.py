"""Segmented objects of an image, and their crops for networks.

A crop is a colour patch, and points with their positions in the patch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from benchmark.data.frame import Instance, resize_nearest
from benchmark.methods.torch_camera import points_at
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
        chances: (N, 8) float64 of each class, 0 an object of none; None where only the classes
            above are known.

    Raises:
        ToolkitError: arrays that do not belong together.
    """

    class_ids: NDArray[np.int64]
    scores: NDArray[np.float64]
    masks: NDArray[np.bool_]
    chances: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        n = len(self.class_ids)
        fits = self.chances is None or len(self.chances) == n
        if self.scores.shape != (n,) or self.masks.ndim != 3 or len(self.masks) != n or not fits:
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
        return replace(self, masks=_stacked(masks, size[::-1]))

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Segmented:
        """Some of the objects, by (N,) bool or by their places."""
        chances = None if self.chances is None else self.chances[chosen]
        return Segmented(self.class_ids[chosen], self.scores[chosen], self.masks[chosen], chances)


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
        points: (n, 3) metres in the frame of the turned camera.
        pixels: (n,) place of each point in the patch, row * s + column.
        chosen: (n,) place of each point in the image, row * width + column.
        turn: () of the square, radians; points are in the frame of a camera turned so.
    """

    color: Tensor
    points: Tensor
    pixels: Tensor
    chosen: Tensor
    turn: Tensor


class Placed(NamedTuple):
    """How the square of a crop lies around a mask.

    Attributes:
        turn: of the square, radians, from x to y of the image. The crop is that of a camera turned
            about its axis; its points are in that camera's frame.
        margin: side over the longer side of the mask's box.
        shift: of the middle, in sides.
    """

    turn: float = 0.0
    margin: float = _MARGIN
    shift: tuple[float, float] = (0.0, 0.0)


def crop_object(
    color: Tensor,
    depth: Tensor,
    mask: Tensor,
    K: Tensor,
    *,
    side: int,
    points: int,
    generator: torch.Generator | None = None,
    placed: Placed | None = None,
) -> Crop | None:
    """Cut an object out: a square around its mask, and points drawn from its pixels with depth.

    No point is drawn twice before all were drawn once.

    Args:
        color: (3, h, w) RGB in [0, 1], or more channels.
        depth: (h, w) metres, 0 where there is none.
        mask: (h, w) bool pixels of the object.
        K: (3, 3) intrinsics.
        side: of the patch, pixels.
        points: how many.
        generator: of the draw, on the CPU; torch's global one by default.
        placed: how the square lies; upright around the mask by default.

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
    placed = placed or Placed()
    middle, size = _square(mask, placed)
    c, r = math.cos(placed.turn) * size, math.sin(placed.turn) * size
    # From [-1, 1] in the patch to [-1, 1] in the image.
    theta = torch.tensor(
        [
            [c / w, -r / w, 2 * middle[0] / w - 1],
            [r / h, c / h, 2 * middle[1] / h - 1],
        ],
        device=color.device,
    )
    grid = affine_grid(theta[None], [1, 3, side, side], align_corners=False)
    patch = grid_sample(color[None].float(), grid, align_corners=False)[0]
    z = depth.flatten()[chosen].float()
    x, y = points_at(column, row, z, K)
    x, y = _turned(x, y, -placed.turn)
    right, down = _turned(column + 0.5 - middle[0], row + 0.5 - middle[1], -placed.turn)
    at_row = ((down + size / 2) * side / size).floor().long().clamp(0, side - 1)
    at_column = ((right + size / 2) * side / size).floor().long().clamp(0, side - 1)
    return Crop(
        patch,
        torch.stack([x, y, z], dim=1),
        at_row * side + at_column,
        chosen,
        color.new_tensor(placed.turn),
    )


def with_mask(color: Tensor, mask: Tensor) -> Tensor:
    """(4, h, w) colour (3, h, w), and the mask (h, w) as 0 and 1."""
    return torch.cat([color, mask[None].to(color.dtype)])


def turned_about_z(points: Tensor, turn: Tensor) -> Tensor:
    """Points (b, n, 3) of cameras in the frames of the cameras turned about their axes.

    Args:
        points: (b, n, 3).
        turn: (b,) angles, radians, from x to y.
    """
    # Products of matrices would be those of half precision in training.
    c, s = turn.cos()[:, None].to(points.dtype), turn.sin()[:, None].to(points.dtype)
    x, y, z = points.unbind(dim=2)
    return torch.stack([c * x + s * y, c * y - s * x, z], dim=2)


def stacked(crops: list[Crop]) -> Crop:
    """Crops of one size as a batch."""
    return Crop(*(torch.stack(list(part)) for part in zip(*crops, strict=True)))


def longest_axis(mask: Tensor) -> float:
    """Angle of the longest axis of a mask from the image's y axis, radians in (-pi/2, pi/2].

    A square turned by it has this axis upright.
    """
    rows, columns = mask.nonzero(as_tuple=True)
    x, y = columns - columns.double().mean(), rows - rows.double().mean()
    angle = 0.5 * math.atan2(2 * float((x * y).sum()), float((x * x).sum() - (y * y).sum()))
    return angle - math.pi / 2 if angle > 0 else angle + math.pi / 2


def _turned(x: Tensor, y: Tensor, angle: float) -> tuple[Tensor, Tensor]:
    """x and y turned by an angle, radians, from x to y."""
    if angle == 0:
        return x, y
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


def _square(mask: Tensor, placed: Placed) -> tuple[tuple[float, float], float]:
    """Middle (x, y) and side of the square around a mask; it may reach beyond the image."""
    rows, columns = mask.nonzero(as_tuple=True)
    right, down = _turned(columns + 0.5, rows + 0.5, -placed.turn)
    low = float(right.min()) - 0.5, float(down.min()) - 0.5
    high = float(right.max()) + 0.5, float(down.max()) + 0.5
    size = placed.margin * max(high[0] - low[0], high[1] - low[1])
    x = (low[0] + high[0]) / 2 + placed.shift[0] * size
    y = (low[1] + high[1]) / 2 + placed.shift[1] * size
    c, s = math.cos(placed.turn), math.sin(placed.turn)
    return (c * x - s * y, s * x + c * y), size
