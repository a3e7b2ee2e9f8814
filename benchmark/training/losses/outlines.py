"""What ClearGrasp's networks should say of a frame, from its true depth, masks and materials."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from benchmark.training.losses.surfaces import points

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
    at = points(depth, K)
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
    normal = normal * normal.new_tensor((-1.0, 1.0, 1.0)).reshape(1, 3, 1, 1)
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
    """Both pixels of pairs, told by their first ones; no pair begins with a last pixel."""
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
