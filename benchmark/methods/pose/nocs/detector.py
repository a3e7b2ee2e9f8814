"""Anchor-free detection of boxes (FCOS, Tian et al., ICCV 2019), in place of Mask R-CNN.

Every pixel of the pyramid predicts the class, the distances to the edges of the box, and its
centredness. Boxes are (x0, y0, x1, y1) in pixels with centres at integers; the edges of an image of
width w are -0.5 and w - 0.5. Also crops regions out of features and pastes masks into images.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample

from benchmark.methods.pose.nocs.nocs_backbone import CLASSES, NOCSConfig

_CELLS = 14.0  # a region is cut out of the level on which it is about so many pixels wide

_SAMPLES = 2  # in each direction of a cell; their mean counts

LEVELS = (1, 2, 3)  # of the pyramid: those at 1/8, 1/16 and 1/32 of the image

_RARE = 0.01  # chance of an object at a pixel that the network begins with

_FARTHEST = 8.0  # powers of e: keeps the first steps of a training finite

_CANDIDATES = 200  # of an image


class Regions(NamedTuple):
    """Where objects are, best first within an image.

    Attributes:
        boxes: (n, 4) pixels.
        image: (n,) which image of the batch each is of.
        class_ids: (n,) 1 to 7.
        scores: (n,) in [0, 1]; 1 of those that are given.
        ids: (n,) instance ids in the mask of their image; -1 of those that are found.
    """

    boxes: Tensor
    image: Tensor
    class_ids: Tensor
    scores: Tensor
    ids: Tensor


def cut_out(
    levels: Sequence[Tensor], boxes: Tensor, image: Tensor, strides: Sequence[int], side: int
) -> Tensor:
    """Features of regions (RoIAlign of Mask R-CNN, He et al., ICCV 2017).

    Args:
        levels: (b, c, h, w) of the pyramid.
        boxes: (n, 4).
        image: (n,) which image each is of.
        strides: pixels of the image per pixel of each level.
        side: of the result, in cells.

    Returns:
        (n, c, side, side).
    """
    found = levels[0].new_zeros(len(boxes), levels[0].shape[1], side, side)
    of_level = level_of(boxes, strides)
    # Samples at the middles of a finer grid; each cell takes the mean of its own.
    grids = grid_of(boxes, side * _SAMPLES, _image_size(levels[0], strides[0]))
    for number, level in enumerate(levels):
        for b in range(len(level)):
            chosen = ((of_level == number) & (image == b)).nonzero()[:, 0]
            if not len(chosen):
                continue
            # In full precision: half floats place a sample no better than to some pixels.
            grid = grids[chosen].flatten(0, 1)[None].float()
            whole = level[b : b + 1].float()
            fine = grid_sample(whole, grid, padding_mode="border", align_corners=False)
            cells = fine[0].reshape(-1, len(chosen), side, _SAMPLES, side, _SAMPLES).mean((3, 5))
            found = found.index_copy(0, chosen, cells.transpose(0, 1).to(found.dtype))
    return found


def level_of(boxes: Tensor, strides: Sequence[int]) -> Tensor:
    """(n,) the level that each region is cut out of: 224 pixels from stride 16, as published."""
    size = ((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])).clamp(min=1).sqrt()
    level = torch.log2(size / _CELLS).floor() - math.log2(strides[0])
    return level.long().clamp(0, len(strides) - 1)


def grid_of(boxes: Tensor, side: int, size: tuple[int, int]) -> Tensor:
    """(n, side, side, 2) x and y of the middles of a region's cells, for `grid_sample`.

    Args:
        size: (width, height) of the image.
    """
    x, y = cell_middles(boxes, side)
    across = (2 * x + 1) / size[0] - 1
    down = (2 * y + 1) / size[1] - 1
    n = len(boxes)
    return torch.stack(
        [across[:, None].expand(n, side, side), down[:, :, None].expand(n, side, side)], dim=-1
    )


def cell_middles(boxes: Tensor, side: int) -> tuple[Tensor, Tensor]:
    """(n, side) x and (n, side) y of the middles of each region's cells, pixels."""
    share = (torch.arange(side, device=boxes.device) + 0.5) / side
    x = boxes[:, 0:1] + (boxes[:, 2:3] - boxes[:, 0:1]) * share
    y = boxes[:, 1:2] + (boxes[:, 3:4] - boxes[:, 1:2]) * share
    return x, y


