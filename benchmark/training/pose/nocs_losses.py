"""Losses of NOCS and of SwinDRNet's pose network (Dai et al., ECCV 2022, and its code).

For a symmetric object, the loss uses the equivalent coordinates with the smallest error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import (
    binary_cross_entropy_with_logits,
    cross_entropy,
    log_softmax,
    smooth_l1_loss,
)

from benchmark.data.frame import BACKGROUND
from benchmark.methods.pose.nocs.detector import Boxes, Regions, boxes_of, nearest_pixels
from benchmark.methods.pose.nocs.nocs import NOCSPrediction
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import SwinNOCSPrediction
from benchmark.training.step import Loss, mean_where, weighted_mean

TURNS = 6  # about y, 60 degrees apart, as published for NOCS and for SwinDRNet's pose network

ROUND = (1, 2, 4)  # bottle, bowl, can; a mug counts by its handle in both published losses

BEND = 0.1  # where the loss of coordinates goes from squares to differences

_ALPHA, _GAMMA = 0.25, 2  # of the focal loss (Lin et al., ICCV 2017)

_NEAR = 1.5  # strides around an object's middle that answer for it

_WIDTHS = 8  # strides that an object is wide at most on its level

_IDS = 256

_MIDDLE_UNIT = 32.0  # pixels that count as 1 in the error of a middle


def is_round(classes: Tensor) -> Tensor:
    """Bool, of the same shape: which class numbers look the same after a turn about y."""
    found = torch.zeros_like(classes, dtype=torch.bool)
    for one in ROUND:
        found |= classes == one
    return found


def turned(nocs: Tensor, turn: Tensor, dim: int) -> Tensor:
    """Normalised coordinates after turns about y through the cube's middle.

    Args:
        nocs: x, y, z in [0, 1] along dimension `dim`.
        turn: which of `TURNS`, of the shape of `nocs` without `dim`, or a scalar.
    """
    angle = turn.to(nocs.dtype) * (2 * math.pi / TURNS)
    cos, sin = angle.cos(), angle.sin()
    x, y, z = (nocs.select(dim, i) for i in range(3))
    x, z = x - 0.5, z - 0.5
    return torch.stack([cos * x + sin * z + 0.5, y, cos * z - sin * x + 0.5], dim=dim)


@torch.no_grad()
def nearest_turn(found: Tensor, true: Tensor, group: Tensor, loose: Tensor) -> Tensor:
    """The true coordinates after the turn that brings each group of pixels nearest to what was
    found.

    Args:
        found, true: (b, 3, h, w) coordinates.
        group: (b, h, w) int64 numbers of groups from 0, such as instances.
        loose: (b, h, w) bool pixels of objects that may be turned.

    Returns:
        (b, 3, h, w): `true` where `loose` is not.
    """
    groups = int(group.max()) + 1 if group.numel() else 0
    costs = []
    for number in range(TURNS):
        turn = torch.tensor(number, device=true.device)
        apart = smooth_l1_loss(found, turned(true, turn, 1), reduction="none", beta=BEND)
        cost = apart.sum(dim=1).masked_fill(~loose, 0.0).double()
        total = torch.zeros(groups, dtype=cost.dtype, device=cost.device)
        costs.append(total.index_add(0, group.flatten(), cost.flatten()))
    best = torch.stack(costs).argmin(dim=0)[group]
    return torch.where(loose[:, None], turned(true, best, 1), true)


class NOCSTarget(NamedTuple):
    """What the network should have answered.

    Attributes:
        objects: all objects of a class, with their exact boxes.
        pose: classes and coordinates of pixels.
    """

    objects: Regions
    pose: PoseTarget


class Assigned(NamedTuple):
    """What places of an image should say.

    Attributes:
        classes: (P,) 1 to 7, 0 for nothing.
        edges: (P, 4) distances to the edges of the object's box, pixels.
    """

    classes: Tensor
    edges: Tensor


@dataclass(frozen=True, kw_only=True)
class NOCSLoss:
    """Sum of five parts: classes, boxes and middles of the detector, masks, coordinates.

    Coordinates: cross entropy of the bins of x, y and z, over the pixels of an object, then over
    the objects. Of bottles, bowls and cans the turn of six with the least one counts, for each
    object. What of these parts weighs how much is not published but for that they are equal.

    Attributes:
        classes, boxes, middles, masks, coordinates: weights.
        jitter: share of its size by which the box of an object is moved and resized at random
            before masks and coordinates are learnt in it, as found boxes are off.
        least_pixels: smaller objects are not learnt.
    """

    classes: float = 1.0
    boxes: float = 1.0
    middles: float = 1.0
    masks: float = 1.0
    coordinates: float = 1.0
    jitter: float = 0.1
    least_pixels: int = 10

    def __call__(self, prediction: NOCSPrediction, target: NOCSTarget) -> Loss:
        classes, boxes, middles = detection_loss(prediction.boxes, target.objects)
        masks = self._masks(prediction, target.pose)
        coordinates = self._coordinates(prediction, target.pose)
        total = (
            self.classes * classes
            + self.boxes * boxes
            + self.middles * middles
            + self.masks * masks
            + self.coordinates * coordinates
        )
        parts = {
            "classes": classes,
            "boxes": boxes,
            "middles": middles,
            "masks": masks,
            "coordinates": coordinates,
        }
        return Loss(total, {name: part.detach() for name, part in parts.items()})

    def _masks(self, prediction: NOCSPrediction, target: PoseTarget) -> Tensor:
        regions, logits = prediction.regions, prediction.masks
        inside = _inside(regions, target, logits.shape[-1])
        wrong = binary_cross_entropy_with_logits(logits, inside.to(logits.dtype), reduction="none")
        return wrong.sum() / max(1, wrong.numel())

    def _coordinates(self, prediction: NOCSPrediction, target: PoseTarget) -> Tensor:
        regions, bins = prediction.regions, prediction.bins
        n, _, count, side, _ = bins.shape
        maps = target.nocs.permute(0, 2, 3, 1)
        true = nearest_pixels(regions.boxes, regions.image, maps, side)  # (n, side, side, 3)
        known = nearest_pixels(regions.boxes, regions.image, target.known, side)
        inside = _inside(regions, target, side) & known
        pixels = inside.sum(dim=(1, 2)).clamp(min=1)
        chances = log_softmax(bins, dim=2)
        loose = is_round(regions.class_ids)
        costs = []
        for number in range(TURNS):
            # Objects that are not round do not turn: all six are the same.
            turn = (loose.long() * number)[:, None, None].expand(n, side, side)
            wanted = bin_of(turned(true, turn, 3), count).permute(0, 3, 1, 2)[:, :, None]
            entropy = -chances.gather(2, wanted)[:, :, 0].sum(dim=1)
            costs.append(entropy.masked_fill(~inside, 0.0).sum(dim=(1, 2)) / pixels)
        least = torch.stack(costs).amin(dim=0)
        return least.sum() / max(1, n)


def bin_of(coordinates: Tensor, count: int) -> Tensor:
    """Numbers of the bins that coordinates are in, as published: the upper edge belongs to it."""
    return (coordinates * count - 1e-6).floor().long().clamp(0, count - 1)


def detection_loss(boxes: Boxes, objects: Regions) -> tuple[Tensor, Tensor, Tensor]:
    """Losses of classes, boxes and middles; sums over the batch by its places with an object."""
    logits = boxes.classes
    wanted = torch.zeros_like(logits)
    classes, edges = [], []
    for b in range(len(logits)):
        mine = objects.image == b
        assigned = assign(boxes.places, boxes.strides, objects.boxes[mine], objects.class_ids[mine])
        classes.append(assigned.classes)
        edges.append(assigned.edges)
    there = torch.stack(classes)
    positive = there > 0
    wanted[positive, there[positive] - 1] = 1.0
    count = positive.sum().clamp(min=1)
    focal = focal_loss(logits, wanted).sum() / count

    true = torch.stack(edges)[positive]
    found = boxes.edges[positive]
    places = boxes.places.expand(*positive.shape, 2)[positive].to(found.dtype)
    middle = middle_of(true)
    apart = 1 - generalised_overlap(boxes_of(found, places), boxes_of(true, places))
    off = (apart * middle).sum() / middle.sum().clamp(min=1e-6)
    near = binary_cross_entropy_with_logits(boxes.middles[positive], middle, reduction="sum")
    return focal, off, near / count


def assign(places: Tensor, strides: Tensor, boxes: Tensor, class_ids: Tensor) -> Assigned:
    """Which object each place of an image answers for: the smallest whose middle is near, and
    that is as large as objects of the place's level are.

    Args:
        places: (P, 2) x and y.
        strides: (P,) pixels between places of the same level.
        boxes, class_ids: (m, 4) and (m,) of the objects.
    """
    if not len(boxes):
        return Assigned(torch.zeros_like(strides), places.new_zeros(len(places), 4))
    low = places[:, None] - boxes[None, :, :2]
    high = boxes[None, :, 2:] - places[:, None]
    edges = torch.cat([low, high], dim=-1)  # (P, m, 4)
    off = (places[:, None] - (boxes[None, :, :2] + boxes[None, :, 2:]) / 2).abs().amax(dim=-1)
    width = edges.amax(dim=-1)
    step = strides[:, None].to(width.dtype)
    finest, coarsest = strides.min(), strides.max()
    least = torch.where(step == finest, 0.0, _WIDTHS / 2 * step)
    most = torch.where(step == coarsest, torch.inf, _WIDTHS * step)
    fits = (edges.amin(dim=-1) > 0) & (off < _NEAR * step) & (width >= least) & (width < most)
    area = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    smallest, which = torch.where(fits, area, torch.inf).min(dim=1)
    classes = torch.where(smallest.isfinite(), class_ids[which], 0)
    return Assigned(classes, edges[torch.arange(len(places), device=places.device), which])


def focal_loss(logits: Tensor, wanted: Tensor) -> Tensor:
    """Cross entropy of yes and no, less of what is easy, of the shape of `logits`."""
    entropy = binary_cross_entropy_with_logits(logits, wanted, reduction="none")
    chance = logits.sigmoid()
    missed = torch.where(wanted > 0, 1 - chance, chance)
    return torch.where(wanted > 0, _ALPHA, 1 - _ALPHA) * missed**_GAMMA * entropy


def middle_of(edges: Tensor) -> Tensor:
    """(n,) 1 in the middle of a box, 0 at its edges, of (n, 4) distances to the edges."""
    left, top, right, bottom = edges.unbind(-1)
    across = torch.minimum(left, right) / torch.maximum(left, right)
    down = torch.minimum(top, bottom) / torch.maximum(top, bottom)
    return (across * down).clamp(min=0).sqrt()


def generalised_overlap(one: Tensor, other: Tensor) -> Tensor:
    """(n,) IoU of boxes, less the share of their common box that is in neither
    (Rezatofighi et al., CVPR 2019)."""
    low, high = torch.maximum(one[:, :2], other[:, :2]), torch.minimum(one[:, 2:], other[:, 2:])
    both = (high - low).clamp(min=0).prod(dim=-1)
    area = (one[:, 2:] - one[:, :2]).prod(dim=-1) + (other[:, 2:] - other[:, :2]).prod(dim=-1)
    either = (area - both).clamp(min=1e-6)
    around = torch.maximum(one[:, 2:], other[:, 2:]) - torch.minimum(one[:, :2], other[:, :2])
    whole = around.prod(dim=-1).clamp(min=1e-6)
    return both / either - (whole - either) / whole


def _inside(regions: Regions, target: PoseTarget, side: int) -> Tensor:
    """(n, side, side) bool cells whose nearest pixel is of the region's object."""
    ids = nearest_pixels(regions.boxes, regions.image, target.mask, side)
    return ids.long() == regions.ids[:, None, None]


