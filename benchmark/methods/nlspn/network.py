"""NLSPN (Park et al., ECCV 2020) from colour and depth to whole depth.

Keys and shapes are those of the published weights.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from benchmark.methods.network import Prediction, precisely
from benchmark.methods.nlspn.config import NLSPNConfig
from benchmark.methods.nlspn.propagation import NEIGHBOURS, Propagation
from benchmark.methods.relative import coarse_depth, in_metres, told_color, told_depth
from benchmark.methods.resnet import residual_layer
from benchmark.methods.sizes import padded_to

_COARSEST = 16  # pixels of the image per pixel of the last level
_MEAN = (0.485, 0.456, 0.406)
_SPREAD = (0.229, 0.224, 0.225)


class NLSPNetwork(nn.Module):
    """`network(color, depth)` to `Prediction`: depth, and initial depth before propagation.

    Colour is RGB in [0, 1] and is normalised here, as for ImageNet unless the network is told
    relative depth; depth is in metres.
    """

    color_mean: Tensor
    color_spread: Tensor

    def __init__(self, config: NLSPNConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or NLSPNConfig()
        c = config.channels
        for name, values in (("color_mean", _MEAN), ("color_spread", _SPREAD)):
            tensor = torch.tensor(values).reshape(1, 3, 1, 1)
            self.register_buffer(name, tensor, persistent=False)
        self.conv1_rgb = _conv(3, c * 3 // 4, normalised=False)
        self.conv1_dep = _conv(1, c // 4, normalised=False)
        self.conv2 = residual_layer(c, c, config.blocks[0])
        self.conv3 = residual_layer(c, 2 * c, config.blocks[1], stride=2)
        self.conv4 = residual_layer(2 * c, 4 * c, config.blocks[2], stride=2)
        self.conv5 = residual_layer(4 * c, 8 * c, config.blocks[3], stride=2)
        self.conv6 = _conv(8 * c, 8 * c, stride=2)
        self.dec5 = _enlarging(8 * c, 4 * c)
        self.dec4 = _enlarging(4 * c + 8 * c, 2 * c)
        self.dec3 = _enlarging(2 * c + 4 * c, c)
        self.dec2 = _enlarging(c + 2 * c, c)
        self.id_dec1 = _conv(2 * c, c)
        self.id_dec0 = _conv(2 * c, 1, normalised=False)
        if config.relative:
            # Relative depth is negative as often as not: no activation then. It begins near 0.
            told = nn.Conv2d(2 * c, 1, 3, padding=1)
            nn.init.normal_(told.weight, std=0.001)
            self.id_dec0 = nn.Sequential(told)
        self.gd_dec1 = _conv(2 * c, c)
        self.gd_dec0 = nn.Sequential(nn.Conv2d(2 * c, NEIGHBOURS, 3, padding=1))
        self.cf_dec1 = _conv(2 * c, c // 2)
        self.cf_dec0 = nn.Sequential(nn.Conv2d(c // 2 + c, 1, 3, padding=1), nn.Sigmoid())
        self.prop_layer = Propagation(config.steps, config.preserve_input)

    def forward(self, color: Tensor, depth: Tensor) -> Prediction:
        """Restore depth.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where the sensor measured nothing.
        """
        h, w = depth.shape[-2:]
        color, depth = padded_to(color, _COARSEST), padded_to(depth, _COARSEST)
        if self.config.relative:
            seen, told = told_color(color), told_depth(depth)
        else:
            seen, told = (color - self.color_mean) / self.color_spread, depth
        initial, guidance, confidence = self._heads(seen, told)
        if self.config.relative:
            initial = in_metres(coarse_depth(depth), initial)
        restored = self.prop_layer(initial, guidance, confidence, depth)
        return Prediction(restored[..., :h, :w].clamp(min=0), initial[..., :h, :w])

    def _heads(self, color: Tensor, depth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Initial depth, guidance and confidence of what the network is told."""
        of_color = self.conv1_rgb(color)
        full = torch.cat([of_color, precisely(self.conv1_dep, depth)], dim=1)
        level2 = self.conv2(full)
        level3 = self.conv3(level2)
        level4 = self.conv4(level3)
        level5 = self.conv5(level4)
        up5 = self.dec5(self.conv6(level5))
        up4 = self.dec4(torch.cat([up5, level5], dim=1))
        up3 = self.dec3(torch.cat([up4, level4], dim=1))
        up2 = self.dec2(torch.cat([up3, level3], dim=1))
        both = torch.cat([up2, level2], dim=1)
        initial = precisely(self.id_dec0, torch.cat([self.id_dec1(both), full], dim=1))
        guidance = self.gd_dec0(torch.cat([self.gd_dec1(both), full], dim=1))
        confidence = self.cf_dec0(torch.cat([self.cf_dec1(both), full], dim=1))
        return initial, guidance, confidence


def _conv(inputs: int, outputs: int, stride: int = 1, *, normalised: bool = True) -> nn.Sequential:
    parts: list[nn.Module] = [nn.Conv2d(inputs, outputs, 3, stride, 1, bias=not normalised)]
    if normalised:
        parts.append(nn.BatchNorm2d(outputs))
    return nn.Sequential(*parts, nn.LeakyReLU(0.2))


def _enlarging(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.ConvTranspose2d(inputs, outputs, 3, 2, padding=1, output_padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.LeakyReLU(0.2),
    )
