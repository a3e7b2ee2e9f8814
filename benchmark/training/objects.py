"""Objects of packed frames, cut out for networks that look at one object at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from benchmark.data.frame import BACKGROUND
from benchmark.metrics.pose.classes import PoseClasses
from benchmark.pose_methods.crops import Crop, crop_object, stacked
from benchmark.training.losses.deformation import ObjectTruth
from benchmark.training.step import Batch
from std_toolkit.errors import ToolkitError

# Fewer pixels with true coordinates and true depth tell nothing of a pose.
_LEAST_KNOWN = 16


class Objects(NamedTuple):
    """A batch of objects.

    Attributes:
        crop: patches and points, in the arithmetic of the frames.
        category: (b,) class - 1.
        truth: what is true of the points.
        frames: place of each object's frame in the batch of frames.
    """

    crop: Crop
    category: Tensor
    truth: ObjectTruth
    frames: list[int]


def objects_of(
    color: Tensor,
    depth: Tensor,
    batch: Batch,
    *,
    categories: int,
    side: int,
    points: int,
    one_each: bool,
    generators: Callable[[], torch.Generator | None] = lambda: None,
    classes: PoseClasses | None = None,
) -> Objects | None:
    """Cut objects out of frames.

    Args:
        color: (b, 3, h, w) RGB in [0, 1].
        depth: (b, h, w) metres that points come from.
        batch: the frames, with NOCS and classes.
        categories: objects of classes 1 to this count.
        side, points: of a crop.
        one_each: one object of each frame, drawn by torch's global generator, as published; or all.
        generators: makes the generator of each object's points; torch's global one by default.
        classes: which are round.

    Returns:
        None if there is no object with enough depth.

    Raises:
        ToolkitError: the frames have no NOCS.
    """
    if "nocs" not in batch:
        raise ToolkitError("the frames are packed without NOCS", hint="std-train pack --nocs")
    classes = classes or PoseClasses()
    crops, numbers, truths, frames = [], [], [], []
    for frame in range(len(color)):
        ids = _ids(batch, frame, categories)
        if one_each:
            ids = [ids[k] for k in torch.randperm(len(ids)).tolist()]
        for number in ids:
            mask = batch["mask"][frame] == number
            crop = crop_object(
                color[frame],
                depth[frame],
                mask,
                batch["K"][frame],
                side=side,
                points=points,
                generator=generators(),
            )
            if crop is None:
                continue
            truth = _truth(batch, frame, crop.chosen)
            if truth[2].sum() < _LEAST_KNOWN:
                continue
            crops.append(crop)
            truths.append(truth)
            numbers.append(int(batch["classes"][frame, number]))
            frames.append(frame)
            if one_each:
                break
    if not crops:
        return None
    device = color.device
    coordinates, places, known = (torch.stack(part) for part in zip(*truths, strict=True))
    turned = [classes.names[n] in classes.round_about_y for n in numbers]
    return Objects(
        stacked(crops),
        torch.tensor(numbers, device=device) - 1,
        ObjectTruth(coordinates, places, known, torch.tensor(turned, device=device)),
        frames,
    )


def _ids(batch: Batch, frame: int, categories: int) -> list[int]:
    """Mask values of the objects of a frame."""
    of_class = batch["classes"][frame].long()
    there = torch.bincount(batch["mask"][frame].flatten().long(), minlength=256) > 0
    there &= (of_class >= 1) & (of_class <= categories)
    there[BACKGROUND] = False
    return there.nonzero()[:, 0].tolist()


def _truth(batch: Batch, frame: int, chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Coordinates, places and whether both are known, of chosen pixels of a frame."""
    nocs = batch["nocs"][frame].reshape(-1, 3)[chosen]
    z = batch["true"][frame].flatten()[chosen]
    w = batch["true"].shape[2]
    K = batch["K"][frame]
    x = (chosen % w - K[0, 2]) * z / K[0, 0]
    y = (chosen // w - K[1, 2]) * z / K[1, 1]
    known = (nocs > 0).any(dim=1) & (z > 0)
    return nocs.float() / 255 - 0.5, torch.stack([x, y, z], dim=1), known


def of_batches(objects: Objects, size: int) -> Iterator[Objects]:
    """The same objects, so many at a time."""
    for begin in range(0, len(objects.frames), size):
        some = slice(begin, begin + size)
        yield Objects(
            Crop(*(part[some] for part in objects.crop)),
            objects.category[some],
            ObjectTruth(*(part[some] for part in objects.truth)),
            objects.frames[some],
        )
