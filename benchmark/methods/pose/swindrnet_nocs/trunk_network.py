"""Heads for classes, objects and NOCS on a frozen SwinDRNet.

The features are those of the shipped depth restorer, which is not trained further and whose weights
are not in the head's file. The file names them by their SHA-256.
"""

from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from benchmark.methods import weights
from benchmark.methods.depth.swindrnet import swindrnet_network
from benchmark.methods.depth.swindrnet.fusion_decoder import ConvUnit, UPerHead, enlarged
from benchmark.methods.network import precisely
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import (
    BACKGROUND_CLASS,
    BACKGROUND_FIRST,
    CLASSES,
    MIDDLE,
    SwinNOCSConfig,
    SwinNOCSPrediction,
    begin,
)
from benchmark.methods.registry import COMPACT, sha256_of, shipped_weights
from std_toolkit.errors import ToolkitError

_REACH = 32.0  # pixels of an offset of 1

# Of running statistics. Those of the pooled pyramid are of a few numbers for each image: with the
# usual 0.1 the last few batches alone decide them, and the answers of a validation are worthless.
_MOMENTUM = 0.01

# Channels of the head at a quarter and at half of the resolution.
_WAY_BACK = (64, 48)


class TrunkNOCSNetwork(nn.Module):
    """`network(color, points)` to `SwinNOCSPrediction`, as `SwinNOCSNetwork`.

    The trunk is no part of the state: it is neither trained nor saved. It sees what the restorer
    sees.

    Args:
        config: `trunk_weights` names the file of the trunk; by default the one that ships.

    Raises:
        ToolkitError: the trunk's file cannot be read, or is none of compact SwinDRNet.
    """

    trunk_sha256: Tensor

    def __init__(self, config: SwinNOCSConfig) -> None:
        super().__init__()
        self.config = config
        path = Path(config.trunk_weights) if config.trunk_weights else None
        self._path = path or shipped_weights("swindrnet", COMPACT)
        trunk = swindrnet_network.SwinDRNetwork(swindrnet_network.PRESETS[COMPACT])
        weights.load_weights(trunk, self._path)
        # In a tuple, so that it is no submodule.
        self._trunk = (trunk.eval().requires_grad_(False),)
        digest = bytes.fromhex(sha256_of(self._path))
        self.register_buffer("trunk_sha256", torch.tensor(list(digest), dtype=torch.uint8))

        channels = config.head_channels
        first, *deeper = trunk.config.fused_channels
        self.decode_head = UPerHead(
            # The first level comes with what the restorer's two decoders say.
            (first + 2 * trunk.config.head_channels, *deeper),
            channels,
            channels,
            config.pool_scales,
            config.dropout,
        )
        nn.init.kaiming_normal_(self.decode_head.conv_seg.weight)
        half, quarter = _detail_channels(trunk)
        wide, narrow = _WAY_BACK
        self.to_quarter = nn.Sequential(
            ConvUnit(channels + quarter, wide, 3), ConvUnit(wide, wide, 3)
        )
        self.to_half = nn.Sequential(ConvUnit(wide + half, narrow, 3), ConvUnit(narrow, narrow, 3))
        for module in self.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.momentum = _MOMENTUM
        self.classes = nn.Conv2d(narrow, CLASSES, 1)
        self.nocs = nn.Conv2d(narrow, 3, 1)
        self.middles = nn.Conv2d(narrow, 2, 1)
        begin(self.classes, {BACKGROUND_CLASS: BACKGROUND_FIRST})
        begin(self.nocs, dict.fromkeys(range(3), MIDDLE))

    @property
    def trunk(self) -> swindrnet_network.SwinDRNetwork:
        """The restorer whose features the heads get."""
        return self._trunk[0]

    def forward(self, color: Tensor, points: Tensor) -> SwinNOCSPrediction:
        """(b, 3, h, w) and (b, 3, h, w)."""
        with torch.no_grad():
            levels, quarter, half = self._features(color, points[:, 2:])
        found = self.decode_head(levels)
        found = self.to_quarter(torch.cat([enlarged(found, quarter), quarter], dim=1))
        found = self.to_half(torch.cat([enlarged(found, half), half], dim=1))
        return SwinNOCSPrediction(
            *(
                enlarged(precisely(layer, found) * reach, color)
                for layer, reach in ((self.classes, 1), (self.nocs, 1), (self.middles, _REACH))
            )
        )

    def _features(self, color: Tensor, depth: Tensor) -> tuple[list[Tensor], Tensor, Tensor]:
        """The levels, and maps at a quarter and at half of the resolution.

        What the restorer's decoders make of the levels goes with them; the last steps, to its
        answers at the full resolution, are not needed.
        """
        trunk = self.trunk
        levels, details = trunk.features(color, depth)
        first, (_, half, quarter) = [levels[0]], details
        halves, quarters = [half], [quarter]
        for head, decoder in (
            (trunk.decode_head_depth_restoration, trunk.details_of_depth),
            (trunk.decode_head_confidence, trunk.details_of_confidence),
        ):
            first.append(head(levels))
            at_quarter, at_half = islice(decoder.maps(first[-1], details), 2)
            quarters.append(at_quarter)
            halves.append(at_half)
        levels = [torch.cat(first, dim=1), *levels[1:]]
        return levels, torch.cat(quarters, dim=1), torch.cat(halves, dim=1)

    def check_trunk(self, state: dict[str, Tensor], path: Path) -> None:
        """Refuse weights that were trained on the features of another restorer.

        Raises:
            ToolkitError: the digest in `state` is not that of this network's trunk.
        """
        wanted = state.get("trunk_sha256")
        if wanted is None or wanted.shape != self.trunk_sha256.shape:
            return  # other weights altogether: their keys say so
        if not torch.equal(wanted.cpu(), self.trunk_sha256.cpu()):
            raise ToolkitError(
                "these weights were trained on the features of another SwinDRNet than "
                f"{self._path}: its SHA-256 is not {bytes(wanted.tolist()).hex()[:16]}...",
                path=path,
                hint="give that file with --set trunk_weights=FILE",
            )

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Any:
        self.trunk._apply(fn)
        return super()._apply(fn, recurse)


def _detail_channels(trunk: swindrnet_network.SwinDRNetwork) -> tuple[int, int]:
    """Channels of the trunk's maps at half and at a quarter of the resolution: the details of both
    streams, and what two decoders make of them."""
    encoder: Any = trunk.get_submodule("backbone_rgb_branch_details")
    steps: Any = trunk.details_of_depth.steps
    _, half, quarter = steps
    return (
        2 * (encoder.to_half.conv.out_channels + half.conv.out_channels),
        2 * (encoder.to_quarter.conv.out_channels + quarter.conv.out_channels),
    )
