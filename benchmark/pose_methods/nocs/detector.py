"""Boxes of objects without anchors (FCOS, Tian et al., ICCV 2019), in the place of Mask R-CNN's
two stages: every pixel of the pyramid says of which class the object there is, how far its edges
are, and how near its middle is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from benchmark.pose_methods.nocs.config import CLASSES, NOCSConfig
from benchmark.pose_methods.nocs.regions import Regions

LEVELS = (1, 2, 3)  # of the pyramid: those at 1/8, 1/16 and 1/32 of the image
_RARE = 0.01  # chance of an object at a pixel that the network begins with
_FARTHEST = 8.0  # powers of e: keeps the first steps of a training finite
_CANDIDATES = 200  # of an image


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
