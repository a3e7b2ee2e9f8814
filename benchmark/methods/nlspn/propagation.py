"""Non-local spatial propagation: every pixel becomes a mean of pixels that are learned."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample

NEIGHBOURS = 8
# (dy, dx) of the neighbours when nothing is learned yet: around the pixel, row by row.
_AROUND = tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0))


class Propagation(nn.Module):
    """Spread depth from neighbours that are told by guidance, weighted by their confidence.

    The published program samples confidence at other places than depth: it leaves out where the
    neighbours lie around the pixel. Here both are sampled at pixel + neighbour + offset.

    Args:
        steps: how often.
        preserve_input: put the sensor's depth back before each step, where there is some.
    """

    def __init__(self, steps: int, preserve_input: bool) -> None:
        super().__init__()
        self.steps, self.preserve_input = steps, preserve_input
        self.conv_offset_aff = nn.Conv2d(NEIGHBOURS, 3 * NEIGHBOURS, 3, padding=1)
        nn.init.zeros_(self.conv_offset_aff.weight)
        self.conv_offset_aff.bias = nn.Parameter(torch.zeros(3 * NEIGHBOURS))
        self.aff_scale_const = nn.Parameter(torch.full((1,), 0.5 * NEIGHBOURS))

    def forward(
        self, initial: Tensor, guidance: Tensor, confidence: Tensor, sensor: Tensor
    ) -> Tensor:
        """Propagate.

        Args:
            initial: (b, 1, h, w) depth to begin with.
            guidance: (b, 8, h, w).
            confidence: (b, 1, h, w) of the initial depth, in [0, 1].
            sensor: (b, 1, h, w) depth, 0 where there is none.
        """
        numbers = self.conv_offset_aff(guidance)
        offsets, affinities = numbers.split([2 * NEIGHBOURS, NEIGHBOURS], dim=1)
        # Positions and their interpolation need all digits, whatever the network's precision.
        with torch.autocast(initial.device.type, enabled=False):
            initial, confidence = initial.float(), confidence.float()
            places = sampling_places(offsets.float())
            weights = self.weights(affinities.float(), sample(confidence, places.detach()))
            own = 1 - weights.sum(dim=1, keepdim=True)
            depth = initial
            for _ in range(self.steps):
                if self.preserve_input:
                    depth = torch.where(sensor > 0, sensor, depth)
                spread = (weights * sample(depth, places)).sum(dim=1, keepdim=True)
                depth = own * depth + spread
        return depth

    def weights(self, affinities: Tensor, confidence: Tensor) -> Tensor:
        """Weights of the neighbours (b, 8, h, w), whose absolute values add up to 1 at most.

        Args:
            affinities: (b, 8, h, w), of any size.
            confidence: (b, 8, h, w) of each neighbour.
        """
        weights = torch.tanh(affinities) / (self.aff_scale_const + 1e-8) * confidence
        total = weights.abs().sum(dim=1, keepdim=True) + 1e-4
        return weights / total.clamp(min=1)


def sampling_places(offsets: Tensor) -> Tensor:
    """Where each pixel's neighbours lie.

    Args:
        offsets: (b, 16, h, w) pixels from their places around the pixel: dy and dx of the first
            neighbour, of the second, and so on.

    Returns:
        (b, 8 h, w, 2) x and y as `grid_sample` with aligned corners wants them.
    """
    b, _, h, w = offsets.shape
    offsets = offsets.reshape(b, NEIGHBOURS, 2, h, w)
    around = offsets.new_tensor(_AROUND).reshape(1, NEIGHBOURS, 2, 1, 1)
    y = torch.arange(h, dtype=offsets.dtype, device=offsets.device)[:, None]
    x = torch.arange(w, dtype=offsets.dtype, device=offsets.device)
    shifts = around + offsets
    rows = (y + shifts[:, :, 0]) * (2 / max(h - 1, 1)) - 1
    columns = (x + shifts[:, :, 1]) * (2 / max(w - 1, 1)) - 1
    return torch.stack([columns, rows], dim=-1).reshape(b, NEIGHBOURS * h, w, 2)


def sample(image: Tensor, places: Tensor) -> Tensor:
    """(b, 1, h, w) at each pixel's neighbours: (b, 8, h, w), zero beyond the edges."""
    sampled = grid_sample(image, places, padding_mode="zeros", align_corners=True)
    return sampled.reshape(len(image), NEIGHBOURS, *image.shape[-2:])
