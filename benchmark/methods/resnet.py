"""Normalised convolutions; residual blocks of ResNet-18, -34 and -50 (He et al., CVPR 2016).

Keys and shapes match the ImageNet weights that torchvision publishes.
"""

from torch import Tensor, nn
from torch.nn.functional import relu

WIDENED = 4  # channels that leave a bottleneck, per channel inside


def convolution(
    inputs: int,
    outputs: int,
    kernel: int = 3,
    stride: int = 1,
    dilation: int = 1,
    *,
    bias: bool = False,
) -> nn.Sequential:
    """Convolution, batch normalisation, ReLU; a stride of 1 keeps the size."""
    padding = dilation * (kernel // 2)
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, padding, dilation, bias=bias),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    )


class BasicBlock(nn.Module):
    """Two 3x3 convolutions beside a shortcut.

    Args:
        inputs, outputs: channels.
        stride: of the first convolution.
        dilation: of both.
        normalised: whether there is batch normalisation.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        stride: int = 1,
        dilation: int = 1,
        *,
        normalised: bool = True,
    ) -> None:
        super().__init__()
        norm = nn.BatchNorm2d if normalised else nn.Identity
        self.conv1 = nn.Conv2d(
            inputs, outputs, 3, stride, padding=dilation, dilation=dilation, bias=False
        )
        self.bn1 = norm(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=dilation, dilation=dilation, bias=False)
        self.bn2 = norm(outputs)
        self.downsample = _shortcut(inputs, outputs, stride, normalised=normalised)

    def forward(self, features: Tensor) -> Tensor:
        shortcut = features if self.downsample is None else self.downsample(features)
        inner = relu(self.bn1(self.conv1(features)))
        return relu(self.bn2(self.conv2(inner)) + shortcut)


class Bottleneck(nn.Module):
    """1x1, 3x3 and 1x1 convolutions beside a shortcut.

    Args:
        inputs: channels.
        inner: channels inside; `WIDENED` times as many come out.
        stride, dilation: of the 3x3 convolution.
    """

    def __init__(self, inputs: int, inner: int, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        outputs = WIDENED * inner
        self.conv1 = nn.Conv2d(inputs, inner, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(inner)
        self.conv2 = nn.Conv2d(
            inner, inner, 3, stride, padding=dilation, dilation=dilation, bias=False
        )
        self.bn2 = nn.BatchNorm2d(inner)
        self.conv3 = nn.Conv2d(inner, outputs, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.downsample = _shortcut(inputs, outputs, stride)

    def forward(self, features: Tensor) -> Tensor:
        shortcut = features if self.downsample is None else self.downsample(features)
        inner = relu(self.bn1(self.conv1(features)))
        inner = relu(self.bn2(self.conv2(inner)))
        return relu(self.bn3(self.conv3(inner)) + shortcut)


def _shortcut(
    inputs: int, outputs: int, stride: int, *, normalised: bool = True
) -> nn.Module | None:
    """None where the features pass unchanged."""
    if stride == 1 and inputs == outputs:
        return None
    convolution = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
    return nn.Sequential(convolution, *([nn.BatchNorm2d(outputs)] if normalised else []))


def residual_layer(
    inputs: int,
    outputs: int,
    blocks: int,
    stride: int = 1,
    dilation: int = 1,
    *,
    normalised: bool = True,
) -> nn.Sequential:
    """Some blocks in a row, the first of which may change resolution and channels.

    Without batch normalisation, as in DenseFusion, the first block is not dilated.
    """
    first = dilation if normalised else 1
    return nn.Sequential(
        BasicBlock(inputs, outputs, stride, first, normalised=normalised),
        *(
            BasicBlock(outputs, outputs, 1, dilation, normalised=normalised)
            for _ in range(blocks - 1)
        ),
    )
