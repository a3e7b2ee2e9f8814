"""From pixels to the tokens of a Swin transformer by convolutions, and back to every pixel.

The published network has one linear map of 4x4 pixels before its transformers and answers at a
quarter of the resolution. Convolutions before a transformer make it learn faster (Xiao et al.,
NeurIPS 2021), and what they see of edges at every resolution is what the way back needs (U-Net,
Ronneberger et al., MICCAI 2015).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from benchmark.methods.network import precisely
from benchmark.methods.swindrnet.head import ConvUnit, enlarged

_WIDTHS = (12, 24, 48)  # channels at the image's resolution, at half and at a quarter of it
_WAY_BACK = (16, 16, 48)  # likewise
BEFORE_TOKENS = _WIDTHS[-1]
TOKEN_OF_DETAILS = 2  # side, pixels of the last details


class DetailEncoder(nn.Module):
    """An image (b, c, h, w) to its details at the whole, half and quarter of the resolution."""

    def __init__(self, in_channels: int) -> None:
        super().__init__()
        whole, half, quarter = _WIDTHS
        self.to_whole = ConvUnit(in_channels, whole, 3)
        self.to_half = ConvUnit(whole, half, 3, stride=2)
        self.to_quarter = ConvUnit(half, quarter, 3, stride=2)
        self.at_quarter = ConvUnit(quarter, quarter, 3)

    def forward(self, image: Tensor) -> list[Tensor]:
        # Depth that is told in half precision is told to a few millimetres only.
        whole = precisely(self.to_whole, image)
        half = self.to_half(whole)
        quarter = self.to_quarter(half)
        return [whole, half, quarter + self.at_quarter(quarter)]


class DetailDecoder(nn.Module):
    """A decoder's map and the details of the streams to a map of the image's resolution.

    Args:
        channels: of the decoder's map.
        streams: how many images' details there are.
        outputs: channels of the map that is told.
    """

    def __init__(self, channels: int, streams: int, outputs: int) -> None:
        super().__init__()
        above = (*_WAY_BACK[1:], channels)
        self.steps = nn.ModuleList(
            ConvUnit(wider + streams * width, own, 3)
            for own, width, wider in zip(_WAY_BACK, _WIDTHS, above, strict=True)
        )
        self.last = nn.Conv2d(_WAY_BACK[0], outputs, 1)
        nn.init.normal_(self.last.weight, std=0.01)
        self.last.bias = nn.Parameter(torch.zeros(outputs))

    def forward(self, found: Tensor, details: Sequence[Tensor]) -> Tensor:
        """(b, channels, h / 8, w / 8) and the streams' details, finest first, together."""
        for step, detail in zip(reversed(self.steps), reversed(details), strict=True):
            found = step(torch.cat([enlarged(found, detail), detail], dim=1))
        return precisely(self.last, found)
