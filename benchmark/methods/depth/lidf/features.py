"""Features of LIDF: colour, points by voxel, and positions.

Positions and directions are encoded as in Mildenhall et al., ECCV 2020. Also group-wise maximum and
softmax, and the sampling of measured pixels over the image.
"""

from functools import lru_cache

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, interpolate, max_pool2d, pad, relu

from benchmark.methods.depth.lidf.voxels import LIDFConfig
from benchmark.methods.resnet import residual_layer

_INPUTS = 6  # x, y, z from the voxel's centre, and colour

POSITION_WAVES = 8

DIRECTION_WAVES = 4

_BLOCK = 8

WINDOW = 8  # pixels, side of the surroundings of a pixel

BINS = 2  # by which it is divided, each way

_CELL = WINDOW // BINS


def largest_of_groups(values: Tensor, group: Tensor, count: int) -> Tensor:
    """The largest value of each group, channel by channel.

    Args:
        values: (n, c).
        group: (n,) int64 in [0, count).
        count: groups.

    Returns:
        (count, c); 0 for a group without members.
    """
    found = values.new_zeros(count, values.shape[1])
    index = group[:, None].expand_as(values)
    return found.scatter_reduce(0, index, values, "amax", include_self=False)


def log_softmax_of_groups(logits: Tensor, group: Tensor, count: int) -> Tensor:
    """(n,) logarithms of shares; the shares of each group add up to 1."""
    top = logits.new_full((count,), -torch.inf)
    top = top.scatter_reduce(0, group, logits.detach(), "amax")
    apart = logits - top[group]  # at most 0: the exponential stays finite
    total = logits.new_zeros(count).index_add(0, group, apart.exp())
    return apart - total[group].log()


def first_largest_of_groups(values: Tensor, group: Tensor, count: int) -> Tensor:
    """(count,) index of each group's first largest value; -1 for a group without members."""
    top = values.new_full((count,), -torch.inf).scatter_reduce(0, group, values, "amax")
    at = (values == top[group]).nonzero().squeeze(1)
    none = len(values)
    first = at.new_full((count,), none).scatter_reduce(0, group[at], at, "amin")
    return torch.where(first < none, first, -1)


