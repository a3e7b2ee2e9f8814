"""The library of materials: base values and ranges, read from `materials.json` or a user's file.

One set of parameters (of the "principled" BSDF) describes every opaque material, and one every
glass. The parameter values, not a separate shader, make a surface diffuse or specular, so that a
renderer needs one compiled kernel for all materials.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import InvalidDocument, read_document

MaterialClass = Literal["raw", "diffuse", "transparent", "specular"]
MATERIAL_CLASSES: tuple[MaterialClass, ...] = ("raw", "diffuse", "transparent", "specular")
"""Position in this tuple is the class id that the DREDS layout stores."""

TextureKind = Literal[
    "brushed",
    "checks",
    "collage",
    "grain",
    "leather",
    "marble",
    "paper",
    "print",
    "speckle",
    "stripes",
    "weave",
    "wood",
]
PARAMETERS = (
    "metallic",
    "specular",
    "spec_tint",
    "roughness",
    "anisotropic",
    "sheen",
    "sheen_tint",
    "clearcoat",
    "clearcoat_gloss",
)
BUILT_IN = Path(__file__).with_name("materials.json")

Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Range = tuple[float, float]
Color = tuple[Share, Share, Share]


class Document(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all structures of a material file; unknown keys are errors."""


class TextureRange(Document, frozen=True, kw_only=True):
    """A procedural texture of a material.

    Attributes:
        kind: pattern; see `textures.make_texture`.
        tile_m: range of the extent of one tile on the surface, metres.
        contrast: range of the pattern's contrast, 0..1.
    """

    kind: TextureKind
    tile_m: Range
    contrast: Range

    def __post_init__(self) -> None:
        _check_range(self.tile_m, "tile_m", 1e-3, 5.0)
        _check_range(self.contrast, "contrast", 0.0, 1.0)


class Family(Document, frozen=True, kw_only=True):
    """Properties shared by materials of one kind.

    Attributes:
        material_class: class of its members.
        jitter: parameter to the range that is added to the base value.
        mix_probability: probability that the object's own colour is mixed in.
        infrared_pattern: range of the fraction of a visible pattern's contrast that remains at
            850 nm.
    """

    material_class: MaterialClass
    jitter: dict[str, Range]
    mix_probability: Share = 1.0
    infrared_pattern: Range = (1.0, 1.0)

    def __post_init__(self) -> None:
        _check_jitter(self.jitter)
        _check_range(self.infrared_pattern, "infrared_pattern", 0.0, 1.0)


class BaseValues(Document, frozen=True, kw_only=True):
    """Parameters of the BSDF before the jitter, each 0..1."""

    metallic: Share
    specular: Share
    spec_tint: Share
    roughness: Share
    anisotropic: Share
    sheen: Share
    sheen_tint: Share
    clearcoat: Share
    clearcoat_gloss: Share


class OpaqueMaterial(Document, frozen=True, kw_only=True):
    """A specular or diffuse material.

    Attributes:
        color: two corners of the box of linear RGB reflectances to draw from.
        infrared: range of the reflectance at 850 nm, the wavelength of depth-camera projectors;
            None: equal to the visible reflectance.
        jitter: ranges that replace the family's, by parameter.
    """

    name: str
    family: str
    base: BaseValues
    color: tuple[Color, Color]
    infrared: Range | None = None
    texture: TextureRange | None = None
    jitter: dict[str, Range] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        _check_box(self.color, "color")
        if self.infrared is not None:
            _check_range(self.infrared, "infrared", 0.0, 1.0)
        _check_jitter(self.jitter)


class GlassMaterial(Document, frozen=True, kw_only=True):
    """A transparent material. `sensors.render.glass` has its optics.

    Attributes:
        ior: range of the index of refraction, which sets the reflections.
        roughness: range of the roughness of the refracting surface, 0..1.
        transmission: range of the fraction of light that passes the two walls of a hollow object,
            its reflections apart. A face passes the fourth root.
        bend: range of the share of the refraction that a wall as thick as the mesh's has; 1 for
            glass, near 0 for sheets of plastic, through which light passes straight.
        waves_deg: range of the deviation of light by each face, in degrees; walls are wrinkled,
            dented and of uneven thickness.
        wave_m: range of the distance between two wrinkles, metres.
        haze: range of the fraction of light that each face scatters evenly, 0..0.5.
        gloss_roughness: range of the roughness of the highlights of lamps, 0..1.
        tint: two corners of the box of linear RGB transmittances of a hollow object.
    """

    name: str
    family: str
    ior: Range
    roughness: Range
    transmission: Range
    bend: Range
    waves_deg: Range
    wave_m: Range
    haze: Range
    gloss_roughness: Range
    tint: tuple[Color, Color]

    def __post_init__(self) -> None:
        _check_range(self.ior, "ior", 1.01, 3.0)
        for name in ("roughness", "transmission", "bend", "gloss_roughness"):
            _check_range(getattr(self, name), name, 0.0, 1.0)
        _check_range(self.waves_deg, "waves_deg", 0.0, 20.0)
        _check_range(self.wave_m, "wave_m", 1e-3, 1.0)
        _check_range(self.haze, "haze", 0.0, 0.5)
        _check_box(self.tint, "tint")


