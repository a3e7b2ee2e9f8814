"""CompactDR, the toolkit's own restorer: colour decides what is glass, and a table goes on.

A network of colour (EfficientNet-Lite0) finds the mask of glass and metal. With depth it finds
contact and occlusion edges, normals, and how far each measurement is to be trusted. What is trusted
is continued into the rest as surfaces go on (`benchmark.methods.depth.continuation`). Where the
network says that the continuation is not what is there, it moves the answer by a residual. Every
answer has a spread. Only in the mask may a measurement be doubted and a continuation be moved: a
hole in a table stays a table.

There is no normalisation over the image or the batch but in groups of channels of a convolution, so
that the network takes images of any size.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from benchmark.methods.depth.continuation import continued, decided
from benchmark.methods.efficientnet import CHANNELS, EfficientNetLite
from benchmark.methods.network import NetworkRestorer, Prediction, network_of, padded_to, precisely
from benchmark.methods.registry import MethodOptions
from benchmark.methods.relative_depth import coarse_depth, mean_depth, relative_to
from benchmark.methods.resnet import convolution

_MULTIPLE = 32  # of the encoder

SPREAD_KINDS = ("measured", "continued", "glass or metal")

MASK_PARTS = ("of_color", "mask_at", "mask", "clear")
"""Parts after the encoder that see colour alone."""

DEPTH_PARTS = (
    *("of_depth", "narrow", "around", "up", "refine", "head"),
    *("join", "wide", "last"),
)
"""Parts that see depth, too."""

# What the heads answer, beside features of the residual.
MASKS, EDGES, NORMALS = 2, 3, 3

_SPAN = 0.2  # a residual of 1 moves the answer by this share of its depth
_LIMIT = 4.0  # of relative depth that the network sees

# At the beginning the sensor is trusted and the continuation is right: logits.
_TRUSTED, _OFF = 2.0, -3.0
# Logarithm of the spread's share of depth at the beginning, and its limits.
_SPREAD, _SPREADS = -4.5, (-8.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class CompactDRConfig:
    """CompactDR.

    Attributes:
        depth_channels: of the levels of depth, at 1/2, 1/4, ... of the size.
        channels: of the decoder's levels.
        mask_channels: of the levels of the mask's own decoder, which sees colour alone.
        group: channels that are normalised together.
        longest: pixels; larger images are made smaller for the network.
        input_size: (width, height) of all images; None for any.
    """

    depth_channels: tuple[int, int, int, int, int] = (16, 24, 32, 64, 96)
    channels: tuple[int, int, int, int, int] = (32, 48, 64, 96, 128)
    mask_channels: int = 48
    group: int = 8
    longest: int = 320
    input_size: tuple[int, int] | None = None


PRESETS = {"compact": CompactDRConfig()}


class Looked(NamedTuple):
    """What the network says of an image; all maps have its size.

    Attributes:
        masks: (b, 2, h, w) logits: glass, metal.
        edges: (b, 3, h, w) logits: none, occlusion, contact.
        normals: (b, 3, h, w) unit vectors.
        trust: (b, 1, h, w) logit that a measurement is right.
        off: (b, 1, h, w) logit that the continuation is not what is there.
        base: (b, 1, h, w) metres, the continuation.
        moved: (b, 1, h, w) metres, the answer of the residual.
        answer: (b, 1, h, w) metres: the continuation, or what is moved, as `off` says.
        depth: (b, 1, h, w) metres: the sensor where it is trusted, the answer elsewhere.
        spread: (b, 1, h, w) metres, scale of the Laplace density of the error of `depth`.
        clear: (b, 1, h, w) probability of glass or metal.
        believed: (b, 1, h, w) trust in a measurement, which is doubted on glass and metal alone.
    """

    masks: Tensor
    edges: Tensor
    normals: Tensor
    trust: Tensor
    off: Tensor
    base: Tensor
    moved: Tensor
    answer: Tensor
    depth: Tensor
    spread: Tensor
    clear: Tensor
    believed: Tensor


class CompactDRNetwork(nn.Module):
    """`network(color, depth)` to `Prediction`; `network.look(color, depth)` to all that it says."""

    too_small: Tensor

    def __init__(self, config: CompactDRConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or CompactDRConfig()
        self.encoder = EfficientNetLite()
        widths, group = config.channels, config.group
        inputs, levels = 3, []
        for outputs in config.depth_channels:
            first = _grouped(inputs, outputs, group, 2)
            levels.append(nn.Sequential(first, _grouped(outputs, outputs, group)))
            inputs = outputs
        self.of_depth = nn.ModuleList(levels)
        self.narrow = nn.ModuleList(
            nn.Conv2d(color + own, width, 1)
            for color, own, width in zip(CHANNELS, config.depth_channels, widths, strict=True)
        )
        self.around = nn.Conv2d(widths[-1], widths[-1], 1)
        self.up = nn.ModuleList(
            _grouped(fine + coarse, fine, group) for fine, coarse in pairwise(widths)
        )
        self.refine = nn.ModuleList(_grouped(width, width, group) for width in widths[:-1])
        self.head = nn.Conv2d(widths[0], EDGES + NORMALS + 1, 1)
        # A hole in the depth is no glass: the mask sees colour alone.
        width = config.mask_channels
        self.of_color = nn.ModuleList(nn.Conv2d(color, width, 1) for color in CHANNELS)
        self.mask_at = nn.ModuleList(_grouped(width, width, group) for _ in CHANNELS[1:])
        self.mask = nn.Sequential(_grouped(width, width, group), _grouped(width, width, group))
        self.clear = nn.Conv2d(width, MASKS, 1)
        # The residual sees the continuation, and the sensor's difference from it.
        self.join = _grouped(widths[0] + 4, widths[0], group)
        self.wide = nn.ModuleList(
            _grouped(widths[0], widths[0], group, dilation=d) for d in (2, 4, 8, 1)
        )
        self.last = nn.Conv2d(widths[0], 3, 1)
        # By what spreads of `SPREAD_KINDS` are too small, as a logarithm; of validation frames.
        self.register_buffer("too_small", torch.zeros(len(SPREAD_KINDS)))
        self._begin()

    def _begin(self) -> None:
        """Answers at first: no glass, the sensor is right, surfaces go on."""
        for head in (self.head, self.last, self.clear):
            nn.init.normal_(head.weight, std=0.01)
            assert head.bias is not None
            nn.init.zeros_(head.bias)
        with torch.no_grad():
            assert self.head.bias is not None and self.last.bias is not None
            assert self.clear.bias is not None
            self.clear.bias.fill_(_OFF)
            self.head.bias[EDGES + NORMALS - 1] = -1.0  # facing the camera
            self.head.bias[-1] = _TRUSTED
            self.last.bias.copy_(torch.tensor([_OFF, 0.0, _SPREAD]))

    def forward(self, color: Tensor, depth: Tensor) -> Prediction:
        """Restore depth.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where the sensor measured nothing.
        """
        found = self.look(color, depth)
        trust = found.believed * (depth > 0)
        # The standard deviation of a Laplace density of this scale.
        return Prediction(found.depth, found.answer, trust, 2**0.5 * found.spread, found.clear)

    def masks(self, color: Tensor) -> Tensor:
        """(b, 2, h, w) logits of glass and metal, which colour alone decides."""
        padded = padded_to(color, _MULTIPLE)
        found = self._masks_of(self.encoder(padded), padded)
        return found[..., : color.shape[2], : color.shape[3]]

    def train_parts(self, names: Sequence[str]) -> None:
        """Let these of the network's parts learn, and nothing else."""
        for name, module in self.named_children():
            module.requires_grad_(name in names)

    def look(self, color: Tensor, depth: Tensor) -> Looked:
        """All that the network says of an image; arguments as of `forward`."""
        h, w = depth.shape[-2:]
        color, depth = padded_to(color, _MULTIPLE), padded_to(depth, _MULTIPLE)
        of_color = self.encoder(color)
        features = self._features(of_color, depth)
        masks = self._masks_of(of_color, depth)
        maps = _enlarged(precisely(self.head, features), depth)
        edges, normals, trust = maps.split([EDGES, NORMALS, 1], dim=1)
        clear = masks.sigmoid().amax(dim=1, keepdim=True)
        in_mask = decided(clear)
        believed = 1 - (1 - trust.sigmoid()) * in_mask
        base, off, moved, spread = self._answer(features, depth, believed)
        raised = off.sigmoid() * in_mask
        answer = base * (1 - raised) + moved * raised
        kept = decided(believed) * (depth > 0)
        final = kept * depth + (1 - kept) * answer
        spread = spread.clamp(*_SPREADS)
        if not self.training:
            kinds = torch.cat([kept, (1 - kept) * (1 - in_mask), (1 - kept) * in_mask], dim=1)
            spread = spread + (kinds * self.too_small[:, None, None]).sum(dim=1, keepdim=True)
        found = Looked(
            masks, edges, _unit(normals), trust, off, base, moved, answer, final,
            answer * spread.exp(), clear, believed,
        )  # fmt: skip
        return Looked(*(one[..., :h, :w] for one in found))

    def _masks_of(self, of_color: Sequence[Tensor], like: Tensor) -> Tensor:
        """Logits of glass and metal, at the size of `like`."""
        levels = [one(each) for one, each in zip(self.of_color, of_color, strict=True)]
        found = levels[-1] + levels[-1].mean(dim=(2, 3), keepdim=True)
        for layer, finer in zip(reversed(self.mask_at), reversed(levels[:-1]), strict=True):
            found = finer + _enlarged(found + layer(found), finer)
        return _enlarged(precisely(self.clear, self.mask(found)), like)

    def _features(self, of_color: Sequence[Tensor], depth: Tensor) -> Tensor:
        """(b, c, h / 2, w / 2) of both, after the decoder."""
        seen = precisely(_Seen(), depth)
        of_depth = []
        for level in self.of_depth:
            seen = level(seen)
            of_depth.append(seen)
        both = [
            narrow(torch.cat(pair, dim=1))
            for narrow, *pair in zip(self.narrow, of_color, of_depth, strict=True)
        ]
        top = both[-1]
        # What the image is like as a whole.
        features = top + self.around(top.mean(dim=(2, 3), keepdim=True))
        for number in reversed(range(len(self.up))):
            larger = _enlarged(features, both[number])
            features = self.up[number](torch.cat([larger, both[number]], dim=1))
            features = features + self.refine[number](features)
        return features

    def _answer(
        self, features: Tensor, depth: Tensor, believed: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Continuation; logit that it is off; the answer then, metres; logarithm of the spread."""
        base = precisely(_Continued(depth), believed)
        mean = mean_depth(depth)
        there = depth > 0
        apart = torch.where(there, (depth - base) / (_SPAN * mean), 0.0).clamp(-_LIMIT, _LIMIT)
        shown = torch.cat(
            [relative_to(mean, base).clamp(-_LIMIT, _LIMIT), apart, there.float(), believed],
            dim=1,
        )
        shown = interpolate(shown, size=features.shape[-2:], mode="bilinear", align_corners=False)
        inner = self.join(torch.cat([features, shown.to(features.dtype)], dim=1))
        for layer in self.wide:
            inner = inner + layer(inner)
        off, residual, spread = _enlarged(precisely(self.last, inner), depth).split(1, dim=1)
        return base, off, base * (1 + _SPAN * residual).clamp(min=0.1), spread


class _Seen(nn.Module):
    """What the network sees of depth: relative, where it is measured, and its fine relief."""

    def forward(self, depth: Tensor) -> Tensor:
        there = (depth > 0).float()
        relief = torch.where(depth > 0, depth / coarse_depth(depth) - 1, 0.0) / 0.02
        relative = relative_to(mean_depth(depth), depth) * there
        limited = (one.clamp(-_LIMIT, _LIMIT) for one in (relative, relief))
        return torch.cat([*limited, there], dim=1)


class _Continued(nn.Module):
    """`continued` as a module, for `precisely`."""

    def __init__(self, depth: Tensor) -> None:
        super().__init__()
        self._depth = depth

    def forward(self, believed: Tensor) -> Tensor:
        return continued(self._depth, believed)


def _grouped(
    inputs: int, outputs: int, group: int, stride: int = 1, dilation: int = 1
) -> nn.Sequential:
    """Convolution, normalisation of groups of channels, ReLU."""
    made = convolution(inputs, outputs, 3, stride, dilation)
    made[1] = nn.GroupNorm(outputs // group, outputs)
    return made


def _enlarged(images: Tensor, like: Tensor) -> Tensor:
    return interpolate(images, size=like.shape[-2:], mode="bilinear", align_corners=False)


def _unit(vectors: Tensor) -> Tensor:
    return vectors / (vectors.square().sum(dim=1, keepdim=True) + 1e-12).sqrt()


class CompactDR(NetworkRestorer):
    """Restores images of any size; settings are those of `CompactDRConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = CompactDRConfig

    def __init__(self, options: MethodOptions) -> None:
        self.config, network = network_of("compactdr", PRESETS, CompactDRNetwork, options)
        super().__init__(network, options, self.config.input_size)
        self.longest = self.config.longest
