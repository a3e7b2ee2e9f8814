"""Crop NOCS: normalised coordinates of one object from its colour, mask and depth.

A small convolutional network of our own. It sees the object's points centred and free of scale, so
that neither distance nor size of an object must be learnt, and crops with the longest axis of the
mask upright. Coordinates are chosen among bins
(Wang et al., CVPR 2019) and averaged over the best bin and its neighbours. Objects that are round
about y have no front: +x of theirs is the side that faces the camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, one_hot, relu

from benchmark.methods.network import network_of
from benchmark.methods.pointnet.grouping import at
from benchmark.methods.pose.crop_estimator import CropConfig, CropEstimator, CropNetwork
from benchmark.methods.pose.segmented import Segmented, stacked
from benchmark.methods.protocol import PoseView
from benchmark.methods.registry import MethodOptions
from benchmark.methods.resnet import convolution, residual_layer
from benchmark.metrics.pose.pose_protocol import DREDS_CLASSES
from std_toolkit.errors import ToolkitError

AXES = 3

_LIMIT = 4.0  # of centred points, in their median distance from the middle: beyond is background

# Normalised coordinates from the middle reach to half a diagonal of the unit cube's face at most.
_HALF = 0.5


class BinnedCoordinates(NamedTuple):
    """What the network says of a batch of objects.

    Attributes:
        logits: (b, 3, bins, n) of the bins of x, y and z at the object's points.
        coordinates: (b, n, 3) normalised coordinates of the points, the middle at 0.
        half: (b, 3) half sides of the box, normalised.
        shape: (b, 2, 3) two opposite corners of the box.
    """

    logits: Tensor
    coordinates: Tensor
    half: Tensor
    shape: Tensor


@dataclass(frozen=True, kw_only=True)
class CropNOCSConfig(CropConfig):
    """The network, beside `CropConfig`.

    Attributes:
        widths: channels at a half, a quarter, an eighth and a sixteenth of the patch's side.
        blocks: residual blocks of each.
        bins: of a coordinate.
        trust: how much this network's own judgement of classes counts where masks come with
            chances of several: an object is tried as each category, and its chances are multiplied
            by exp(offset - trust * mean entropy of the bins). 0 leaves the classes as they are.
        offsets: of each category, as coordinates of some are always surer than those of others;
            none for 0.
    """

    widths: tuple[int, ...] = (64, 128, 256, 384)
    blocks: tuple[int, ...] = (2, 2, 2, 2)
    bins: int = 32
    side: int = 128
    points: int = 1024
    trained_on: Literal["raw", "true", "restored", "mixed"] = "mixed"
    masks: str = "swindrnet-nocs"
    trust: float = 3.5
    offsets: tuple[float, ...] = ()


PRESETS = {
    "published": CropNOCSConfig(),
    "compact": CropNOCSConfig(
        side=48,
        points=640,
        widths=(40, 80, 160, 160),
        mask_preset="small",
        # As the trust, fitted to masks of `swindrnet-nocs` in the validation scenes of the weights.
        offsets=(-1.1, -0.6, 1.1, -0.1, 0.5, 0.8, -0.6),
    ),
}
PRESETS["small"] = replace(PRESETS["compact"], widths=(32, 64, 128, 128))


class CropNOCSNetwork(CropNetwork):
    """Colour with mask, points, pixels and categories to `BinnedCoordinates`.

    Raises:
        ToolkitError: the side is not a multiple of 16, or there are no points.
    """

    masked = True
    aligned = True
    step = 16
    config: CropNOCSConfig

    def __init__(self, config: CropNOCSConfig) -> None:
        super().__init__(config)
        first, widths = config.widths[0], config.widths
        kinds = len(config.categories)
        self.color = convolution(4, first, stride=2)
        self.joined = convolution(first + 4 + kinds, first)
        self.down = nn.ModuleList()
        inputs = first
        for level, width in enumerate(widths):
            self.down.append(residual_layer(inputs, width, config.blocks[level], 1 + (level > 0)))
            inputs = width
        self.whole = nn.Linear(inputs + kinds, inputs)
        self.box = nn.Linear(inputs, AXES)
        self.up = nn.ModuleList()
        for width in reversed(widths[:-1]):
            self.up.append(convolution(inputs + width, width))
            inputs = width
        self.bins = nn.Conv2d(inputs, AXES * config.bins, 1)

    def forward(
        self, color: Tensor, points: Tensor, pixels: Tensor, category: Tensor
    ) -> BinnedCoordinates:
        """Objects.

        Args:
            color: (b, 4, s, s) RGB in [0, 1] and the mask.
            points: (b, n, 3) metres in the camera frame.
            pixels: (b, n) place of each point in the patch.
            category: (b,) place of its category in the configuration's.
        """
        if self.training:
            logits, box = self.answer(color, points, pixels, category)
        else:
            # The same crop upside down has the same answers.
            over = points * points.new_tensor([-1.0, -1.0, 1.0])
            last = color.shape[-1] ** 2 - 1
            twice = (
                self.answer(color, points, pixels, category),
                self.answer(color.flip(2, 3), over, last - pixels, category),
            )
            logits, box = (torch.stack(pair).mean(dim=0) for pair in zip(*twice, strict=True))
        half = _HALF * box.sigmoid()
        return BinnedCoordinates(logits, decoded(logits), half, torch.stack([half, -half], dim=1))

    def answer(
        self, color: Tensor, points: Tensor, pixels: Tensor, category: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Logits (b, 3, bins, n) of the bins, and of the half sides (b, 3)."""
        config, side = self.config, color.shape[-1] // 2
        x = self.color(2 * color - 1)
        kind = one_hot(category, len(config.categories)).to(x.dtype)
        maps = [x, points_in(points, pixels, side).to(x.dtype)]
        maps.append(kind[:, :, None, None].expand(-1, -1, side, side))
        x = self.joined(torch.cat(maps, dim=1))
        levels = []
        for layer in self.down:
            x = layer(x)
            levels.append(x)
        whole = relu(self.whole(torch.cat([x.mean(dim=(2, 3)), kind], dim=1)))
        x = x + whole[:, :, None, None]
        for layer, beside in zip(self.up, reversed(levels[:-1]), strict=True):
            x = layer(torch.cat([interpolate(x, scale_factor=2.0), beside], dim=1))
        logits = at(self.bins(x).flatten(2), cells_of(pixels, side)).float()
        return logits.unflatten(1, (AXES, config.bins)), self.box(whole).float()


