"""LIDF's configuration, its voxels, and the rays that cross them.

Also selects the pixels to restore and collects the inputs of their rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from std_toolkit.errors import ToolkitError

_TINY = 1e-9  # a ray that runs along a wall of a voxel: its component, which is divided by


@dataclass(frozen=True, kw_only=True)
class LIDFConfig:
    """LIDF; the defaults are the published network.

    Attributes:
        predict: `all` predicts every pixel, as the published evaluation does; `missing` keeps
            what the sensor measured and is believed.
        mask: what is believed. `objects` drops the measurements on transparent and specular
            objects, which the method must be told, as in the published evaluation; `holes`
            believes all measurements.
        clipped: whether the scores by which a ray chooses its voxel are clipped to [0, 1], leakily,
            before the softmax. The authors' program does this; the paper does not mention it.
        refine: whether the second stage follows the first.
        channels: of the first level of the network for colour.
        blocks: of its four levels; those of ResNet-34.
        color_features: channels that it gives every pixel.
        point_channels: of the network for points: of its first layer, the others have two and
            four times as many.
        head: widths of the three layers of a head.
        low, high: metres, x, y and z of the first and the last voxel's centre: the corners of the
            volume, which is half a voxel larger on every side.
        voxel: metres, side of a voxel.
        valid_points: measurements that an image's voxels are made of, at most.
        train_rays: pixels predicted per image in training, at most.
        rays_at_once: pixels predicted at once where nothing is learned; bounds the memory.
        refine_reach: metres that a step of the second stage can move a point either way.
        refine_steps: of the second stage.
        input_size: (width, height) of the images.

    Raises:
        ToolkitError: a size or number that must be positive and is not.
    """

    predict: Literal["all", "missing"] = "all"
    mask: Literal["objects", "holes"] = "objects"
    clipped: bool = False
    refine: bool = True
    channels: int = 64
    blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    color_features: int = 32
    point_channels: int = 32
    head: tuple[int, int, int] = (256, 128, 64)
    low: tuple[float, float, float] = (-1.0, -1.0, 0.0)
    high: tuple[float, float, float] = (1.0, 1.0, 2.0)
    voxel: float = 0.25
    valid_points: int = 10_000
    train_rays: int = 20_000
    rays_at_once: int = 8192
    refine_reach: float = 0.2
    refine_steps: int = 2
    input_size: tuple[int, int] = (320, 240)

    def __post_init__(self) -> None:
        for name in ("voxel", "valid_points", "train_rays", "rays_at_once"):
            value = getattr(self, name)
            if not value > 0:
                raise ToolkitError("must be positive", field=name, value=value)


PRESETS = {
    "published": LIDFConfig(),
    "compact": LIDFConfig(channels=32, blocks=(2, 2, 2, 2), head=(128, 64, 32)),
}


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


class Rays(NamedTuple):
    """Rays of pixels.

    Attributes:
        pixel: (r,) indices into the flat batch of images, in rising order.
        image: (r,) which image of the batch.
        direction: (r, 3) unit vectors.
        features: (r, c) of colour around the pixel, and of the direction.
    """

    pixel: Tensor
    image: Tensor
    direction: Tensor
    features: Tensor

    def chosen(self, which: Tensor | slice) -> Rays:
        """Some of them."""
        return Rays(*(part[which] for part in self))


class Terminations(NamedTuple):
    """What the first stage says of rays and of the voxels that they pass through.

    Attributes:
        rays: those predicted.
        pairs: of rays and voxels.
        log_probability: (p,) logarithms of the chance that the ray ends in the voxel; the chances
            of a ray add up to 1.
        offset: (p,) where in the voxel: 0 at the entry, 1 a voxel's diagonal behind it.
        points: (p, 3) metres, where the ray ends if it ends in the voxel.
        chosen: (r,) which pair each ray was taken to end in; -1 for one that passes no voxel.
        true: (r,) which pair the ray truly ends in; -1 where that is not known or none of them.
    """

    rays: Rays
    pairs: Pairs
    log_probability: Tensor
    offset: Tensor
    points: Tensor
    chosen: Tensor
    true: Tensor


class Refinements(NamedTuple):
    """What the second stage makes of the rays for which the first has an answer.

    Attributes:
        rays: those with an answer.
        points: (r, 3) metres: from the first stage, and after each step.
    """

    rays: Rays
    points: tuple[Tensor, ...]


def points_on(direction: Tensor, pairs: Pairs, offset: Tensor, diagonal: float) -> Tensor:
    """(p, 3) metres, the points at offsets within voxels.

    Args:
        direction: (r, 3) unit vectors of the rays.
        pairs: of rays and voxels.
        offset: (p,) from the entry into the voxel, in its diagonals.
        diagonal: metres, of a voxel.
    """
    return (pairs.entry + offset * diagonal)[:, None] * direction[pairs.ray]


def true_pairs(pairs: Pairs, distance: Tensor) -> Tensor:
    """(r,) which pair holds the point at a distance; -1 where none does.

    Args:
        pairs: of rays and voxels.
        distance: (r,) metres along the rays; 0 where it is not known.
    """
    at = distance[pairs.ray]
    holds = ((pairs.entry <= at) & (at < pairs.exit) & (at > 0)).nonzero().squeeze(1)
    found = torch.full_like(distance, -1, dtype=torch.long)
    found[pairs.ray[holds]] = holds
    return found
