"""Points behind the pixels of pinhole images, in torch: batched and differentiable.

`Camera` computes in float64 NumPy; networks and losses take its K at their image size.
"""

import torch
from torch import Tensor


def points_of(depth: Tensor, K: Tensor) -> Tensor:
    """(b, 3, h, w) points in the camera frame, metres; 0 where there is no depth.

    Args:
        depth: (b, 1, h, w) metres.
        K: (b, 3, 3) intrinsics at this size.
    """
    h, w = depth.shape[-2:]
    K = K.to(depth.dtype)
    v = torch.arange(h, dtype=depth.dtype, device=depth.device)[:, None]
    u = torch.arange(w, dtype=depth.dtype, device=depth.device)
    fx, fy, cx, cy = (K[:, i, j, None, None] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    z = depth[:, 0]
    return torch.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], dim=1)


def points_at(column: Tensor, row: Tensor, z: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
    """x and y (N,), metres, of the points at z-depth `z` (N,) behind pixels of one image.

    Args:
        column, row: (N,) pixels.
        z: metres.
        K: (3, 3) intrinsics.
    """
    return (column - K[0, 2]) * z / K[0, 0], (row - K[1, 2]) * z / K[1, 1]
