"""What SwinDRNet's networks share: Swin transformers side by side, and their levels' fusion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor, nn

from benchmark.methods.swindrnet.details import BEFORE_TOKENS, TOKEN_OF_DETAILS, DetailEncoder
from benchmark.methods.swindrnet.head import UPerHead
from benchmark.methods.swindrnet.swin import PATCH, Swin


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
                self.add_module(f"{name}_details", DetailEncoder(channels))
            self.add_module(name, self._stream(BEFORE_TOKENS if settings.details else channels))

    def add_fusion(self, make: Callable[[int, int], nn.Module]) -> None:
        """Fuse the levels of two streams; `make` is called with each level and its channels."""
        for level, channels in enumerate(self.config.level_channels):
            self.add_module(f"cross_attention_{level}", make(level, channels))

    def head(self, outputs: int) -> UPerHead:
        """A decoder of the levels; where details are kept it leads to those, not to the outputs."""
        settings = self.config
        return UPerHead(
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
            TOKEN_OF_DETAILS if settings.details else PATCH,
        )
