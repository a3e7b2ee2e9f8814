"""Depth models: how a simulated camera turns a scene into infrared images and depth."""

from sensors.depth_models.depth_model import (
    DEPTH_MODELS,
    DepthModel,
    DepthModelOptions,
    Illumination,
    Reading,
    make_depth_model,
)

__all__ = [
    "DEPTH_MODELS",
    "DepthModel",
    "DepthModelOptions",
    "Illumination",
    "Reading",
    "make_depth_model",
]
