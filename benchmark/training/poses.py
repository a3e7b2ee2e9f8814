"""How pose networks are trained: what a batch says of objects, and the steps."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from benchmark.data.frame import BACKGROUND
from benchmark.pose_methods.network import points_of
from benchmark.pose_methods.nocs.network import NOCSPrediction
from benchmark.pose_methods.nocs.regions import Regions, boxes_of_ids
from benchmark.pose_methods.swindrnet_nocs.config import BACKGROUND_CLASS
from benchmark.pose_methods.swindrnet_nocs.network import SwinNOCSPrediction
from benchmark.training.losses.nocs import NOCSLoss, NOCSTarget
from benchmark.training.losses.swindrnet_nocs import PoseTarget
from benchmark.training.losses.terms import Loss
from benchmark.training.step import Batch, Moment, Seen
from std_toolkit.errors import ToolkitError

NO_NOCS = ToolkitError(
    "the packed frames hold no NOCS", hint="pack them with `std-train pack --nocs`"
)


def swin_nocs_step(network: nn.Module, loss: Any, seen: Seen, moment: Moment) -> Loss:  # noqa: ARG001
    """The step of SwinDRNet's pose network."""
    prediction = network(seen.color, points_of(seen.depth, seen.batch["K"]))
    with torch.autocast(seen.color.device.type, enabled=False):
        full = SwinNOCSPrediction(*(part.float() for part in prediction))
        return loss(full, pose_target(seen.batch))


def nocs_step(network: nn.Module, loss: Any, seen: Seen, moment: Moment) -> Loss:  # noqa: ARG001
    """The step of NOCS: masks and coordinates are learnt in the objects' own boxes, jittered."""
    target = nocs_target(seen.batch, loss)
    regions = jittered(target.objects, loss.jitter)
    prediction: NOCSPrediction = network(seen.color, regions)
    with torch.autocast(seen.color.device.type, enabled=False):
        return loss(prediction, target)


def pose_target(batch: Batch) -> PoseTarget:
    """Classes and coordinates of a batch's pixels.

    Raises:
        ToolkitError: the packs hold no NOCS.
    """
    if "nocs" not in batch:
        raise NO_NOCS
    mask = batch["mask"]
    classes = batch["classes"].gather(1, mask.flatten(1).long()).reshape(mask.shape).long()
    classes = torch.where(classes == BACKGROUND, BACKGROUND_CLASS, classes)
    nocs = batch["nocs"].permute(0, 3, 1, 2)
    # 0 0 0 is a corner of the cube, which no object reaches.
    known = (classes > 0) & (classes < BACKGROUND_CLASS) & (nocs > 0).any(dim=1)
    return PoseTarget(classes, nocs.float() / 255, known, mask)


def nocs_target(batch: Batch, loss: NOCSLoss) -> NOCSTarget:
    """Objects, classes and coordinates of a batch."""
    target = pose_target(batch)
    boxes, counts = boxes_of_ids(target.mask)
    classes = batch["classes"].long()
    there = (counts >= loss.least_pixels) & (classes > 0) & (classes < BACKGROUND_CLASS)
    image, ids = there.nonzero(as_tuple=True)
    chosen = classes[there]
    scores = torch.ones(len(chosen), device=chosen.device)
    return NOCSTarget(Regions(boxes[there], image, chosen, scores, ids), target)


def jittered(regions: Regions, share: float) -> Regions:
    """Regions moved and resized at random by up to a share of their size."""
    boxes = regions.boxes
    size = boxes[:, 2:] - boxes[:, :2]
    low = boxes[:, :2] + size * _draw(size, share)
    high = boxes[:, 2:] + size * _draw(size, share)
    return regions._replace(boxes=torch.cat([low, high], dim=1))


def _draw(like: Tensor, share: float) -> Tensor:
    return (2 * torch.rand_like(like) - 1) * share
