"""Images of any size for networks that halve them several times."""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import pad


def padded_to(images: Tensor, multiple: int) -> Tensor:
    """(b, c, h, w) images with their last row and column repeated up to multiples of `multiple`."""
    h, w = images.shape[-2:]
    right, below = -w % multiple, -h % multiple
    return pad(images, (0, right, 0, below), mode="replicate") if right or below else images
