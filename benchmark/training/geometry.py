"""Frames turned, mirrored and enlarged, as published for NLSPN on indoor scenes."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from benchmark.data.frame import BACKGROUND
from benchmark.training.step import Seen

_TURN = math.radians(5.0)  # at most, either way
_LARGEST = 1.5
_KEPT = ("true", "mask", "materials", "K", "index")


def moved(seen: Seen) -> Seen:
    """Every frame mirrored or not, turned by up to 5 degrees and enlarged up to 1.5 times.

    Intrinsics stay as they are: the camera rolls about its axis, whatever the pixels' aspect, and
    the scene is mirrored in the plane through axis and vertical; depth is the same then. What is
    enlarged by s lies at depth / s, as published: points keep their x and y. Depth and masks go
    by the nearest pixel; what comes from outside of the image is unknown.

    The batch keeps `true`, `mask` and what is no map. All draws are from torch's global generator.
    """
    batch = {name: seen.batch[name] for name in _KEPT}
    b, _, h, w = seen.depth.shape
    motion, scale = _motions(b)
    motion, scale = motion.to(seen.depth), scale.to(seen.depth)
    places = _sources(motion, batch["K"].to(seen.depth), h, w)
    size = torch.tensor([w - 1, h - 1], device=places.device).clamp(min=1)
    grid = 2 * places / size - 1

    def nearest(maps: Tensor) -> Tensor:
        return grid_sample(maps, grid, mode="nearest", padding_mode="zeros", align_corners=True)

    color = grid_sample(seen.color, grid, mode="bilinear", padding_mode="zeros", align_corners=True)
    smaller = scale[:, None, None, None]
    true = nearest(batch["true"][:, None]) / smaller
    # Outside there is 0, which is to be the background.
    apart = nearest((BACKGROUND - batch["mask"].to(seen.depth))[:, None])
    batch["true"] = true[:, 0]
    batch["mask"] = (BACKGROUND - apart[:, 0]).round().to(torch.uint8)
    return Seen(color.clamp(0, 1), nearest(seen.depth) / smaller, batch)


def _motions(count: int) -> tuple[Tensor, Tensor]:
    """(count, 2, 2) what becomes of points (x, y) at z = 1, and (count,) the enlargement in it."""
    scale = 1 + (_LARGEST - 1) * torch.rand(count)
    angle = _TURN * (2 * torch.rand(count) - 1)
    side = 1 - 2 * (torch.rand(count) < 0.5).float()
    cosine, sine = scale * angle.cos(), scale * angle.sin()
    rows = (torch.stack([side * cosine, -sine], 1), torch.stack([side * sine, cosine], 1))
    return torch.stack(rows, dim=1), scale


def _sources(motion: Tensor, K: Tensor, h: int, w: int) -> Tensor:
    """(b, h, w, 2) from which place (u, v) of the image every pixel comes."""
    v, u = torch.meshgrid(
        torch.arange(h, dtype=K.dtype, device=K.device),
        torch.arange(w, dtype=K.dtype, device=K.device),
        indexing="ij",
    )
    centre = K[:, :2, 2][:, None, None]
    focal = torch.stack([K[:, 0, 0], K[:, 1, 1]], dim=1)[:, None, None]
    points = (torch.stack([u, v], dim=2) - centre) / focal
    back = torch.linalg.inv(motion)
    return torch.einsum("bij,bhwj->bhwi", back, points) * focal + centre
