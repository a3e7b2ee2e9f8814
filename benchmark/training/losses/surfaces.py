"""Slopes and normals of depth maps, and where they are known."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import conv2d, max_pool2d, pad

_SOBEL = ((-1.0, 0.0, 1.0), (-2.0, 0.0, 2.0), (-1.0, 0.0, 1.0))
_SMALLEST = 1e-8  # square metres: keeps the length of a cross product from being 0


def sobel(images: Tensor) -> Tensor:
    """Slopes to the right and downwards: the 3x3 Sobel sums, not divided by anything.

    Args:
        images: (b, 1, h, w), taken as 0 outside.

    Returns:
        (b, 2, h, w).
    """
    right = images.new_tensor(_SOBEL)
    return conv2d(images, torch.stack([right, right.T])[:, None], padding=1)


def normals(depth: Tensor, K: Tensor) -> Tensor:
    """Unit normals, from the differences to the points behind the next pixels right and below.

    Args:
        depth: (b, 1, h, w) metres.
        K: (b, 3, 3) intrinsics.

    Returns:
        (b, 3, h, w), away from the camera where depth is positive. The last row and column repeat
        their neighbours.
    """
    at = points(depth, K)
    here = at[..., :-1, :-1]
    to_right, below = at[..., :-1, 1:] - here, at[..., 1:, :-1] - here
    across = torch.linalg.cross(to_right, below, dim=1)
    # Under the root, so that the gradient of a length of 0 is 0 and not NaN.
    length = (across.square().sum(dim=1, keepdim=True) + _SMALLEST**2).sqrt()
    return pad(across / length, (0, 1, 0, 1), mode="replicate")


def whole_around(known: Tensor) -> Tensor:
    """(b, 1, h, w) bool: pixels whose 3x3 surroundings are known, as far as the image goes."""
    unknown = (~known).to(torch.float32)
    return max_pool2d(unknown, 3, stride=1, padding=1) == 0


def points(depth: Tensor, K: Tensor) -> Tensor:
    """(b, 3, h, w) points in the camera frame."""
    h, w = depth.shape[-2:]
    v, u = torch.meshgrid(
        torch.arange(h, dtype=depth.dtype, device=depth.device),
        torch.arange(w, dtype=depth.dtype, device=depth.device),
        indexing="ij",
    )
    K = K.to(depth.dtype)
    fx, fy, cx, cy = (K[:, i, j, None, None] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    z = depth[:, 0]
    return torch.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], dim=1)
