"""Shapes that simulated scenes are made of: built in, from ShapeNet, or from any folder."""

from sensors.assets.asset import TURN_Y, Asset, canonical_frame
from sensors.assets.asset_source import (
    ASSET_SOURCES,
    AssetSource,
    SourceOptions,
    Split,
    draw_diagonal,
    open_source,
    scale_range,
)

__all__ = [
    "ASSET_SOURCES",
    "TURN_Y",
    "Asset",
    "AssetSource",
    "SourceOptions",
    "Split",
    "canonical_frame",
    "draw_diagonal",
    "open_source",
    "scale_range",
]
