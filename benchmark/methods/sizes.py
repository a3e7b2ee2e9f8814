"""Sizes of images that networks work at."""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import pad

# (width, height) that compact networks work at: that of the main tables, so that their answers are
# scored pixel by pixel, and shaped as the cameras' images.
COMPACT_SIZE = (224, 126)


def padded_to(images: Tensor, multiple: int) -> Tensor:
    """(b, c, h, w) images with their last row and column repeated up to multiples of `multiple`."""
    h, w = images.shape[-2:]
    right, below = -w % multiple, -h % multiple
    return pad(images, (0, right, 0, below), mode="replicate") if right or below else images