def nearest_pixels(boxes: Tensor, image: Tensor, maps: Tensor, side: int) -> Tensor:
    """What maps hold at the pixels nearest to the middles of regions' cells.

    Args:
        boxes, image: as in `cut_out`.
        maps: (b, h, w, ...).

    Returns:
        (n, side, side, ...).
    """
    h, w = maps.shape[1:3]
    x, y = (middles.round().long() for middles in cell_middles(boxes, side))
    return maps[image[:, None, None], y.clamp(0, h - 1)[:, :, None], x.clamp(0, w - 1)[:, None]]


def put_back(values: Tensor, boxes: Tensor, size: tuple[int, int], mode: str) -> Tensor:
    """Regions in their images, 0 outside of the boxes.

    Args:
        values: (n, c, side, side).
        boxes: (n, 4).
        size: (width, height) of the image.
        mode: `bilinear` or `nearest`.

    Returns:
        (n, c, height, width).
    """
    w, h = size
    x = torch.arange(w, device=boxes.device, dtype=boxes.dtype)
    y = torch.arange(h, device=boxes.device, dtype=boxes.dtype)
    wide = (boxes[:, 2:3] - boxes[:, 0:1]).clamp(min=1e-3)
    high = (boxes[:, 3:4] - boxes[:, 1:2]).clamp(min=1e-3)
    across = 2 * (x[None] - boxes[:, 0:1]) / wide - 1
    down = 2 * (y[None] - boxes[:, 1:2]) / high - 1
    n = len(boxes)
    grid = torch.stack([across[:, None].expand(n, h, w), down[:, :, None].expand(n, h, w)], dim=-1)
    inside = (grid.abs() <= 1).all(dim=-1)[:, None]
    found = grid_sample(
        values.float(), grid.float(), mode=mode, padding_mode="border", align_corners=False
    )
    return found * inside


def boxes_of_ids(mask: Tensor) -> tuple[Tensor, Tensor]:
    """Boxes around the pixels of every id of masks.

    Args:
        mask: (b, h, w) uint8.

    Returns:
        (b, 256, 4) boxes, edges of pixels, and (b, 256) numbers of pixels; boxes of ids that there
        are not mean nothing.
    """
    b, h, w = mask.shape
    index = mask.flatten(1).long()
    x = torch.arange(w, device=mask.device).float().expand(b, h, w).flatten(1)
    y = torch.arange(h, device=mask.device).float()[:, None].expand(b, h, w).flatten(1)
    edges = [
        torch.zeros(b, 256, device=mask.device).scatter_reduce(
            1, index, values, reduce, include_self=False
        )
        for values, reduce in ((x, "amin"), (y, "amin"), (x, "amax"), (y, "amax"))
    ]
    counts = torch.zeros(b, 256, device=mask.device).scatter_add(1, index, torch.ones_like(x))
    half = torch.tensor([-0.5, -0.5, 0.5, 0.5], device=mask.device)
    return torch.stack(edges, dim=-1) + half, counts


def _image_size(level: Tensor, stride: int) -> tuple[int, int]:
    return level.shape[-1] * stride, level.shape[-2] * stride


class Boxes(NamedTuple):
    """What the detector says of every place of its levels, P in all.

    Attributes:
        classes: (b, P, 7) logits.
        edges: (b, P, 4) left, top, right, bottom distances to the edges, pixels.
        middles: (b, P) logits of being near the middle.
        places: (P, 2) x and y, pixels.
        strides: (P,) pixels between places of this level.
    """

    classes: Tensor
    edges: Tensor
    middles: Tensor
    places: Tensor
    strides: Tensor


class Detector(nn.Module):
    """Features of the levels to `Boxes`; all levels share it."""

    def __init__(self, config: NOCSConfig) -> None:
        super().__init__()
        wide = config.pyramid
        self.of_class = _tower(wide, config.tower)
        self.of_box = _tower(wide, config.tower)
        self.classes = nn.Conv2d(wide, CLASSES, 3, padding=1)
        self.edges = nn.Conv2d(wide, 4, 3, padding=1)
        self.middle = nn.Conv2d(wide, 1, 3, padding=1)
        self.scales = nn.Parameter(torch.zeros(len(LEVELS)))
        for layer in (self.classes, self.edges, self.middle):
            nn.init.normal_(layer.weight, std=0.01)
        self.middle.bias = nn.Parameter(torch.zeros(1))
        self.classes.bias = nn.Parameter(torch.full((CLASSES,), -math.log((1 - _RARE) / _RARE)))
        self.edges.bias = nn.Parameter(torch.ones(4))  # objects are some places wide

    def forward(self, levels: Sequence[Tensor], strides: Sequence[int]) -> Boxes:
        """(b, c, h, w) features of `LEVELS`, and their strides."""
        classes, edges, middles, places, spacing = [], [], [], [], []
        for number, (level, stride) in enumerate(zip(levels, strides, strict=True)):
            of_class, of_box = self.of_class(level), self.of_box(level)
            classes.append(self.classes(of_class).float().flatten(2))
            far = (self.edges(of_box).float() + self.scales[number]).clamp(max=_FARTHEST).exp()
            edges.append(far.flatten(2) * stride)
            middles.append(self.middle(of_box).float().flatten(2))
            where = places_of(level.shape[-2], level.shape[-1], stride, level.device)
            places.append(where)
            spacing.append(torch.full((len(where),), stride, device=level.device))
        return Boxes(
            torch.cat(classes, 2).transpose(1, 2),
            torch.cat(edges, 2).transpose(1, 2),
            torch.cat(middles, 2)[:, 0],
            torch.cat(places),
            torch.cat(spacing),
        )