def points_in(points: Tensor, pixels: Tensor, side: int) -> Tensor:
    """(b, 4, side, side) mean of the points in each cell, and whether there is one.

    Points are moved so that their median is at 0 and divided by their median distance from it.

    Args:
        points: (b, n, 3) metres.
        pixels: (b, n) places in a patch of 2 side pixels.
    """
    b = len(points)
    apart = points - points.median(dim=1, keepdim=True).values
    scale = apart.norm(dim=2).median(dim=1).values.clamp(min=1e-6)
    apart = (apart / scale[:, None, None]).clamp(-_LIMIT, _LIMIT)
    cell = cells_of(pixels, side)
    counted = torch.cat([apart, torch.ones_like(apart[..., :1])], dim=2).transpose(1, 2)
    sums = torch.zeros(b, 4, side * side, dtype=apart.dtype, device=points.device)
    sums.scatter_add_(2, cell[:, None].expand(-1, 4, -1), counted)
    count = sums[:, 3:]
    means = sums[:, :3] / count.clamp(min=1)
    return torch.cat([means, count.clamp(max=1)], dim=1).unflatten(2, (side, side))


def cells_of(pixels: Tensor, side: int) -> Tensor:
    """Places in a grid of `side` cells of places in a patch of twice as many pixels."""
    row, column = pixels // (2 * side), pixels % (2 * side)
    return (row // 2) * side + column // 2


def decoded(logits: Tensor) -> Tensor:
    """(b, n, 3) coordinates of logits (b, 3, bins, n): the mean over the best bin and the two
    beside it, by their chances."""
    count = logits.shape[2]
    best = logits.argmax(dim=2, keepdim=True).clamp(1, count - 2)
    near = torch.cat([best - 1, best, best + 1], dim=2)
    weight = logits.gather(2, near).softmax(dim=2)
    middle = ((near + 0.5) / count * weight).sum(dim=2)
    return (middle - _HALF).transpose(1, 2)


class CropNOCS(CropEstimator):
    """Coordinates of cropped objects; settings are those of `CropNOCSConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = CropNOCSConfig

    def __init__(self, options: MethodOptions) -> None:
        self._own, self._network = network_of("crop-nocs", PRESETS, CropNOCSNetwork, options)
        if self._own.offsets and len(self._own.offsets) != len(self._own.categories):
            raise ToolkitError(
                f"must be as many as categories, {len(self._own.categories)}",
                field="offsets",
                value=self._own.offsets,
            )
        super().__init__(self._network, options)

    def _segmented(self, views: Sequence[PoseView]) -> list[Segmented]:
        found = super()._segmented(views)
        if self._own.trust == 0:
            return found
        return [self._judged(view, each) for view, each in zip(views, found, strict=True)]

    def _judged(self, view: PoseView, found: Segmented) -> Segmented:
        """Objects of whose classes there are chances, with those that this network makes of them.

        That an object is of no class at all stays as likely as it was.
        """
        if found.chances is None or not len(found):
            return found
        chances = found.chances.copy()
        numbers = torch.arange(len(self._own.categories), device=self.device)
        offsets = np.array(self._own.offsets or (0.0,) * len(numbers))
        of_category = [DREDS_CLASSES.index(name) for name in self._own.categories]
        for number, crop in enumerate(self._crops(view, found)):
            if crop is None:
                continue
            tried = stacked([crop] * len(numbers))
            # Not upside down, too: that would double what it costs.
            logits, _ = self._network.answer(tried.color, tried.points, tried.pixels, numbers)
            bins = logits.double().log_softmax(dim=2)
            unsure = -(bins.exp() * bins).sum(dim=2).mean(dim=(1, 2)).cpu().numpy()
            evidence = offsets - self._own.trust * unsure
            before = chances[number, of_category]
            after = before * np.exp(evidence - evidence.max())
            chances[number, of_category] = after * (before.sum() / max(after.sum(), 1e-12))
        known = chances[:, 1:]
        best = known.argmax(axis=1) + 1
        scores = known.max(axis=1)
        judged = Segmented(best.astype(np.int64), scores, found.masks, chances)
        return judged.of(np.argsort(-scores, kind="stable"))
