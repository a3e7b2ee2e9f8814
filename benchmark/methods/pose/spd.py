"""SPD: configuration, colour features, network, pose estimator.

Colour features are those of DenseFusion in SPD's form: a ResNet with pyramid pooling (Zhao et al.,
CVPR 2017) of four levels with a quarter of the channels each, and three upsampling steps to the
resolution of the patch.

Form `released` is that of the authors' program and weights, for SPD and SGPA: its ResNet has no
batch normalisation. Form `normalised` has it, and can start from ImageNet weights of ResNet-18.

Source: Tian, Ang, Lee, "Shape Prior Deformation for Categorical 6D Object Pose and Size
Estimation", ECCV 2020.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import interpolate, relu

from benchmark.methods.network import network_of
from benchmark.methods.pointnet.grouping import at
from benchmark.methods.pointnet.layers import SharedMLP
from benchmark.methods.pose.crop_estimator import CropConfig, CropEstimator, CropNetwork
from benchmark.methods.pose.deformation import Deformed, Deformer
from benchmark.methods.pose.priors.prior_file import Priors, load_priors
from benchmark.methods.pose.released_keys import spd_state
from benchmark.methods.registry import MethodOptions
from benchmark.methods.resnet import residual_layer
from benchmark.methods.weights import check_keys, read_weights
from std_toolkit.errors import ToolkitError
from std_toolkit.io.foreign_files import read_npy

_IMAGENET_MEAN, _IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

_PARTS = ("conv1", "bn1", "layer1", "layer2", "layer3", "layer4")

_COUNT = "num_batches_tracked"  # missing in older files, and without meaning here


@dataclass(frozen=True, kw_only=True)
class PriorNetworkConfig(CropConfig):
    """What networks that deform a prior share, beside `CropConfig`.

    Attributes:
        form: `released` or `normalised`, see above.
        priors: file of priors, `builtin`, or the authors' .npy file in the order of the categories.
        prior_points: of a prior.
        color_width, color_blocks, color_decoder: see `PatchFeatures`.
        color: channels of the colour features of a point.
        geometry: channels of the geometry features of a point.
        width: channels of the features of a whole object.
        hidden: widths of the heads.
        centred: whether points are moved so that their mean is at 0, and divided by their mean
            distance from it. As published they are in metres in the camera frame, so that a network
            must learn places that it was never shown.
    """

    form: Literal["released", "normalised"] = "released"
    priors: str = "builtin"
    prior_points: int = 1024
    color_width: int = 64
    color_blocks: tuple[int, ...] = (2, 2, 2, 2)
    color_decoder: tuple[int, ...] = (256, 64, 64, 32)
    color: int = 64
    geometry: int = 64
    width: int = 1024
    hidden: tuple[int, ...] = (512, 256)
    centred: bool = False


@dataclass(frozen=True, kw_only=True)
class SPDConfig(PriorNetworkConfig):
    """The network; see `PriorNetworkConfig`."""


# Of the compact networks that deform a prior.
COMPACT: dict[str, Any] = {
    "form": "normalised",
    "side": 96,
    "points": 512,
    "color_width": 32,
    "color_decoder": (64, 32, 32, 32),
    "width": 256,
    "hidden": (256, 128),
    "centred": True,
}

PRESETS = {"published": SPDConfig(), "compact": SPDConfig(**COMPACT)}
PRESETS["small"] = replace(
    PRESETS["compact"],
    color_width=20,
    color_decoder=(48, 24, 24, 24),
    width=160,
    hidden=(160, 96),
)


class PriorNetwork(CropNetwork):
    """What knows the priors and sees objects as the configuration says.

    Raises:
        ToolkitError: no priors, or of another number of points.
    """

    prior: Tensor

    def __init__(self, config: PriorNetworkConfig) -> None:
        super().__init__(config)
        self.config: PriorNetworkConfig = config
        points = _priors_of(config)
        if points.shape[1] != config.prior_points:
            raise ToolkitError(
                f"the priors have {points.shape[1]} points",
                field="prior_points",
                value=config.prior_points,
            )
        # Kept with the weights: another prior would be another network.
        self.register_buffer("prior", torch.from_numpy(points))

    def seen(self, points: Tensor) -> Tensor:
        """Points as the network sees them."""
        if not self.config.centred:
            return points
        apart = points - points.mean(dim=1, keepdim=True)
        return apart / apart.norm(dim=2).mean(dim=1).clamp(min=1e-6)[:, None, None]

    def color_features(self) -> PatchFeatures:
        """A new network over colour."""
        config = self.config
        return PatchFeatures(
            width=config.color_width,
            blocks=config.color_blocks,
            decoder=config.color_decoder,
            outputs=config.color,
            released=config.form == "released",
        )

    def deformer(self, local: int, prior_local: int) -> Deformer:
        """New heads over features of these channels."""
        config = self.config
        return Deformer(
            local,
            prior_local,
            width=config.width,
            hidden=config.hidden,
            categories=len(config.categories),
            prior_points=config.prior_points,
            prior_hidden=local if config.form == "released" else None,
        )


def _priors_of(config: PriorNetworkConfig) -> NDArray[np.float32]:
    """(c, p, 3) points."""
    if not config.priors.endswith(".npy"):
        return load_priors(config.priors).of(config.categories)
    path = Path(config.priors)
    points = read_npy(path)
    if points.ndim != 3 or points.shape[::2] != (len(config.categories), 3):
        raise ToolkitError(
            "must be points (c, p, 3) of the categories",
            path=path,
            value=points.shape,
            hint=f"categories={','.join(config.categories)}",
        )
    named = dict(zip(config.categories, points.astype(np.float32), strict=True))
    return Priors(named).of(config.categories)


class SPDNetwork(PriorNetwork):
    """Patches and points of objects to `Deformed`.

    Raises:
        ToolkitError: no priors, or of another number of points.
    """

    def __init__(self, config: SPDConfig) -> None:
        super().__init__(config)
        g = config.geometry
        self.color = self.color_features()
        self.geometry = SharedMLP(3, (g, g, g), normalised=False)
        self.prior_geometry = SharedMLP(3, (g, g, g), normalised=False)
        self.heads = self.deformer(config.color + g, g)

    def forward(self, color: Tensor, points: Tensor, pixels: Tensor, category: Tensor) -> Deformed:
        """Objects.

        Args:
            color: (b, 3, s, s) RGB in [0, 1].
            points: (b, n, 3) metres in the camera frame.
            pixels: (b, n) place of each point in the patch.
            category: (b,) place of its category in the configuration's.
        """
        points, prior = self.seen(points), self.prior[category]
        local = torch.cat([self.geometry(points.transpose(1, 2)), self.color(color, pixels)], dim=1)
        prior_local = self.prior_geometry(prior.transpose(1, 2))
        return self.heads(local, prior_local, prior, points, category)


class PatchFeatures(nn.Module):
    """Colour (b, 3, s, s) in [0, 1] to features (b, `outputs`, n) at n pixels of the patch.

    Args:
        width: channels of the first layer of the ResNet; 64 for ResNet-18.
        blocks: residual blocks of its four layers.
        bins: sides of the pooled grids.
        decoder: channels after pooling and after each doubling but the last, and of the last.
        outputs: channels.
        released: the form of the authors' program.
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self,
        *,
        width: int = 64,
        blocks: Sequence[int] = (2, 2, 2, 2),
        bins: Sequence[int] = (1, 2, 3, 6),
        decoder: Sequence[int] = (256, 64, 64, 32),
        outputs: int = 64,
        released: bool = False,
    ) -> None:
        super().__init__()
        self.aligned = released  # corners in interpolation
        layer = partial(residual_layer, normalised=not released)
        self.conv1 = nn.Conv2d(3, width, 7, 2, 3, bias=False)
        self.bn1 = nn.Identity() if released else nn.BatchNorm2d(width)
        self.pool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = layer(width, width, blocks[0])
        self.layer2 = layer(width, 2 * width, blocks[1], stride=2)
        # Dilated instead of strided: an eighth of the resolution is left.
        self.layer3 = layer(2 * width, 4 * width, blocks[2], dilation=2)
        self.layer4 = layer(4 * width, 8 * width, blocks[3], dilation=4)
        deep = 8 * width
        self.levels = nn.ModuleList(
            nn.Sequential(
                nn.AdaptiveAvgPool2d(b), nn.Conv2d(deep, deep // len(bins), 1, bias=False)
            )
            for b in bins
        )
        channels = deep + len(bins) * (deep // len(bins))
        self.up = nn.ModuleList()
        for channel in decoder[:-1]:
            self.up.append(nn.Sequential(nn.Conv2d(channels, channel, 3, padding=1), nn.PReLU()))
            channels = channel
        self.final = nn.Conv2d(channels, decoder[-1], 1)
        self.each = nn.Sequential(nn.Conv1d(decoder[-1], outputs, 1), nn.ReLU())
        self.outputs = outputs
        self.register_buffer("mean", torch.tensor(_IMAGENET_MEAN)[:, None, None], persistent=False)
        self.register_buffer("std", torch.tensor(_IMAGENET_STD)[:, None, None], persistent=False)

    def forward(self, color: Tensor, pixels: Tensor) -> Tensor:
        """Features (b, c, n) at pixels (b, n), row * s + column."""
        x = (color - self.mean) / self.std
        x = self.pool(relu(self.bn1(self.conv1(x))))
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))
        size = x.shape[-2:]
        enlarged = partial(interpolate, mode="bilinear", align_corners=self.aligned)
        if self.aligned:
            pooled = [enlarged(relu(level(x)), size) for level in self.levels]
        else:
            pooled = [relu(enlarged(level(x), size)) for level in self.levels]
        x = torch.cat([x, *pooled], dim=1)
        for up in self.up:
            x = up(enlarged(x, scale_factor=2.0))
        # The last layer at the pixels that count alone: the same numbers for less work.
        features = at(x.flatten(2), pixels)
        return self.each(self.final(features[..., None])[..., 0])


def load_imagenet(network: PriorNetwork, path: Path) -> None:
    """Begin the ResNet over colour with one that was trained on ImageNet.

    Raises:
        ToolkitError: the file cannot be read, or holds another network.
    """
    color = network.get_submodule("color")
    assert isinstance(color, PatchFeatures)
    if color.aligned:
        raise ToolkitError(
            "the form of the authors' program has no batch normalisation",
            path=path,
            hint="give --set form=normalised",
        )
    wanted, state = (
        {
            key: tensor
            for key, tensor in tensors.items()
            if key.partition(".")[0] in _PARTS and not key.endswith(_COUNT)
        }
        for tensors in (color.state_dict(), read_weights(path))
    )
    check_keys(wanted, state, path)
    color.load_state_dict(state, strict=False)


class SPD(CropEstimator):
    """A prior of the category, deformed to the object; settings are those of `SPDConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    settings_type = SPDConfig

    def __init__(self, options: MethodOptions) -> None:
        _, network = network_of("spd", PRESETS, SPDNetwork, options, renamed=spd_state)
        super().__init__(network, options)