def places_of(h: int, w: int, stride: int, device: torch.device) -> Tensor:
    """(h * w, 2) x and y in the image of a level's pixels."""
    y, x = torch.meshgrid(
        torch.arange(h, device=device), torch.arange(w, device=device), indexing="ij"
    )
    return (torch.stack([x, y], dim=-1).flatten(0, 1) + 0.5) * stride - 0.5


def boxes_of(edges: Tensor, places: Tensor) -> Tensor:
    """(..., 4) boxes of distances from places to the edges."""
    x, y = places.unbind(-1)
    left, top, right, bottom = edges.unbind(-1)
    return torch.stack([x - left, y - top, x + right, y + bottom], dim=-1)


def detections_of(found: Boxes, config: NOCSConfig, size: tuple[int, int]) -> Regions:
    """What was found, without doubles.

    Args:
        size: (width, height) that boxes are limited to.
    """
    scores = (found.classes.sigmoid() * found.middles.sigmoid()[..., None]).sqrt()
    w, h = size
    low = found.edges.new_tensor([-0.5, -0.5, -0.5, -0.5])
    high = found.edges.new_tensor([w - 0.5, h - 0.5, w - 0.5, h - 0.5])
    parts = []
    for b in range(len(scores)):
        flat = scores[b].flatten()
        best, order = flat.topk(min(_CANDIDATES, len(flat)))
        order = order[best > config.least_score]
        place, class_id = order // CLASSES, order % CLASSES
        boxes = boxes_of(found.edges[b, place], found.places[place])
        boxes = torch.minimum(torch.maximum(boxes, low), high)
        wide, tall = (boxes[:, 2] - boxes[:, 0]), (boxes[:, 3] - boxes[:, 1])
        real = (wide > 1) & (tall > 1)
        boxes, class_id, best = boxes[real], class_id[real], flat[order][real]
        kept = without_doubles(boxes, class_id, config.overlap)[: config.most]
        image, none = torch.full_like(kept, b), torch.full_like(kept, -1)
        parts.append((boxes[kept], image, class_id[kept] + 1, best[kept], none))
    return Regions(*(torch.cat(column) for column in zip(*parts, strict=True)))


def without_doubles(boxes: Tensor, class_ids: Tensor, overlap: float) -> Tensor:
    """Which boxes, best first, overlap no better one of their class by more than an IoU."""
    alike = (overlaps(boxes, boxes) > overlap) & (class_ids[:, None] == class_ids)
    kept: list[int] = []
    gone = torch.zeros(len(boxes), dtype=torch.bool, device=boxes.device)
    for index in range(len(boxes)):
        if not gone[index]:
            kept.append(index)
            gone |= alike[index]
    return torch.tensor(kept, dtype=torch.long, device=boxes.device)


def overlaps(one: Tensor, other: Tensor) -> Tensor:
    """(n, m) IoU of boxes."""
    low = torch.maximum(one[:, None, :2], other[None, :, :2])
    high = torch.minimum(one[:, None, 2:], other[None, :, 2:])
    both = (high - low).clamp(min=0).prod(dim=-1)
    areas = [(b[:, 2] - b[:, 0]) * (b[:, 3] - b[:, 1]) for b in (one, other)]
    return both / (areas[0][:, None] + areas[1] - both).clamp(min=1e-6)


def _tower(channels: int, convs: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for _ in range(convs):
        layers += [
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.GroupNorm(groups_of(channels), channels),
            nn.ReLU(),
        ]
    return nn.Sequential(*layers)


def groups_of(channels: int) -> int:
    """How many groups channels are normalised in: 32 at most, each of four channels at least: of a
    single number, as the coarsest level of a small image has it, there is nothing to normalise."""
    return math.gcd(32, max(1, channels // 4))
