"""SwinDRNet (Dai et al., ECCV 2022): configuration, streams, network.

The streams, Swin transformers with fusion at each level, are shared with the pose network.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import torch
from torch import Tensor, nn

from benchmark.methods import network, relative_depth
from benchmark.methods.depth.swindrnet import fusion_decoder
from benchmark.methods.depth.swindrnet.swin import PATCH, Swin

_DEPTH_COPIES = 3  # depth goes into a network of three channels, which ImageNet weights fit


class Features(NamedTuple):
    """What the streams make of an image.

    Attributes:
        levels: four maps (b, c, h, w), each of half the resolution of the one before: what the
            decoders get.
        details: maps at the whole, half and quarter of the resolution; none without `details`.
    """

    levels: list[Tensor]
    details: list[Tensor]


class StreamSettings(Protocol):
    """What a configuration says of streams and decoders; see `SwinDRNetConfig`."""

    @property
    def channels(self) -> int: ...
    @property
    def level_channels(self) -> tuple[int, ...]: ...
    @property
    def fused_channels(self) -> tuple[int, ...]: ...
    @property
    def depths(self) -> tuple[int, int, int, int]: ...
    @property
    def heads(self) -> tuple[int, int, int, int]: ...
    @property
    def window(self) -> int: ...
    @property
    def head_channels(self) -> int: ...
    @property
    def pool_scales(self) -> tuple[int, ...]: ...
    @property
    def details(self) -> bool: ...
    @property
    def drop_path(self) -> float: ...
    @property
    def dropout(self) -> float: ...


class SwinStreams(nn.Module):
    """Streams, and what they are fused by, under the published names; a network adds decoders.

    Args:
        settings: sizes.
        images: the streams' names, and the channels of the images that they get.
    """

    config: StreamSettings

    def __init__(self, settings: StreamSettings, images: Mapping[str, int]) -> None:
        super().__init__()
        self.config = settings
        self._names = tuple(images)
        for name, channels in images.items():
            if settings.details:
                self.add_module(f"{name}_details", fusion_decoder.DetailEncoder(channels))
            self.add_module(
                name, self._stream(fusion_decoder.BEFORE_TOKENS if settings.details else channels)
            )

    def add_fusion(self, make: Callable[[int, int], nn.Module]) -> None:
        """Fuse the levels of two streams; `make` is called with each level and its channels."""
        for level, channels in enumerate(self.config.level_channels):
            self.add_module(f"cross_attention_{level}", make(level, channels))

    def head(self, outputs: int) -> fusion_decoder.UPerHead:
        """A decoder of the levels; where details are kept it leads to those, not to the outputs."""
        settings = self.config
        return fusion_decoder.UPerHead(
            settings.fused_channels,
            settings.head_channels,
            settings.head_channels if settings.details else outputs,
            settings.pool_scales,
            settings.dropout,
        )

    def features_of(self, images: Sequence[Tensor]) -> Features:
        """What the decoders get, of what each stream is shown."""
        pyramids, all_details = [], []
        for name, image in zip(self._names, images, strict=True):
            if self.config.details:
                all_details.append(self.get_submodule(f"{name}_details")(image))
                image = all_details[-1][-1]
            pyramids.append(self.get_submodule(name)(image))
        levels = pyramids[0]
        if len(pyramids) > 1:
            levels = [
                self.get_submodule(f"cross_attention_{level}")(*pair)
                for level, pair in enumerate(zip(*pyramids, strict=True))
            ]
        return Features(
            [level.permute(0, 3, 1, 2) for level in levels],
            [torch.cat(of_streams, dim=1) for of_streams in zip(*all_details, strict=True)],
        )

    def _stream(self, in_channels: int) -> Swin:
        settings = self.config
        return Swin(
            settings.channels,
            settings.depths,
            settings.heads,
            settings.window,
            in_channels,
            settings.drop_path,
            fusion_decoder.TOKEN_OF_DETAILS if settings.details else PATCH,
        )


@dataclass(frozen=True, kw_only=True)
class SwinDRNetConfig:
    """SwinDRNet; the defaults are the network whose weights were published.

    Attributes:
        fusion: how colour and depth meet. `released` is what the published program computes, a
            perceptron per pixel: its attention has no effect. `paper` is the paper's formula,
            attention from colour to depth and from depth to colour. `none` is the ablation
            without fusion: one stream over colour and depth together.
        confidence: whether the sensor's depth is blended in by a confidence map.
        channels: of the first of four levels; each next one has twice as many.
        depths, heads: blocks and attention heads of each level.
        window: side of the windows that the Swin transformers attend within, in tokens.
        head_channels: of the two decoders.
        pool_scales: sides of the decoders' pooled pyramids.
        fusion_heads: attention heads of the `paper` fusion.
        fusion_window: side of the windows that the `paper` fusion attends within. None is the
            paper's formula: every token attends to the whole image.
        relative: whether input and output depth are relative to what the sensor measured
            (`benchmark.methods.relative_depth`), and trusts no pixel that the sensor did not
            measure. The published network works in metres, and has to learn the latter.
        details: whether convolutions lead from the pixels to tokens of 8x8 pixels, and from the
            decoders' answers back to every pixel (`fusion_decoder`). As
            published, tokens are linear maps of 4x4 pixels and a map of a quarter of the
            resolution is enlarged: true depth, shrunk and enlarged so, has an error of 14 mm on
            objects at 224x224.
        drop_path, dropout: chances in training to leave a block, and a channel, out.
        input_size: (width, height) of the images.
        interleaved: whether the restorer takes images of twice the width, restores their even and
            their odd columns one by one and puts them together again: 448x224, as the paper
            prepares depth for SGPA.
    """

    fusion: Literal["released", "paper", "none"] = "released"
    confidence: bool = True
    channels: int = 96
    depths: tuple[int, int, int, int] = (2, 2, 6, 2)
    heads: tuple[int, int, int, int] = (3, 6, 12, 24)
    window: int = 7
    head_channels: int = 512
    pool_scales: tuple[int, ...] = (1, 2, 3, 6)
    fusion_heads: int = 1
    fusion_window: int | None = None
    relative: bool = False
    details: bool = False
    drop_path: float = 0.2
    dropout: float = 0.1
    input_size: tuple[int, int] = (224, 224)
    interleaved: bool = False

    @property
    def level_channels(self) -> tuple[int, ...]:
        """Channels of the four levels of one stream."""
        return tuple(self.channels << level for level in range(4))

    @property
    def fused_channels(self) -> tuple[int, ...]:
        """Channels of the four levels that the decoders get."""
        copies = {"released": 3, "paper": 4, "none": 1}[self.fusion]
        return tuple(copies * channels for channels in self.level_channels)


PRESETS = {
    "published": SwinDRNetConfig(),
    "compact": SwinDRNetConfig(
        fusion="paper",
        channels=32,
        heads=(1, 2, 4, 8),
        head_channels=96,
        relative=True,
        details=True,
        drop_path=0.1,
        input_size=network.COMPACT_SIZE,
    ),
}


class SwinDRNetwork(SwinStreams):
    """`network(color, depth)` to `Prediction`: depth, initial depth, confidence of the sensor.

    Colour is RGB in [0, 1], not normalised further, and depth is in metres, as in the published
    program. Nothing is clamped: a predicted depth may be negative.
    """

    config: SwinDRNetConfig
    backbone: Swin
    backbone_rgb_branch: Swin
    backbone_xyz_branch: Swin

    def __init__(self, config: SwinDRNetConfig | None = None) -> None:
        config = config or SwinDRNetConfig()
        images = _images_of(config)
        super().__init__(config, images)
        self.decode_head_depth_restoration = self.head(1)
        if config.confidence:
            self.decode_head_confidence = self.head(2)
        if config.details:
            self.details_of_depth = fusion_decoder.DetailDecoder(
                config.head_channels, len(images), 1
            )
            if config.confidence:
                self.details_of_confidence = fusion_decoder.DetailDecoder(
                    config.head_channels, len(images), 2
                )
        if config.fusion == "released":
            self.add_fusion(
                lambda _, channels: fusion_decoder.ReleasedFusion(channels, config.window)
            )
        elif config.fusion == "paper":
            self.add_fusion(
                lambda _, channels: fusion_decoder.PaperFusion(
                    channels, config.fusion_heads, config.fusion_window
                )
            )

    def forward(self, color: Tensor, depth: Tensor) -> network.Prediction:
        """Restore depth.

        Args:
            color: (b, 3, h, w) RGB in [0, 1].
            depth: (b, 1, h, w) metres, 0 where the sensor measured nothing.
        """
        found = self.features(color, depth)
        confidence = self.decode_head_confidence(found.levels) if self.config.confidence else None
        initial = self.decode_head_depth_restoration(found.levels)
        return self.answer(depth, found.details, initial, confidence)

    def features(self, color: Tensor, depth: Tensor) -> Features:
        """What the decoders get; of colour and depth as `forward` does."""
        return self.features_of(self._images(color, depth))

    def _images(self, color: Tensor, depth: Tensor) -> list[Tensor]:
        """What each stream is shown."""
        config = self.config
        measured = (depth > 0).to(depth.dtype)
        if config.relative:
            color, depth = relative_depth.relative_color(color), relative_depth.network_depth(depth)
        if config.details:
            depth = torch.cat([depth, measured], dim=1)
        if config.fusion == "none":
            return [torch.cat([color, depth], dim=1)]
        if config.details:
            return [color, depth]
        return [color, depth.expand(-1, _DEPTH_COPIES, -1, -1)]

    def answer(
        self, depth: Tensor, details: list[Tensor], initial: Tensor, confidence: Tensor | None
    ) -> network.Prediction:
        """What the decoders' maps say; that of confidence is None without such a decoder."""
        config = self.config
        if config.details:
            initial = self.details_of_depth(initial, details)
        initial = fusion_decoder.enlarged(initial, depth)
        if config.relative:
            initial = relative_depth.in_metres(relative_depth.coarse_depth(depth), initial)
        if confidence is None:
            return network.Prediction(initial, initial)
        if config.details:
            confidence = self.details_of_confidence(confidence, details)
        confidence = fusion_decoder.enlarged(confidence, depth)
        if config.relative:
            nothing = torch.cat([depth == 0, torch.zeros_like(depth, dtype=torch.bool)], dim=1)
            confidence = confidence.masked_fill(nothing, -torch.inf)
        return blended(depth, initial, confidence)


def blended(depth: Tensor, initial: Tensor, logits: Tensor) -> network.Prediction:
    """The sensor's depth and the predicted one, by a softmax over their two logits (b, 2, h, w)."""
    of_sensor, of_initial = logits.softmax(dim=1).split(1, dim=1)
    return network.Prediction(of_sensor * depth + of_initial * initial, initial, of_sensor)


def _images_of(config: SwinDRNetConfig) -> dict[str, int]:
    """The streams' names, and the channels of the images that they get.

    Where details are kept, depth comes with whether it was measured.
    """
    if config.fusion == "none":
        return {"backbone": 5 if config.details else 4}
    of_depth = 2 if config.details else _DEPTH_COPIES
    return {"backbone_rgb_branch": 3, "backbone_xyz_branch": of_depth}
