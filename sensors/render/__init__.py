"""Rendering of the simulator: infrared pairs, colour and exact maps of a scene."""

from sensors.render.color_image import denoise, develop
from sensors.render.infrared_image import InfraredResponse, expose_pair
from sensors.render.sim_renderer import (
    DRAFT_COLOR,
    DRAFT_INFRARED,
    FINE_INFRARED,
    SIM_RENDERERS,
    ColorLight,
    LoadedScene,
    RenderOptions,
    SimRenderer,
)
from sensors.render.sim_scene import (
    Projector,
    SceneObject,
    SimScene,
    SurfaceMesh,
    TruthCaster,
    TruthMaps,
)

__all__ = [
    "DRAFT_COLOR",
    "DRAFT_INFRARED",
    "FINE_INFRARED",
    "SIM_RENDERERS",
    "ColorLight",
    "InfraredResponse",
    "LoadedScene",
    "Projector",
    "RenderOptions",
    "SceneObject",
    "SimRenderer",
    "SimScene",
    "SurfaceMesh",
    "TruthCaster",
    "TruthMaps",
    "denoise",
    "develop",
    "expose_pair",
]
