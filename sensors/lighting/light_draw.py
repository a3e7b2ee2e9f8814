"""Random strength of the light, and a random floor.

The floor's material is drawn from the library, or has an image from a user's folder.
"""

from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from sensors.lighting.environment import Split, files_of_split
from sensors.materials.material_draw import DrawnMaterial, collage, draw_material
from sensors.materials.material_library import load_library

# Strength of the environment in colour and in infrared (most of it filtered out) in DREDS.
COLOR_STRENGTH = 0.5

INFRARED_STRENGTH = 0.035

# Irradiance of the projector at 1 m where the pattern is bright, relative to an environment of mean
# luminance 1 of which the camera's filter blocks most. With 0.3 the dots on floors of random scenes
# have a contrast of 0.20 to 0.34 of the mean in windows of 21 pixels; on a cloth under a real D415
# it is 0.25.
PROJECTOR_POWER = 0.3

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")

FLOOR_FAMILIES = ("wood", "fabric", "leather", "paper", "clay", "coarse_plastic", "porcelain")

# Patterns are larger on a floor than on an object of the same material.
TILE_FACTOR = (2.0, 6.0)

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
) -> FloorDraw:
    """Draw a floor.

    Args:
        rng: consumed.
        folder: images (.jpg, .png) to tile the floor with, split as environment maps are; without
            a folder, textures of the library are used.
        split: images to draw from.

    Raises:
        ToolkitError: the folder has no image for the split.
    """
    library = load_library()
    names = [m.name for m in library.opaque if m.family in FLOOR_FAMILIES]
    name = names[int(rng.integers(len(names)))]
    family = next(m.family for m in library.opaque if m.name == name)
    material = draw_material(rng, library.families[family].material_class, name=name)
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


# Of busy floors: a tile of the pattern.
BUSY_TILE_M = (0.2, 1.2)


def busy(rng: np.random.Generator, floor: FloorDraw) -> FloorDraw:
    """The floor with a pattern of many colours, as of carpets, posters and stone; no image."""
    return FloorDraw(material=collage(rng, floor.material, BUSY_TILE_M))


SettingKind = Literal["plane", "table", "room"]

SETTING_SHARES: dict[SettingKind, float] = {"plane": 0.4, "table": 0.4, "room": 0.2}

# Half sides of a table top: beyond where objects come to rest.
TABLE_HALF_M = (0.36, 0.7)

TABLE_HEIGHT_M = (0.4, 0.9)

# Beyond all cameras.
WALL_AWAY_M = (1.3, 3.5)


class SettingDraw(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What surrounds the objects.

    Attributes:
        kind: plane: an endless floor; table: a table top with edges, above a ground and with walls
            metres away; room: a floor with walls.
        half_m: half sides of the table top.
        height_m: of the table top above the ground.
        turn_rad: rotation of table and walls about the vertical axis.
        walls_m: distances of the walls from the middle.
        ground, wall: their surfaces.
    """

    kind: SettingKind = "plane"
    half_m: tuple[float, float] = (0.5, 0.5)
    height_m: float = 0.75
    turn_rad: float = 0.0
    walls_m: tuple[float, ...] = ()
    ground: FloorDraw | None = None
    wall: FloorDraw | None = None


def draw_setting(
    rng: np.random.Generator, *, folder: Path | str | None = None, split: Split = "train"
) -> SettingDraw:
    """Draw what surrounds the objects; arguments as of `draw_floor`."""
    kinds = list(SETTING_SHARES)
    kind = kinds[int(rng.choice(len(kinds), p=list(SETTING_SHARES.values())))]
    if kind == "plane":
        return SettingDraw()
    count = int(rng.integers(1, 4))
    return SettingDraw(
        kind=kind,
        half_m=(float(rng.uniform(*TABLE_HALF_M)), float(rng.uniform(*TABLE_HALF_M))),
        height_m=float(rng.uniform(*TABLE_HEIGHT_M)) if kind == "table" else 0.0,
        turn_rad=float(rng.uniform(0, 2 * np.pi)),
        walls_m=tuple(float(d) for d in rng.uniform(*WALL_AWAY_M, count)),
        ground=draw_floor(rng, folder=folder, split=split) if kind == "table" else None,
        wall=draw_floor(rng, folder=folder, split=split),
    )