class OwnShare(Document, frozen=True, kw_only=True):
    """Fraction of the object's own appearance in a material's colour.

    Attributes:
        texture: range for objects with a texture image.
        color: range for objects with one flat colour.
    """

    texture: Range
    color: Range

    def __post_init__(self) -> None:
        _check_range(self.texture, "texture", 0.0, 1.0)
        _check_range(self.color, "color", 0.0, 1.0)


class RawRange(Document, frozen=True, kw_only=True):
    """Ranges of the surface of objects that keep only their own texture.

    Attributes:
        infrared: of the reflectance at 850 nm of any object's own paint.
        infrared_pattern: of the fraction of its contrast that remains at 850 nm.
    """

    roughness: Range
    specular: Range
    infrared: Range
    infrared_pattern: Range

    def __post_init__(self) -> None:
        for name in ("roughness", "specular", "infrared", "infrared_pattern"):
            _check_range(getattr(self, name), name, 0.0, 1.0)


class MaterialLibrary(Document, frozen=True, kw_only=True):
    """All materials.

    Attributes:
        about, sources: for the reader of the file.
        own_share: see `OwnShare`.
        raw: see `RawRange`.
        families: name to the shared properties of its members.
        opaque, glass: the materials.
    """

    about: str = ""
    sources: dict[str, str] = msgspec.field(default_factory=dict)
    own_share: OwnShare
    raw: RawRange
    families: dict[str, Family]
    opaque: tuple[OpaqueMaterial, ...]
    glass: tuple[GlassMaterial, ...]

    def __post_init__(self) -> None:
        names = [m.name for m in self.opaque] + [m.name for m in self.glass]
        if len(set(names)) != len(names):
            twice = next(n for i, n in enumerate(names) if n in names[:i])
            raise InvalidDocument("a material's name appears twice", field="name", value=twice)
        parts: tuple[tuple[str, Sequence[OpaqueMaterial | GlassMaterial], set[str]], ...] = (
            ("opaque", self.opaque, {"diffuse", "specular"}),
            ("glass", self.glass, {"transparent"}),
        )
        for kind, materials, allowed in parts:
            for i, material in enumerate(materials):
                family = self.families.get(material.family)
                if family is None or family.material_class not in allowed:
                    raise InvalidDocument(
                        f"needs a family whose class is one of {', '.join(sorted(allowed))}",
                        field=f"{kind}[{i}].family",
                        value=material.family,
                        hint=f"families: {', '.join(self.families)}",
                    )

    def of_class(self, material_class: MaterialClass) -> tuple[OpaqueMaterial | GlassMaterial, ...]:
        """The materials of a class, in the file's order; none for `raw`."""
        everything: list[OpaqueMaterial | GlassMaterial] = [*self.opaque, *self.glass]
        return tuple(
            m for m in everything if self.families[m.family].material_class == material_class
        )


def load_library(path: Path | str | None = None) -> MaterialLibrary:
    """Read the built-in library, or a user's file of the same form.

    Raises:
        ToolkitError: unreadable, or a value out of its range; names the file and the field.
    """
    return _built_in() if path is None else read_document(path, MaterialLibrary)


@lru_cache(maxsize=1)
def _built_in() -> MaterialLibrary:
    return read_document(BUILT_IN, MaterialLibrary)


def class_id(material_class: MaterialClass) -> int:
    """0 raw, 1 diffuse, 2 transparent, 3 specular.

    Raises:
        ToolkitError: no such class.
    """
    try:
        return MATERIAL_CLASSES.index(material_class)
    except ValueError:
        raise ToolkitError(
            "no such material class",
            value=material_class,
            hint=f"one of {', '.join(MATERIAL_CLASSES)}",
        ) from None


def _check_range(value: Range, field: str, low: float, high: float) -> None:
    if not low <= value[0] <= value[1] <= high:
        raise InvalidDocument(
            f"must be a rising pair within {low}..{high}", field=field, value=list(value)
        )


def _check_jitter(jitter: dict[str, Range]) -> None:
    for name, value in jitter.items():
        if name not in PARAMETERS:
            raise InvalidDocument(
                "no such parameter",
                field=f"jitter.{name}",
                hint=f"one of {', '.join(PARAMETERS)}",
            )
        _check_range(value, f"jitter.{name}", -1.0, 1.0)


def _check_box(box: tuple[Color, Color], field: str) -> None:
    if any(low > high for low, high in zip(*box, strict=True)):
        raise InvalidDocument("the first corner must not exceed the second", field=field, value=box)
