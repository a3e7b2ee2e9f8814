"""Materials of the simulator: a library of ranges, draws from it, and procedural textures."""

from sensors.materials.material_draw import (
    ClassChoice,
    DrawnMaterial,
    DrawnTexture,
    Glass,
    decode_material,
    draw_material,
    draw_material_class,
    load_class_choice,
)
from sensors.materials.material_library import (
    MATERIAL_CLASSES,
    MaterialClass,
    MaterialLibrary,
    class_id,
    load_library,
)
from sensors.materials.textures import make_texture

__all__ = [
    "MATERIAL_CLASSES",
    "ClassChoice",
    "DrawnMaterial",
    "DrawnTexture",
    "Glass",
    "MaterialClass",
    "MaterialLibrary",
    "class_id",
    "decode_material",
    "draw_material",
    "draw_material_class",
    "load_class_choice",
    "load_library",
    "make_texture",
]
