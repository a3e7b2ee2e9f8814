"""Configuration of NOCS, and the ResNet backbone with a feature pyramid.

Keys and shapes of the ResNet match the ImageNet weights that torchvision publishes.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from torch import Tensor, nn
from torch.nn.functional import interpolate, max_pool2d, relu

from benchmark.methods.pose.fitting import FitSettings
from benchmark.methods.resnet import Bottleneck, residual_layer
from benchmark.methods.weights import check_keys, read_weights

CLASSES = 7  # 1 bottle to 7 aeroplane; what is of no class is not looked for

STRIDES = (4, 8, 16, 32)  # of the pyramid's levels

_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet's colours


@dataclass(frozen=True, kw_only=True)
class NOCSConfig(FitSettings):
    """NOCS; the defaults are the published sizes, where there are any.

    Attributes:
        block: `bottleneck` for a ResNet-50, as published, `basic` for the smaller blocks.
        channels: of the first level of the backbone (its inner ones for `bottleneck`).
        blocks: of its four levels.
        pyramid: channels of the feature pyramid.
        tower: convolutions of the detector before its answers.
        region_channels, region_convs: of the mask and coordinate heads.
        bins: number of bins per coordinate.
        decode: what a bin stands for: its `centre`, or its lower `edge`, as in the published
            program, which puts all coordinates 1/64 too low.
        least_score: objects below are not answered. 0.7 in the published program, whose scores
            are another detector's.
        overlap: IoU of boxes of one class above which the worse one goes.
        most: objects of an image.
        input_size: (width, height) of the images.
        fit, threshold_m: of poses, see `FitSettings`.
    """

    block: Literal["bottleneck", "basic"] = "bottleneck"
    channels: int = 64
    blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    pyramid: int = 256
    tower: int = 4
    region_channels: int = 256
    region_convs: int = 4
    bins: int = 32
    decode: Literal["centre", "edge"] = "centre"
    least_score: float = 0.3
    overlap: float = 0.5
    most: int = 30
    input_size: tuple[int, int] = (640, 360)

    @property
    def level_channels(self) -> tuple[int, ...]:
        """Channels of the backbone's four levels."""
        wider = 4 if self.block == "bottleneck" else 1
        return tuple(wider * self.channels << level for level in range(4))


PRESETS = {
    "published": NOCSConfig(),
    "compact": NOCSConfig(
        block="basic",
        blocks=(2, 2, 2, 2),
        pyramid=96,
        tower=2,
        region_channels=96,
        input_size=(224, 224),
    ),
}


class Pyramid(nn.Module):
    """Four levels of equal channels, at 1/4 to 1/32 of the image."""

    def __init__(self, config: NOCSConfig) -> None:
        super().__init__()
        self.backbone = ResNet(config)
        wide = config.pyramid
        self.lateral = nn.ModuleList(nn.Conv2d(c, wide, 1) for c in config.level_channels)
        self.smooth = nn.ModuleList(
            nn.Conv2d(wide, wide, 3, padding=1) for _ in config.level_channels
        )

    def forward(self, color: Tensor) -> list[Tensor]:
        """(b, 3, h, w) RGB in [0, 1], h and w multiples of 32."""
        mean, deviation = (color.new_tensor(v).reshape(3, 1, 1) for v in (_MEAN, _DEVIATION))
        levels = self.backbone((color - mean) / deviation)
        features = [conv(level) for conv, level in zip(self.lateral, levels, strict=True)]
        for index in range(len(features) - 1, 0, -1):
            features[index - 1] = features[index - 1] + interpolate(
                features[index], scale_factor=2.0, mode="nearest"
            )
        return [conv(feature) for conv, feature in zip(self.smooth, features, strict=True)]


class ResNet(nn.Module):
    """Four levels of features at 1/4 to 1/32 of the image."""

    def __init__(self, config: NOCSConfig) -> None:
        super().__init__()
        base = config.channels
        self.conv1 = nn.Conv2d(3, base, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(base)
        inputs = base
        for level, (outputs, blocks) in enumerate(
            zip(config.level_channels, config.blocks, strict=True)
        ):
            stride = 1 if level == 0 else 2
            if config.block == "bottleneck":
                inner = base << level
                layer = nn.Sequential(
                    Bottleneck(inputs, inner, stride),
                    *(Bottleneck(outputs, inner) for _ in range(blocks - 1)),
                )
            else:
                layer = residual_layer(inputs, outputs, blocks, stride)
            self.add_module(f"layer{level + 1}", layer)
            inputs = outputs
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out")

    def forward(self, image: Tensor) -> list[Tensor]:
        features = max_pool2d(relu(self.bn1(self.conv1(image))), 3, stride=2, padding=1)
        levels = []
        for level in range(1, 5):
            features = self.get_submodule(f"layer{level}")(features)
            levels.append(features)
        return levels


def load_imagenet(backbone: ResNet, path: Path) -> None:
    """Begin with the weights of a ResNet that was trained on ImageNet.

    Raises:
        ToolkitError: the file cannot be read, or holds a ResNet of another size or something else.
    """
    found = {k: t for k, t in read_weights(path).items() if not k.startswith("fc.")}
    # Counts of batches are missing in older files and mean nothing here.
    counts = "num_batches_tracked"
    state = {k: t for k, t in found.items() if not k.endswith(counts)}
    wanted = {k: t for k, t in backbone.state_dict().items() if not k.endswith(counts)}
    check_keys(wanted, state, path)
    backbone.load_state_dict(state, strict=False)
