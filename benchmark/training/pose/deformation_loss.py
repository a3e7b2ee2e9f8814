"""Object crops of packed frames, and the loss of SPD and SGPA on them."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import smooth_l1_loss

from benchmark.data.frame import BACKGROUND
from benchmark.methods.pointnet.grouping import chamfer, one_way
from benchmark.methods.pose.deformation import Deformed
from benchmark.methods.pose.segmented import (
    Crop,
    Placed,
    crop_object,
    stacked,
    turned_about_z,
    with_mask,
)
from benchmark.methods.torch_camera import points_at
from benchmark.metrics.pose.pose_protocol import PoseClasses
from benchmark.training.step import Batch, Loss
from std_toolkit.errors import ToolkitError

_LEAST = 1e-12  # of an assignment, in its logarithm

# Fewer pixels with true coordinates and true depth tell nothing of a pose.
_LEAST_KNOWN = 16


class ObjectTruth(NamedTuple):
    """What a network should have said of a batch of objects.

    Attributes:
        coordinates: (b, n, 3) true normalised coordinates of the points, the middle at 0.
        places: (b, n, 3) where these points truly are in the frame of the crop's points, metres.
        known: (b, n) bool points with both.
        turned: (b,) bool objects that look the same after any turn about y.
    """

    coordinates: Tensor
    places: Tensor
    known: Tensor
    turned: Tensor


@dataclass(frozen=True, kw_only=True)
class DeformationLoss:
    """Terms, by their published weights.

    The published programs compare the deformed prior with points of the whole model, both ways.
    Frames tell of an object what is seen of it: its seen points must be near the deformed prior,
    turned by any angle for objects that are round. What is not seen is held by the prior alone.

    Attributes:
        correspondence: coordinates of each point.
        chamfer: from the seen points to the deformed prior.
        entropy: of the assignment, so that each point is of one point of the prior.
        deformation: length of the deformation.
        structure: structure points and points, both ways; of networks that have them.
        threshold: below it the error of coordinates is squared.
        symmetry: for round objects, of all turns about y the true one is taken such that the
            rotation is as near as it can be to none (`canonical`), or of six the one that is
            nearest to the answer (`nearest`).
    """

    correspondence: float = 1.0
    chamfer: float = 5.0
    entropy: float = 1e-4
    deformation: float = 0.01
    structure: float = 1.0
    threshold: float = 0.1
    symmetry: Literal["canonical", "nearest"] = "canonical"

    def __call__(self, answer: Deformed, truth: ObjectTruth) -> Loss:
        if self.symmetry == "canonical":
            truth = canonical(truth)
            error = self._errors(answer.coordinates, truth.coordinates, truth.known)
        else:
            error = self._nearest(answer.coordinates, truth)
        parts = {
            "correspondence": self.correspondence * error.mean(),
            "chamfer": self.chamfer * _to_shape(answer.shape, truth),
            "entropy": self.entropy * _entropy(answer.assignment),
            "deformation": self.deformation * _length(answer.deformation),
        }
        if answer.structure is not None:
            parts["structure"] = self.structure * chamfer(answer.structure, answer.points).mean()
        total = torch.stack(list(parts.values())).sum()
        return Loss(total, {name: part.detach() for name, part in parts.items()})

    def _errors(self, found: Tensor, true: Tensor, known: Tensor) -> Tensor:
        """(b,) mean over the known points of the summed error of their coordinates."""
        apart = smooth_l1_loss(found, true, reduction="none", beta=self.threshold).sum(dim=2)
        return apart.masked_fill(~known, 0.0).sum(dim=1) / known.sum(dim=1).clamp(min=1)

    def _nearest(self, found: Tensor, truth: ObjectTruth, turns: int = 6) -> Tensor:
        errors = []
        for turn in range(turns):
            angle = torch.where(truth.turned, 2 * math.pi * turn / turns, 0.0).to(found.dtype)
            turned = truth.coordinates @ about_y(angle).transpose(1, 2)
            errors.append(self._errors(found, turned, truth.known))
        return torch.stack(errors).amin(dim=0)


def canonical(truth: ObjectTruth) -> ObjectTruth:
    """Round objects turned about y such that their rotation is as near as it can be to none."""
    R = _rotations(truth).to(truth.coordinates.dtype)
    # The angle that makes the trace of R @ about_y(angle).T greatest.
    angle = torch.atan2(R[:, 0, 2] - R[:, 2, 0], R[:, 0, 0] + R[:, 2, 2])
    turn = about_y(torch.where(truth.turned, angle, 0.0))
    return truth._replace(coordinates=truth.coordinates @ turn.transpose(1, 2))


def facing(truth: ObjectTruth) -> ObjectTruth:
    """Round objects turned about y such that +x is on the side of the camera."""
    R = _rotations(truth).to(truth.coordinates.dtype)
    weight = truth.known[..., None].to(truth.places.dtype)
    middle = (truth.places * weight).sum(dim=1) / weight.sum(dim=1).clamp(min=1)
    toward = -(R.transpose(1, 2) @ middle[..., None])[..., 0]
    # `about_y` of the angle takes the direction to the camera to +x.
    angle = torch.atan2(toward[:, 2], toward[:, 0])
    turn = about_y(torch.where(truth.turned, angle, 0.0))
    return truth._replace(coordinates=truth.coordinates @ turn.transpose(1, 2))


def about_y(angle: Tensor) -> Tensor:
    """(b, 3, 3) rotations about y by angles (b,)."""
    c, s, o = angle.cos(), angle.sin(), torch.zeros_like(angle)
    rows = ((c, o, s), (o, o + 1, o), (-s, o, c))
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


@torch.no_grad()
def _rotations(truth: ObjectTruth) -> Tensor:
    """(b, 3, 3) rotations of the coordinates to the places, by least squares (Kabsch)."""
    weight = truth.known[..., None].double()
    total = weight.sum(dim=1, keepdim=True).clamp(min=1)
    sides = [
        (points - (points * weight).sum(dim=1, keepdim=True) / total) * weight
        for points in (truth.coordinates.double(), truth.places.double())
    ]
    U, _, Vt = torch.linalg.svd(sides[1].transpose(1, 2) @ sides[0])
    sign = torch.ones_like(U[:, 0])
    sign[:, 2] = torch.linalg.det(U @ Vt).sign()
    return (U * sign[:, None]) @ Vt


def _to_shape(shape: Tensor, truth: ObjectTruth) -> Tensor:
    angle = 2 * math.pi * torch.rand(truth.known.shape, device=shape.device)
    angle = torch.where(truth.turned[:, None], angle, 0.0).flatten()
    turned = about_y(angle.to(truth.coordinates.dtype)) @ truth.coordinates.reshape(-1, 3, 1)
    away = one_way(turned.reshape(truth.coordinates.shape).to(shape.dtype), shape)
    away = away.masked_fill(~truth.known, 0.0).sum(dim=1)
    return (away / truth.known.sum(dim=1).clamp(min=1)).mean()


def _entropy(assignment: Tensor) -> Tensor:
    return -(assignment * assignment.clamp(min=_LEAST).log()).sum(dim=2).mean()


def _length(deformation: Tensor) -> Tensor:
    # Under the root, so that the gradient of a length of 0 is 0 and not NaN.
    return (deformation.square().sum(dim=2) + _LEAST).sqrt().mean()


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
    placed: Callable[[Tensor], Placed | None] = lambda mask: None,  # noqa: ARG005
    masked: bool = False,
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
        placed: how the square of an object's mask lies; upright around it by default.
        masked: whether patches have the mask as their fourth channel.
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
                with_mask(color[frame], mask) if masked else color[frame],
                depth[frame],
                mask,
                batch["K"][frame],
                side=side,
                points=points,
                generator=generators(),
                placed=placed(mask),
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
    crop = stacked(crops)
    places = turned_about_z(places, crop.turn)
    return Objects(
        crop,
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
    x, y = points_at(chosen % w, chosen // w, z, K)
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
