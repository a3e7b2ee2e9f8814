"""The floor's material: drawn from the library, or with an image of a user's folder."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from sensors.lighting.folder import Split, files_of_split
from sensors.materials import DrawnMaterial, MaterialLibrary, draw_material, load_library

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
FLOOR_FAMILIES = ("wood", "fabric", "leather", "paper", "clay", "coarse_plastic", "porcelain")
TILE_FACTOR = (2.0, 6.0)
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
        folder: images (.jpg, .png) to tile the floor with, the splits kept apart as for
            environment maps; without one the library's textures serve.
        split: which images to draw from.
        library: materials; the built-in ones by default.

    Raises:
        ToolkitError: the folder has no image for the split, or the library no fitting material.
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
    # A floor has no look of its own unless it has an image.
    material = msgspec.structs.replace(material, texture=texture, own_share=share)
    return FloorDraw(material=material, image=image, image_tile_m=tile)
