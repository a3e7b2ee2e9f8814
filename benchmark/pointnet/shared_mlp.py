"""A small network that every point goes through alike."""

from __future__ import annotations

from collections.abc import Sequence

from torch import nn


class SharedMLP(nn.Sequential):
    """1x1 convolutions, each with batch normalisation and ReLU.

    Args:
        inputs: channels.
        widths: channels after each convolution.
        dimensions: 1 for (b, c, n), 2 for (b, c, m, k).
        normalised: whether there is batch normalisation; without, convolutions have a bias.
        last_linear: whether the last convolution stands alone, without either.
    """

    def __init__(
        self,
        inputs: int,
        widths: Sequence[int],
        *,
        dimensions: int = 1,
        normalised: bool = True,
        last_linear: bool = False,
    ) -> None:
        convolution: type[nn.Conv1d] | type[nn.Conv2d]
        normalisation: type[nn.BatchNorm1d] | type[nn.BatchNorm2d]
        convolution, normalisation = (
            (nn.Conv1d, nn.BatchNorm1d) if dimensions == 1 else (nn.Conv2d, nn.BatchNorm2d)
        )
        layers: list[nn.Module] = []
        for place, width in enumerate(widths):
            alone = last_linear and place == len(widths) - 1
            layers.append(convolution(inputs, width, 1, bias=alone or not normalised))
            if not alone:
                layers += [normalisation(width)] if normalised else []
                layers.append(nn.ReLU())
            inputs = width
        super().__init__(*layers)
        self.outputs = inputs
