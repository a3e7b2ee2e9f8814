"""Targets and losses of ClearGrasp's three networks (Sajjan et al., ICRA 2020).

Targets are computed from the true depth, the masks and the materials of a frame.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy

from benchmark.methods.torch_camera import points_of
from benchmark.training.step import Loss, constant

NONE, OCCLUSION, CONTACT = 0, 1, 2  # classes of boundaries

IGNORED = -100  # class of pixels that are not known, as torch has it

_SMALLEST = 1e-12


class Outlines(NamedTuple):
    """Targets.

    Attributes:
        normals: (b, 3, h, w) unit normals, x right, y up, z towards the camera; 0 where unknown.
        boundaries: (b, h, w) int64 classes, `IGNORED` where unknown.
    """

    normals: Tensor
    boundaries: Tensor


@torch.no_grad()
def outlines_of(depth: Tensor, mask: Tensor, K: Tensor, gap: float) -> Outlines:
    """Normals and boundaries.

    Two neighbours are apart where depth changes between them by more than `gap` beyond the slope of
    the surface around them; this is an occlusion boundary. Otherwise, where they are of
    different objects, or of an object and what it stands on, there is a contact edge. Both pixels
    are of the boundary.

    A normal is made of differences to neighbours that are not across a boundary; of the two of a
    row, and of a column, the one along which depth changes less counts.

    Args:
        depth: (b, 1, h, w) true metres, 0 where unknown.
        mask: (b, h, w) uint8 instance ids.
        K: (b, 3, 3) intrinsics.
        gap: metres.
    """
    z, known = depth[:, 0], depth[:, 0] > 0
    occlusion, contact = torch.zeros_like(known), torch.zeros_like(known)
    unclear = ~known
    steps = []
    at = points_of(depth, K)
    for axis in (2, 1):  # along rows, along columns
        both = _ahead(known, axis) & known
        both = both & _inside(known, axis)
        apart = both & (_jump(z, known, axis) > gap)
        other = both & ~apart & (_ahead(mask, axis) != mask)
        unclear |= _either(_inside(known, axis) & ~both, axis)
        occlusion |= _either(apart, axis)
        contact |= _either(other, axis)
        steps.append(_step(at, both & ~apart & ~other, axis + 1))
    (across, has_across), (down, has_down) = steps
    # Of right and down the product points away; seen from the camera, with y up, x turns over.
    normal = torch.linalg.cross(across, down, dim=1)
    length = normal.square().sum(dim=1, keepdim=True).sqrt()
    usable = (has_across & has_down)[:, None] & (length > _SMALLEST)
    normal = normal * constant((-1.0, 1.0, 1.0), normal).reshape(1, 3, 1, 1)
    normal = torch.where(usable, normal / length.clamp(min=_SMALLEST), 0.0)
    classes = torch.where(contact, CONTACT, NONE)
    classes = torch.where(unclear, IGNORED, classes)
    return Outlines(normal, torch.where(occlusion, OCCLUSION, classes))


def _ahead(maps: Tensor, axis: int) -> Tensor:
    """Each pixel's next one; the last ones' is the first."""
    return maps.roll(-1, axis)


def _inside(maps: Tensor, axis: int) -> Tensor:
    """Bool: pixels that have a next one."""
    found = torch.ones_like(maps, dtype=torch.bool)
    found.select(axis, found.shape[axis] - 1).fill_(False)
    return found


def _either(pairs: Tensor, axis: int) -> Tensor:
    """Both pixels of the pairs given by their first pixel; no pair begins with a last pixel."""
    return pairs | pairs.roll(1, axis)


def _jump(z: Tensor, known: Tensor, axis: int) -> Tensor:
    """Metres from each pixel to its next one, off the slope of the surfaces there.

    The inverse depth of a plane is linear in the image, however slanted it is. Of the slopes
    before and behind the two pixels the smaller one counts: the other may be a boundary itself,
    or that of a round surface that turns away. A slope that goes the other way explains nothing.
    """
    inverse = torch.where(known, 1 / z.clamp(min=1e-6), 0.0)
    step = _ahead(inverse, axis) - inverse
    there = known & _ahead(known, axis) & _inside(known, axis)
    slope = torch.where(there, step, torch.inf)
    before, behind = slope.roll(1, axis), slope.roll(-1, axis)
    least = torch.where(before.abs() <= behind.abs(), before, behind)
    least = torch.where(least.isfinite(), least, 0.0)
    return (step - least).abs().minimum(step.abs()) * z * _ahead(z, axis)


def _step(at: Tensor, connected: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """(b, 3, h, w) from pixel to pixel along an axis of `at`, and (b, h, w) whether there is one.

    Args:
        at: (b, 3, h, w) points.
        connected: (b, h, w) bool, whether a pixel and its next one are of one surface.
        axis: 3 along rows, 2 along columns.
    """
    ahead = at.roll(-1, axis) - at
    back = ahead.roll(1, axis)
    has_ahead, has_back = connected, connected.roll(1, axis - 1)
    flat = ahead[:, 2].abs() <= back[:, 2].abs()
    use_ahead = has_ahead & (flat | ~has_back)
    step = torch.where(use_ahead[:, None], ahead, back)
    return step, has_ahead | has_back


class ClearGraspAnswers(NamedTuple):
    """What the networks say, of those that were asked; as in `ClearGraspMaps`."""

    masks: Tensor | None
    normals: Tensor | None
    boundaries: Tensor | None


class ClearGraspTarget(NamedTuple):
    """What they should say.

    Attributes:
        masks: (b, h, w) int64, 1 on the objects whose measurements are to be dropped.
        outlines: normals and boundaries.
    """

    masks: Tensor
    outlines: Outlines


@dataclass(frozen=True, kw_only=True)
class ClearGraspLoss:
    """Cross entropy of masks, 1 - cosine of normals and weighted cross entropy of boundaries.

    The networks share nothing: the sum trains each as its own part alone would.

    Attributes:
        masks, normals, boundaries: weights; a network of weight 0 is not trained.
        boundary: weight of pixels of either kind of boundary, against others; the published one.
        objects: whose measurements are to be dropped. `transparent`, as published; the data sets
            here have specular objects, too.
        gap: metres; neighbours farther apart in depth have an occlusion boundary between them.
        reduce: `mean` over the pixels; or their `sum` over each image, for rates as small as the
            1e-6 of the authors' sample configuration.
    """

    masks: float = 1.0
    normals: float = 1.0
    boundaries: float = 1.0
    boundary: float = 5.0
    objects: Literal["transparent", "specular_transparent"] = "transparent"
    gap: float = 0.01
    reduce: Literal["mean", "sum"] = "mean"

    def __call__(self, answers: ClearGraspAnswers, target: ClearGraspTarget) -> Loss:
        parts: dict[str, Tensor] = {}
        outlines = target.outlines
        if answers.masks is not None:
            parts["masks"] = cross_entropy(answers.masks, target.masks, reduction=self.reduce)
        if answers.normals is not None:
            known = outlines.normals.square().sum(dim=1) > 0.5
            bent = (1 - (answers.normals * outlines.normals).sum(dim=1)).masked_fill(~known, 0.0)
            parts["normals"] = bent.sum()
            if self.reduce == "mean":
                parts["normals"] = bent.sum() / known.sum().clamp(min=1)
        if answers.boundaries is not None:
            parts["boundaries"] = self._of_boundaries(answers.boundaries, outlines.boundaries)
        if self.reduce == "sum":
            parts = {name: part / len(target.masks) for name, part in parts.items()}
        total = torch.stack([getattr(self, name) * part for name, part in parts.items()]).sum()
        return Loss(total, {name: part.detach() for name, part in parts.items()})

    def _of_boundaries(self, answers: Tensor, classes: Tensor) -> Tensor:
        weight = constant((1.0, self.boundary, self.boundary), answers)
        total = cross_entropy(answers, classes, weight, ignore_index=IGNORED, reduction="sum")
        if self.reduce == "sum":
            return total
        known = classes != IGNORED
        return total / (weight[classes.clamp(min=0)] * known).sum().clamp(min=1)