class PointNet(nn.Module):
    """Features of voxels from their points.

    Args:
        channels: of the first layer; a voxel gets four times as many.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        c = channels
        self.one = nn.Sequential(nn.Linear(_INPUTS, c), nn.ReLU(), nn.Linear(c, 2 * c), nn.ReLU())
        self.of_voxel = nn.Linear(2 * c, 2 * c)
        self.two = nn.Sequential(
            nn.Linear(4 * c, 4 * c), nn.ReLU(), nn.Linear(4 * c, 4 * c), nn.ReLU()
        )
        self.last = nn.Linear(4 * c, 4 * c)

    def forward(self, points: Tensor, voxel: Tensor, count: int) -> Tensor:
        """(count, 4 channels) features.

        Args:
            points: (n, 6) x, y, z from the centre of the voxel, colour.
            voxel: (n,) which voxel each is in.
            count: voxels.
        """
        each = self.one(points)
        together = relu(self.of_voxel(largest_of_groups(each, voxel, count)))
        each = self.two(torch.cat([each, together[voxel]], dim=1))
        return relu(self.last(largest_of_groups(each, voxel, count)))


def encoded_size(waves: int) -> int:
    """Numbers that three become."""
    return 3 + 3 * 2 * waves


def encoded(numbers: Tensor, waves: int) -> Tensor:
    """(n, 3) numbers to (n, 3 + 6 waves): themselves, then sine and cosine of 1, 2, 4, ... times.

    As published, the numbers are not multiplied by pi.
    """
    sine, cosine = numbers.sin(), numbers.cos()
    parts = [numbers, sine, cosine]
    for _ in range(waves - 1):
        # Of the doubled angle; sines of every angle by themselves take a fifth of all the time.
        sine, cosine = 2 * sine * cosine, 1 - 2 * sine * sine
        parts += [sine, cosine]
    return torch.cat(parts, dim=1)


def spread(valid: Tensor, limit: int) -> Tensor:
    """Valid pixels, evenly over each image.

    From every block of 8x8 pixels one is taken, then a second far from the first, and so on. Where
    fewer than `limit` are valid all are taken; the published program repeats some to fill up,
    which changes nothing: only the largest features of a voxel count.

    Args:
        valid: (b, h, w) bool.
        limit: pixels per image, at most.

    Returns:
        (n,) indices into the flat batch, image by image.
    """
    b, h, w = valid.shape
    order = _order(h, w).to(valid.device)
    found = []
    for index in range(b):
        flat = valid[index].flatten()
        found.append(order[flat[order]][:limit] + index * h * w)
    return torch.cat(found)


@lru_cache(maxsize=4)
def _order(h: int, w: int) -> Tensor:
    """(h w,) flat pixels: first one of every block, then the second ones."""
    turns = _turns(_BLOCK).repeat(-(-h // _BLOCK), -(-w // _BLOCK))[:h, :w]
    return torch.argsort(turns.flatten(), stable=True)


def _turns(side: int) -> Tensor:
    """(side, side) order in which a block's pixels are taken: that of ordered dithering."""
    if side == 1:
        return torch.zeros(1, 1, dtype=torch.long)
    quarter = 4 * _turns(side // 2)
    return torch.cat(
        [torch.cat([quarter, quarter + 2], 1), torch.cat([quarter + 3, quarter + 1], 1)]
    )


class ColorNet(nn.Module):
    """A ResNet whose last two levels are dilated instead of coarser: an eighth of the image."""

    def __init__(self, config: LIDFConfig) -> None:
        super().__init__()
        c, blocks = config.channels, config.blocks
        self.conv1 = nn.Conv2d(3, c, 7, 2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(c)
        self.layer1 = residual_layer(c, c, blocks[0])
        self.layer2 = residual_layer(c, 2 * c, blocks[1], stride=2)
        self.layer3 = residual_layer(2 * c, 4 * c, blocks[2], dilation=2)
        self.layer4 = residual_layer(4 * c, 8 * c, blocks[3], dilation=4)
        self.last = nn.Conv2d(8 * c, config.color_features, 1)

    def forward(self, color: Tensor) -> Tensor:
        """(b, features, h, w) of (b, 3, h, w) colour, normalised."""
        features = relu(self.bn1(self.conv1(color)))
        features = max_pool2d(features, 3, 2, padding=1)
        for layer in (self.layer1, self.layer2, self.layer3, self.layer4, self.last):
            features = layer(features)
        size = color.shape[-2:]
        return interpolate(features, size=size, mode="bilinear", align_corners=False)


def cell_means(features: Tensor) -> Tensor:
    """Means over the cells that pixels' surroundings consist of.

    This is ROIAlign (He et al., ICCV 2017, aligned) of the window of 8x8 pixels that begins four
    pixels above and left of a pixel, in 2x2 bins: the window has whole coordinates, so that its
    samples lie on pixels, and a bin is the mean of 4x4 of them. Beyond the edges of the image its
    outermost pixels go on.

    Args:
        features: (b, c, h, w).

    Returns:
        (b, c, h + 4, w + 4), of which `surroundings` takes four for every pixel.
    """
    before, after = WINDOW // 2, WINDOW - WINDOW // 2 - 1
    return avg_pool2d(pad(features, (before, after, before, after), "replicate"), _CELL, 1)


def surroundings(means: Tensor, pixels: Tensor) -> Tensor:
    """Features of the surroundings of pixels.

    Args:
        means: (b, c, h + 4, w + 4), from `cell_means`.
        pixels: (r,) indices into the flat batch of h x w pixels.

    Returns:
        (r, 4 c): of each channel the four bins, row by row.
    """
    b, c, h, w = means.shape
    reach = WINDOW - _CELL
    image, row, column = places(pixels, h - reach, w - reach)
    flat = means.permute(0, 2, 3, 1).reshape(b * h * w, c)
    start = (image * h + row) * w + column
    bins = [flat[start + (i * w + j) * _CELL] for i in range(BINS) for j in range(BINS)]
    return torch.stack(bins, dim=2).flatten(1)


def places(pixels: Tensor, h: int, w: int) -> tuple[Tensor, Tensor, Tensor]:
    """Image, row and column of indices into a flat batch of h x w pixels."""
    return pixels // (h * w), pixels // w % h, pixels % w
