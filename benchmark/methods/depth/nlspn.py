"""NLSPN (Park et al., ECCV 2020): configuration, network, restorer.

Non-local spatial propagation: every pixel becomes a weighted mean of pixels at learned offsets.
Keys and shapes match the published weights, and so do the answers of the published preset. Training
can start from ImageNet weights of ResNet-34.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample

from benchmark.methods.network import (
    COMPACT_SIZE,
    NetworkRestorer,
    Prediction,
    network_of,
    padded_to,
    precisely,
)
from benchmark.methods.registry import MethodOptions
from benchmark.methods.relative_depth import coarse_depth, in_metres, network_depth, relative_color
from benchmark.methods.resnet import residual_layer
from benchmark.methods.weights import check_keys, read_weights

_COARSEST = 16  # pixels of the image per pixel of the last level

_MEAN = (0.485, 0.456, 0.406)

_SPREAD = (0.229, 0.224, 0.225)

NEIGHBOURS = 8

_LEVELS = {"layer1": "conv2", "layer2": "conv3", "layer3": "conv4", "layer4": "conv5"}

# Constants of the published program that its weights hold.
_CONSTANTS = ("prop_layer.w", "prop_layer.b", "prop_layer.w_conf")


@dataclass(frozen=True, kw_only=True)
class NLSPNConfig:
    """NLSPN; the defaults are the published network.

    Attributes:
        channels: of the first level of the encoder; a multiple of 8.
        blocks: of its four levels; the published ones are those of ResNet-34.
        steps: of the propagation.
        preserve_input: keep the sensor's depth where there is some, at every step. It is for depth
            that is sparse and right; the depth of transparent objects is there and wrong.
        relative: whether input and output depth are relative to what the sensor
            measured (`benchmark.methods.relative_depth`). The published network works in metres.
        confidence: where the confidence of a neighbour is sampled, see `Propagation`. Weights of
            the authors' program need `released`, or `legacy` if they are those of the paper
            (trained before the program was changed).
        cropped: whether levels of an odd size are cropped, as in the authors' program; otherwise
            images are padded to a multiple of 16 pixels.
        input_size: (width, height) of the images. What the network was given on DREDS is not
            published; these are the images of that data set's own network.
    """

    channels: int = 64
    blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    steps: int = 18
    preserve_input: bool = False
    relative: bool = False
    confidence: Literal["fixed", "released", "legacy"] = "released"
    cropped: bool = True
    input_size: tuple[int, int] = (224, 224)


PRESETS = {
    "published": NLSPNConfig(),
    "compact": NLSPNConfig(
        channels=24,
        blocks=(1, 2, 2, 2),
        relative=True,
        confidence="fixed",
        cropped=False,
        input_size=COMPACT_SIZE,
    ),
}


class NLSPNetwork(nn.Module):
    """`network(color, depth)` to `Prediction`: depth, and initial depth before propagation.

    Colour is RGB in [0, 1] and is normalised here, as for ImageNet unless depth is
    relative; depth is in metres.
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
            head = nn.Conv2d(2 * c, 1, 3, padding=1)
            nn.init.normal_(head.weight, std=0.001)
            self.id_dec0 = nn.Sequential(head)
        self.gd_dec1 = _conv(2 * c, c)
        self.gd_dec0 = nn.Sequential(nn.Conv2d(2 * c, NEIGHBOURS, 3, padding=1))
        self.cf_dec1 = _conv(2 * c, c // 2)
        self.cf_dec0 = nn.Sequential(nn.Conv2d(c // 2 + c, 1, 3, padding=1), nn.Sigmoid())
        self.prop_layer = Propagation(config.steps, config.preserve_input, config.confidence)

    def forward(self, color: Tensor, depth: Tensor) -> Prediction:
        """Restore depth.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where the sensor measured nothing.
        """
        h, w = depth.shape[-2:]
        if not self.config.cropped:
            color, depth = padded_to(color, _COARSEST), padded_to(depth, _COARSEST)
        if self.config.relative:
            seen, measured = relative_color(color), network_depth(depth)
        else:
            seen, measured = (color - self.color_mean) / self.color_spread, depth
        initial, guidance, confidence = self._heads(seen, measured)
        if self.config.relative:
            initial = in_metres(coarse_depth(depth), initial)
        restored = self.prop_layer(initial, guidance, confidence, depth)
        return Prediction(restored[..., :h, :w].clamp(min=0), initial[..., :h, :w])

    def _heads(self, color: Tensor, depth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Initial depth, guidance and confidence from the network's inputs."""
        of_color = self.conv1_rgb(color)
        full = torch.cat([of_color, precisely(self.conv1_dep, depth)], dim=1)
        level2 = self.conv2(full)
        level3 = self.conv3(level2)
        level4 = self.conv4(level3)
        level5 = self.conv5(level4)
        up5 = self.dec5(self.conv6(level5))
        up4 = self.dec4(_beside(up5, level5))
        up3 = self.dec3(_beside(up4, level4))
        up2 = self.dec2(_beside(up3, level3))
        both = _beside(up2, level2)
        initial = precisely(self.id_dec0, torch.cat([self.id_dec1(both), full], dim=1))
        guidance = self.gd_dec0(torch.cat([self.gd_dec1(both), full], dim=1))
        confidence = self.cf_dec0(torch.cat([self.cf_dec1(both), full], dim=1))
        return initial, guidance, confidence


def _beside(larger: Tensor, features: Tensor) -> Tensor:
    """Both in one; of the first, rows and columns beyond the second are cropped."""
    h, w = features.shape[-2:]
    return torch.cat([larger[..., :h, :w], features], dim=1)


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


# (dy, dx) of the neighbours when nothing is learned yet: around the pixel, row by row.
_AROUND = tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0))


class Propagation(nn.Module):
    """Propagate depth from the neighbours that guidance gives, weighted by their confidence.

    Where a neighbour lies around the pixel, and the offset that was learned for it, add to a place:

    - `fixed`: depth and confidence are sampled at pixel + neighbour + offset.
    - `released`: confidence is sampled at pixel + offset, as the published program does.
    - `legacy`: confidence is sampled at pixel + neighbour + offset, and depth at pixel + twice the
      neighbour + offset: the published program with `--legacy`, which changes its offsets in place.

    Args:
        steps: how often.
        preserve_input: put the sensor's depth back before each step, where there is some.
        confidence: places of the confidence, see above.
    """

    def __init__(
        self,
        steps: int,
        preserve_input: bool,
        confidence: Literal["fixed", "released", "legacy"] = "fixed",
    ) -> None:
        super().__init__()
        self.steps, self.preserve_input = steps, preserve_input
        self.places = confidence
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
            offsets = offsets.float()
            places = sampling_places(offsets, 2 if self.places == "legacy" else 1)
            trusted = sampling_places(offsets.detach(), 0 if self.places == "released" else 1)
            weights = self.weights(affinities.float(), sample(confidence, trusted))
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


def sampling_places(offsets: Tensor, apart: int = 1) -> Tensor:
    """Where each pixel's neighbours lie.

    Args:
        offsets: (b, 16, h, w) pixels from their places around the pixel: dy and dx of the first
            neighbour, of the second, and so on.
        apart: pixels between a pixel and its place for a neighbour beside it.

    Returns:
        (b, 8 h, w, 2) x and y as `grid_sample` with aligned corners wants them.
    """
    b, _, h, w = offsets.shape
    offsets = offsets.reshape(b, NEIGHBOURS, 2, h, w)
    around = offsets.new_tensor(_AROUND).reshape(1, NEIGHBOURS, 2, 1, 1)
    y = torch.arange(h, dtype=offsets.dtype, device=offsets.device)[:, None]
    x = torch.arange(w, dtype=offsets.dtype, device=offsets.device)
    shifts = apart * around + offsets
    rows = (y + shifts[:, :, 0]) * (2 / max(h - 1, 1)) - 1
    columns = (x + shifts[:, :, 1]) * (2 / max(w - 1, 1)) - 1
    return torch.stack([columns, rows], dim=-1).reshape(b, NEIGHBOURS * h, w, 2)


def sample(image: Tensor, places: Tensor) -> Tensor:
    """(b, 1, h, w) at each pixel's neighbours: (b, 8, h, w), zero beyond the edges."""
    sampled = grid_sample(image, places, padding_mode="zeros", align_corners=True)
    return sampled.reshape(len(image), NEIGHBOURS, *image.shape[-2:])


def load_imagenet(network: NLSPNetwork, path: Path) -> None:
    """Begin the encoder's four levels with those of a ResNet-34 that was trained on ImageNet.

    Raises:
        ToolkitError: the file cannot be read, or holds another network.
    """
    state = {k: v for k, v in read_weights(path).items() if k.partition(".")[0] in _LEVELS}
    layers = {old: network.get_submodule(new) for old, new in _LEVELS.items()}
    wanted = {
        f"{old}.{key}": tensor
        for old, layer in layers.items()
        for key, tensor in layer.state_dict().items()
    }
    # Counts of batches are missing in older files and mean nothing here.
    wanted = {key: t for key, t in wanted.items() if not key.endswith("num_batches_tracked")}
    state = {key: t for key, t in state.items() if not key.endswith("num_batches_tracked")}
    check_keys(wanted, state, path)
    for old, layer in layers.items():
        own = {k.removeprefix(f"{old}."): t for k, t in state.items() if k.startswith(f"{old}.")}
        layer.load_state_dict(own, strict=False)


class NLSPN(NetworkRestorer):
    """Depth that spreads along learned neighbours; settings are those of `NLSPNConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = NLSPNConfig

    def __init__(self, options: MethodOptions) -> None:
        self.config, network = network_of(
            "nlspn", PRESETS, NLSPNetwork, options, ignored=_CONSTANTS
        )
        super().__init__(network, options, self.config.input_size)