class PoseTarget(NamedTuple):
    """What a pose network should have answered.

    Attributes:
        classes: (b, h, w) int64: 0 other, 1 to 7 the classes, 8 background.
        nocs: (b, 3, h, w) normalised coordinates, in [0, 1].
        known: (b, h, w) bool pixels of objects of a class, whose coordinates are known.
        mask: (b, h, w) uint8 instance ids.
    """

    classes: Tensor
    nocs: Tensor
    known: Tensor
    mask: Tensor


@dataclass(frozen=True, kw_only=True)
class SwinNOCSLoss:
    """Cross entropy of the classes, over all pixels, + `coordinates` * (smooth L1 of x, y and z +
    `distance` * root of the mean squared distance), over the pixels of objects of a class; of a
    network that says where middles are also `middles` * smooth L1 of these, over the pixels of all
    objects, in shares of 32 pixels.

    Of bottles, bowls and cans the turn of six counts that is nearest to the answer.

    Attributes:
        classes, coordinates, distance: weights; the published ones.
        turns: whether every `instance` is turned for itself, or all of an `image` together, as in
            the authors' program, which two round objects contradict.
        objects: how many times as much a pixel of an object counts as others, for the classes.
        middles: weight of the middles.
    """

    classes: float = 1.0
    coordinates: float = 3.0
    distance: float = 1.0
    turns: Literal["instance", "image"] = "instance"
    objects: float = 1.0
    middles: float = 1.0

    def __call__(self, prediction: SwinNOCSPrediction, target: PoseTarget) -> Loss:
        there = target.mask != BACKGROUND
        counts = there.to(prediction.classes.dtype) * (self.objects - 1) + 1
        entropy = weighted_mean(
            cross_entropy(prediction.classes, target.classes, reduction="none"), counts
        )
        image = torch.arange(len(target.mask), device=target.mask.device)[:, None, None]
        group = image.expand(target.mask.shape)
        if self.turns == "instance":
            group = group * _IDS + target.mask.long()
        loose = is_round(target.classes) & target.known
        true = nearest_turn(prediction.nocs, target.nocs, group, loose)
        apart = smooth_l1_loss(prediction.nocs, true, reduction="none", beta=BEND).sum(dim=1)
        smooth = mean_where(apart, target.known)
        square = mean_where((prediction.nocs - true).square().sum(dim=1), target.known)
        # The root's gradient is infinite at 0, where a batch without objects is.
        root = square.clamp(min=1e-12).sqrt()
        total = self.classes * entropy + self.coordinates * (smooth + self.distance * root)
        parts = {"classes": entropy, "smooth": smooth, "distance": root}
        if prediction.middles is not None:
            off = smooth_l1_loss(
                prediction.middles / _MIDDLE_UNIT,
                to_middles(target.mask) / _MIDDLE_UNIT,
                reduction="none",
                beta=BEND,
            )
            parts["middles"] = mean_where(off.sum(dim=1), there)
            total = total + self.middles * parts["middles"]
        return Loss(total, {name: part.detach() for name, part in parts.items()})


def to_middles(mask: Tensor) -> Tensor:
    """(b, 2, h, w) from each pixel of (b, h, w) uint8 instance ids to the mean place of the
    instance's pixels, x and y in pixels."""
    b, h, w = mask.shape
    ids = mask.flatten(1).long()
    v, u = torch.meshgrid(
        torch.arange(h, device=mask.device), torch.arange(w, device=mask.device), indexing="ij"
    )
    places = torch.stack([u, v]).flatten(1).float().expand(b, 2, h * w)
    sums = torch.zeros(b, 2, _IDS, device=mask.device)
    sums.scatter_add_(2, ids[:, None].expand(-1, 2, -1), places)
    counts = torch.zeros(b, _IDS, device=mask.device)
    counts.scatter_add_(1, ids, torch.ones_like(places[:, 0]))
    means = sums / counts.clamp(min=1)[:, None]
    return (means.gather(2, ids[:, None].expand(-1, 2, -1)) - places).unflatten(2, (h, w))
