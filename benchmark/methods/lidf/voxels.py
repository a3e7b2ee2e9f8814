"""The voxels that hold measurements, and the rays that pass through them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from benchmark.methods.lidf.config import LIDFConfig

_TINY = 1e-9  # a ray that runs along a wall of a voxel: its component, which is divided by


class Grid:
    """A box of cubic voxels in the camera's frame.

    Args:
        config: the volume and the side of a voxel.
    """

    def __init__(self, config: LIDFConfig) -> None:
        self.side = config.voxel
        self.low = tuple(low - self.side / 2 for low in config.low)
        self.shape = tuple(
            round((high - low) / self.side) + 1
            for low, high in zip(config.low, config.high, strict=True)
        )
        self.cells = self.shape[0] * self.shape[1] * self.shape[2]

    def cells_of(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Which voxel each of (n, 3) points is in.

        Returns:
            (n,) int64 number of the voxel, the nearest one for a point outside the grid, and
            (n,) bool whether the point is inside.
        """
        places = ((points - points.new_tensor(self.low)) / self.side).floor()
        shape = points.new_tensor(self.shape)
        inside = ((places >= 0) & (places < shape)).all(dim=1)
        x, y, z = places.clamp(min=0).minimum(shape - 1).long().unbind(dim=1)
        return (x * self.shape[1] + y) * self.shape[2] + z, inside

    def corners(self, cells: Tensor) -> Tensor:
        """(n, 3) metres, the corner of smallest x, y and z of voxels by their number."""
        _, ny, nz = self.shape
        places = torch.stack([cells // (ny * nz), cells // nz % ny, cells % nz], dim=1)
        low = torch.tensor(self.low, device=cells.device)
        return low + places * self.side


class Voxels(NamedTuple):
    """The voxels of a batch that hold points, image by image.

    Attributes:
        image: (v,) which image of the batch.
        corner: (v, 3) metres, the corner of smallest x, y and z.
    """

    image: Tensor
    corner: Tensor


def occupied(grid: Grid, points: Tensor, image: Tensor) -> tuple[Voxels, Tensor]:
    """The voxels that hold points.

    Args:
        grid: its voxels.
        points: (n, 3) metres.
        image: (n,) which image of the batch each is of.

    Returns:
        The voxels, in the order of images, and (n,) which of them each point is in. Points outside
        the grid count for the nearest voxel.
    """
    cells, _ = grid.cells_of(points)
    keys, voxel = torch.unique(image * grid.cells + cells, return_inverse=True)
    return Voxels(keys // grid.cells, grid.corners(keys % grid.cells)), voxel


class Pairs(NamedTuple):
    """Rays and the voxels that they pass through, ray by ray.

    Attributes:
        ray, voxel: (p,) which ones.
        entry, exit: (p,) metres along the ray; the entry is negative in the camera's own voxel.
    """

    ray: Tensor
    voxel: Tensor
    entry: Tensor
    exit: Tensor


@torch.no_grad()
def passed(directions: Tensor, image: Tensor, voxels: Voxels, side: float) -> Pairs:
    """Which voxels of its image each ray passes through; touching an edge is not passing.

    Args:
        directions: (r, 3) unit vectors from the camera.
        image: (r,) which image of the batch, in rising order.
        voxels: of the batch.
        side: metres, of a voxel.
    """
    parts = []
    for of_image in image.unique().tolist():
        rays = (image == of_image).nonzero().squeeze(1)
        of_voxels = (voxels.image == of_image).nonzero().squeeze(1)
        entry, leave = _slabs(directions[rays], voxels.corner[of_voxels], side)
        ray, voxel = (leave > entry.clamp(min=0)).nonzero(as_tuple=True)
        parts.append((rays[ray], of_voxels[voxel], entry[ray, voxel], leave[ray, voxel]))
    if not parts:
        none = image.new_zeros(0)
        return Pairs(none, none, directions.new_zeros(0), directions.new_zeros(0))
    return Pairs(*(torch.cat(columns) for columns in zip(*parts, strict=True)))


def _slabs(directions: Tensor, corner: Tensor, side: float) -> tuple[Tensor, Tensor]:
    """(r, v) distances at which rays enter and leave boxes: by the pairs of parallel walls."""
    slow = directions.abs() < _TINY
    inverse = 1 / torch.where(slow, _TINY, directions)
    entry: Tensor | None = None
    leave: Tensor | None = None
    for axis in range(3):
        first = inverse[:, axis, None] * corner[:, axis]
        second = inverse[:, axis, None] * (corner[:, axis] + side)
        near, far = first.minimum(second), first.maximum(second)
        entry = near if entry is None else entry.maximum(near)
        leave = far if leave is None else leave.minimum(far)
    assert entry is not None and leave is not None
    return entry, leave
