"""Random strength of the light, and a random floor.

The floor's material is drawn from the library, or has an image from a user's folder.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from sensors.lighting.environment import Split, files_of_split
from sensors.materials.material_draw import DrawnMaterial, draw_material
from sensors.materials.material_library import MaterialLibrary, load_library

COLOR_STRENGTH = 0.5

INFRARED_STRENGTH = 0.035

# Irradiance of the projector at 1 m where the pattern is bright, relative to an environment of mean
# luminance 1 of which the camera's filter blocks most. With 0.3 the dots on floors of random scenes
# have a contrast of 0.20 to 0.34 of the mean in windows of 21 pixels; on a cloth under a real D415
# it is 0.25.
PROJECTOR_POWER = 0.3

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")

FLOOR_FAMILIES = ("wood", "fabric", "leather", "paper", "clay", "coarse_plastic", "porcelain")

TILE_FACTOR = (2.0, 6.0)


"""Strength of the environment in colour and in infrared (most of it filtered out) in DREDS."""

STRENGTH_FACTOR = (0.8, 1.2)

PROJECTOR_FACTOR = (0.9, 1.1)


class LightingDraw(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Light of one frame or scene.

    Attributes:
        environment: name of the map.
        rotation_rad: rotation of the map about the vertical axis.
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


"""Patterns are larger on a floor than on an object of the same material."""

IMAGE_TILE_M = (0.4, 1.5)


class FloorDraw(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A floor.

    Attributes:
        material: its surface.
        image: file of its own texture, or None for the material's colour alone.
        image_tile_m: extent of the image on the floor, metres.
    """

    material: DrawnMaterial
    image: str | None = None
    image_tile_m: float = 1.0


def draw_floor(
    rng: np.random.Generator,
    *,
    folder: Path | str | None = None,
    split: Split = "train",
    library: MaterialLibrary | None = None,
) -> FloorDraw:
    """Draw a floor.

    Args:
        rng: consumed.
        folder: images (.jpg, .png) to tile the floor with, split as environment maps are; without
            a folder, textures of the library are used.
        split: images to draw from.
        library: materials; the built-in ones by default.

    Raises:
        ToolkitError: the folder has no image for the split, or the library no suitable material.
    """
    library = library or load_library()
    names = [m.name for m in library.opaque if m.family in FLOOR_FAMILIES]
    name = names[int(rng.integers(len(names)))]
    family = next(m.family for m in library.opaque if m.name == name)
    material = draw_material(
        rng, library.families[family].material_class, name=name, library=library
    )
    texture = material.texture
    if texture is not None:
        texture = msgspec.structs.replace(
            texture, tile_m=texture.tile_m * float(rng.uniform(*TILE_FACTOR))
        )
    image, share, tile = None, 0.0, 1.0
    if folder is not None:
        files = files_of_split(folder, split, IMAGE_SUFFIXES)
        image, share = str(files[int(rng.integers(len(files)))]), material.own_share
        tile = float(rng.uniform(*IMAGE_TILE_M))
    # A floor has a texture of its own only if it has an image.
    material = msgspec.structs.replace(material, texture=texture, own_share=share)
    return FloorDraw(material=material, image=image, image_tile_m=tile)
