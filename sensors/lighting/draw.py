"""How strong the light is and from where it comes, drawn at random and recorded as JSON."""

from __future__ import annotations

import msgspec
import numpy as np

COLOR_STRENGTH = 0.5
INFRARED_STRENGTH = 0.035
"""Strength of the environment in colour and in infrared (most of it filtered out) in DREDS."""
STRENGTH_FACTOR = (0.8, 1.2)
PROJECTOR_FACTOR = (0.9, 1.1)


class LightingDraw(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Light of one frame or scene.

    Attributes:
        environment: name of the map.
        rotation_rad: turn of the map about the vertical axis.
        color_strength: factor on the map while colour is rendered.
        infrared_strength: factor on the map while infrared is rendered.
        projector_factor: factor on the projector's power.
    """

    environment: str
    rotation_rad: float
    color_strength: float
    infrared_strength: float
    projector_factor: float


def draw_lighting(rng: np.random.Generator, environment: str) -> LightingDraw:
    """Draw rotation and strengths for a map of the given name; consumes four numbers."""
    return LightingDraw(
        environment=environment,
        rotation_rad=float(rng.uniform(0, 2 * np.pi)),
        color_strength=COLOR_STRENGTH * float(rng.uniform(*STRENGTH_FACTOR)),
        infrared_strength=INFRARED_STRENGTH * float(rng.uniform(*STRENGTH_FACTOR)),
        projector_factor=float(rng.uniform(*PROJECTOR_FACTOR)),
    )
