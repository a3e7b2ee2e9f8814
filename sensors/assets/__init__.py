"""Shapes that simulated scenes are made of: built in, from ShapeNet, or from any folder."""

from sensors.assets.asset import TURN_Y, Asset, canonical_frame
from sensors.assets.scales import draw_diagonal, scale_range
from sensors.assets.source import ASSET_SOURCES, AssetSource, SourceOptions, Split, open_source

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
