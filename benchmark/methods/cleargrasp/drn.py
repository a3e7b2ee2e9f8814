"""The backbone: a dilated residual network, DRN-D (Yu et al., CVPR 2017).

Keys and shapes are those of the weights that ClearGrasp's authors publish.
"""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn.functional import relu

from benchmark.methods.cleargrasp.config import ClearGraspConfig
from benchmark.methods.resnet import BasicBlock

_WIDENED = 4  # channels that leave a bottleneck, per channel inside
_WIDTHS = (1, 2, 4, 8, 16, 32, 32, 32)  # of the levels, in those of the first


class Bottleneck(nn.Module):
    """Three convolutions, the middle one 3x3, beside a shortcut.

    Args:
        inputs: channels.
        inner: channels inside; four times as many come out.
        stride, dilation: of the middle convolution.
    """

    def __init__(self, inputs: int, inner: int, stride: int, dilation: int) -> None:
        super().__init__()
        outputs = _WIDENED * inner
        self.conv1 = nn.Conv2d(inputs, inner, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(inner)
        self.conv2 = nn.Conv2d(
            inner, inner, 3, stride, padding=dilation, dilation=dilation, bias=False
        )
        self.bn2 = nn.BatchNorm2d(inner)
        self.conv3 = nn.Conv2d(inner, outputs, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Module | None = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, features: Tensor) -> Tensor:
        shortcut = features if self.downsample is None else self.downsample(features)
        inside = relu(self.bn1(self.conv1(features)))
        inside = relu(self.bn2(self.conv2(inside)))
        return relu(self.bn3(self.conv3(inside)) + shortcut)


class DRN(nn.Module):
    """Colour to features at an eighth of its size, and finer ones at a quarter.

    Attributes:
        fine_channels, channels: of the two.
    """

    def __init__(self, config: ClearGraspConfig) -> None:
        super().__init__()
        widths = [config.width * factor for factor in _WIDTHS]
        blocks = config.blocks
        out = _WIDENED if config.bottleneck else 1
        self.layer0 = _convolutions(3, widths[0], 1, kernel=7)
        self.layer1 = _convolutions(widths[0], widths[0], blocks[0])
        self.layer2 = _convolutions(widths[0], widths[1], blocks[1], stride=2)
        self.layer3 = _residual(widths[1], widths[2], blocks[2], config, stride=2)
        self.layer4 = _residual(out * widths[2], widths[3], blocks[3], config, stride=2)
        self.layer5 = _residual(out * widths[3], widths[4], blocks[4], config, dilation=2)
        self.layer6 = _residual(out * widths[4], widths[5], blocks[5], config, dilation=4)
        self.layer7 = _convolutions(out * widths[5], widths[6], blocks[6], dilation=2)
        self.layer8 = _convolutions(widths[6], widths[7], blocks[7])
        self.fine_channels, self.channels = out * widths[2], widths[7]

    def forward(self, color: Tensor) -> tuple[Tensor, Tensor]:
        """Features (b, channels, h / 8, w / 8), and (b, fine_channels, h / 4, w / 4)."""
        fine = self.layer3(self.layer2(self.layer1(self.layer0(color))))
        features = self.layer6(self.layer5(self.layer4(fine)))
        return self.layer8(self.layer7(features)), fine


def _convolutions(
    inputs: int, outputs: int, count: int, stride: int = 1, dilation: int = 1, kernel: int = 3
) -> nn.Sequential:
    parts: list[nn.Module] = []
    for index in range(count):
        parts += [
            nn.Conv2d(
                outputs if index else inputs,
                outputs,
                kernel,
                1 if index else stride,
                padding=dilation * (kernel // 2),
                dilation=dilation,
                bias=False,
            ),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
        ]
    return nn.Sequential(*parts)


def _residual(
    inputs: int,
    width: int,
    count: int,
    config: ClearGraspConfig,
    stride: int = 1,
    dilation: int = 1,
) -> nn.Sequential:
    block = Bottleneck if config.bottleneck else BasicBlock
    outputs = _WIDENED * width if config.bottleneck else width
    return nn.Sequential(
        block(inputs, width, stride, dilation),
        *(block(outputs, width, 1, dilation) for _ in range(count - 1)),
    )
