"""Random choice of a material: its class by object category, then its values.

`ClassChoice` has the probabilities per category; ablations restrict the allowed classes.
"""

from collections.abc import Collection, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from sensors.materials import material_library
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import InvalidDocument, read_document

BUILT_IN = Path(__file__).with_name("object_classes.json")

FALLBACK_CATEGORY = "other"


class DrawnTexture(material_library.Document, frozen=True, kw_only=True):
    """A procedural texture with all its parameters; `textures.make_texture` draws it.

    Attributes:
        tile_m: extent of one tile on the surface, metres.
        contrast: 0..1.
        seed: of the pattern.
    """

    kind: material_library.TextureKind
    tile_m: float
    contrast: material_library.Share
    seed: int


class Glass(material_library.Document, frozen=True, kw_only=True):
    """The transparent part of a material; see `GlassMaterial` for the meaning."""

    ior: float
    roughness: material_library.Share
    transmission: material_library.Share
    bend: material_library.Share = 1.0
    waves_deg: float = 0.0
    wave_m: float = 0.02
    haze: material_library.Share = 0.0
    gloss_roughness: material_library.Share = 0.0


class DrawnMaterial(material_library.Document, frozen=True, kw_only=True):
    """A material in the form that a renderer takes: plain numbers only.

    Attributes:
        name: the library's material, or "raw".
        material_class: raw, diffuse, transparent or specular.
        color: linear RGB; for glass its transmittance.
        own_share: fraction of the object's own texture or colour in the final base colour.
        metallic .. clearcoat_gloss: parameters of the principled BSDF, 0..1.
        texture: pattern that multiplies `color`, or None.
        glass: for transparent materials only.
        infrared: mean reflectance of the material at 850 nm; None: equal to the visible one.
        own_infrared: the same for the object's own paint, mixed in by `own_share`.
        infrared_pattern: fraction of the contrast of the visible pattern at 850 nm.
    """

    name: str
    material_class: material_library.MaterialClass
    color: material_library.Color
    own_share: material_library.Share
    metallic: material_library.Share = 0.0
    specular: material_library.Share = 0.5
    spec_tint: material_library.Share = 0.0
    roughness: material_library.Share = 0.5
    anisotropic: material_library.Share = 0.0
    sheen: material_library.Share = 0.0
    sheen_tint: material_library.Share = 0.0
    clearcoat: material_library.Share = 0.0
    clearcoat_gloss: material_library.Share = 0.9
    texture: DrawnTexture | None = None
    glass: Glass | None = None
    infrared: material_library.Share | None = None
    own_infrared: material_library.Share = 0.5
    infrared_pattern: material_library.Share = 1.0

    @property
    def class_id(self) -> int:
        """0 raw, 1 diffuse, 2 transparent, 3 specular."""
        return material_library.class_id(self.material_class)


def draw_material(
    rng: np.random.Generator,
    material_class: material_library.MaterialClass,
    *,
    textured: bool = False,
    name: str | None = None,
    library: material_library.MaterialLibrary | None = None,
) -> DrawnMaterial:
    """Draw a material of a class: its name, its parameters, and the share of the object's own look.

    Args:
        rng: consumed; the same state gives the same material.
        material_class: `raw` keeps only the object's own texture or colour.
        textured: whether the object has a texture image (its own look then gets a larger share).
        name: use this material instead of a random one of the class.
        library: the built-in one by default.

    Raises:
        ToolkitError: no such class or name, or the library has no material of the class.
    """
    library = library or material_library.load_library()
    material_library.class_id(material_class)  # refuses an unknown one
    if material_class == "raw":
        return DrawnMaterial(
            name="raw",
            material_class="raw",
            color=(0.5, 0.5, 0.5),
            own_share=1.0,
            roughness=_uniform(rng, library.raw.roughness),
            specular=_uniform(rng, library.raw.specular),
            infrared=(own := _uniform(rng, library.raw.infrared)),
            own_infrared=own,
            infrared_pattern=_uniform(rng, library.raw.infrared_pattern),
        )
    choices = library.of_class(material_class)
    if name is not None:
        choices = tuple(m for m in choices if m.name == name)
    if not choices:
        raise ToolkitError(
            f"the library has no {material_class} material" + (" of this name" if name else ""),
            value=name,
        )
    chosen = choices[int(rng.integers(len(choices)))]
    if isinstance(chosen, material_library.GlassMaterial):
        return _draw_glass(rng, chosen)
    return _draw_opaque(rng, chosen, library, textured=textured)


def collage(
    rng: np.random.Generator, material: DrawnMaterial, tile_m: tuple[float, float]
) -> DrawnMaterial:
    """The material under a printed pattern of many colours, which hides 40 to 100 % of its own.

    Args:
        rng: consumed.
        material: opaque.
        tile_m: limits of the pattern's extent, metres.
    """
    texture = DrawnTexture(
        kind="collage",
        tile_m=float(rng.uniform(*tile_m)),
        contrast=float(rng.uniform(0.4, 1.0)),
        seed=int(rng.integers(2**31)),
    )
    return msgspec.structs.replace(material, texture=texture, own_share=0.0)


def _draw_opaque(
    rng: np.random.Generator,
    chosen: material_library.OpaqueMaterial,
    library: material_library.MaterialLibrary,
    *,
    textured: bool,
) -> DrawnMaterial:
    family = library.families[chosen.family]
    jitter = {**family.jitter, **chosen.jitter}
    values: dict[str, Any] = {}
    # Every parameter consumes one number whether it varies or not, so that a library with another
    # range changes only that parameter of a seeded scene.
    for parameter in material_library.PARAMETERS:
        shift = _uniform(rng, jitter.get(parameter, (0.0, 0.0)))
        values[parameter] = float(np.clip(getattr(chosen.base, parameter) + shift, 0, 1))
    mixed = rng.random() < family.mix_probability
    share = _uniform(rng, library.own_share.texture if textured else library.own_share.color)
    color = _color(rng, chosen.color)
    texture = None
    if chosen.texture is not None:
        texture = DrawnTexture(
            kind=chosen.texture.kind,
            tile_m=_uniform(rng, chosen.texture.tile_m),
            contrast=_uniform(rng, chosen.texture.contrast),
            seed=int(rng.integers(2**32)),
        )
    infrared = None if chosen.infrared is None else _uniform(rng, chosen.infrared)
    return DrawnMaterial(
        name=chosen.name,
        material_class=family.material_class,
        color=color,
        own_share=share if mixed else 0.0,
        texture=texture,
        infrared=infrared,
        own_infrared=_uniform(rng, library.raw.infrared),
        infrared_pattern=_uniform(rng, family.infrared_pattern),
        **values,
    )


def _draw_glass(rng: np.random.Generator, chosen: material_library.GlassMaterial) -> DrawnMaterial:
    return DrawnMaterial(
        name=chosen.name,
        material_class="transparent",
        color=_color(rng, chosen.tint),
        own_share=0.0,
        glass=Glass(
            ior=_uniform(rng, chosen.ior),
            roughness=_uniform(rng, chosen.roughness),
            transmission=_uniform(rng, chosen.transmission),
            bend=_uniform(rng, chosen.bend),
            waves_deg=_uniform(rng, chosen.waves_deg),
            wave_m=_uniform(rng, chosen.wave_m),
            haze=_uniform(rng, chosen.haze),
            gloss_roughness=_uniform(rng, chosen.gloss_roughness),
        ),
    )


PlainLook = Literal["glass", "steel", "matt", "original"]


def plain_look(look: PlainLook, seed: int) -> DrawnMaterial:
    """A material of known kind, nearly the same for all seeds.

    Args:
        look: clear glass; polished steel; sprayed matt as for scanning; or the object's own.
        seed: of what is left open.
    """
    rng = np.random.default_rng([seed, 9])
    if look == "glass":
        return DrawnMaterial(
            name="glass_clear",
            material_class="transparent",
            color=(0.97, 0.985, 0.98),
            own_share=0.0,
            glass=Glass(ior=1.5, roughness=0.0, transmission=0.95, bend=1.0),
        )
    if look == "steel":
        # None of the object's own paint.
        drawn = draw_material(rng, "specular", name="steel_polished")
        return msgspec.structs.replace(drawn, own_share=0.0)
    if look == "original":
        return draw_material(rng, "raw", textured=True)
    # Titanium dioxide: bright, rough, with a slight grain.
    return DrawnMaterial(
        name="sprayed",
        material_class="diffuse",
        color=(0.72, 0.72, 0.71),
        own_share=0.0,
        roughness=0.95,
        specular=0.1,
        texture=DrawnTexture(kind="grain", tile_m=0.05, contrast=0.06, seed=seed),
    )


LIQUIDS: dict[str, tuple[material_library.Color, float, float]] = {
    "water": ((0.97, 0.99, 0.99), 0.98, 0.0),
    "tea": ((0.6, 0.25, 0.08), 0.9, 0.01),
    "juice": ((0.85, 0.45, 0.1), 0.35, 0.25),
    "syrup": ((0.7, 0.1, 0.12), 0.85, 0.01),
}
"""Tint, transmission and haze of clear liquids, chosen by eye; milk is opaque."""


def draw_liquid(rng: np.random.Generator) -> DrawnMaterial:
    """Draw a liquid, half of them water; consumes two numbers."""
    name = "water" if rng.random() < 0.5 else ("tea", "juice", "syrup", "milk")[rng.integers(4)]
    if name == "milk":
        return DrawnMaterial(
            name=name, material_class="diffuse", color=(0.8, 0.78, 0.72), own_share=0.0
        )
    tint, transmission, haze = LIQUIDS[name]
    return DrawnMaterial(
        name=name,
        material_class="transparent",
        color=tint,
        own_share=0.0,
        glass=Glass(ior=1.33, roughness=0.0, transmission=transmission, haze=haze),
    )


def _uniform(rng: np.random.Generator, bounds: material_library.Range) -> float:
    return float(rng.uniform(*bounds))


def _color(
    rng: np.random.Generator, box: tuple[material_library.Color, material_library.Color]
) -> material_library.Color:
    r, g, b = (float(x) for x in rng.uniform(box[0], box[1]))
    return (r, g, b)


class ClassChoice(material_library.Document, frozen=True, kw_only=True):
    """Probabilities of the material classes per object category.

    Attributes:
        source: where the figures come from.
        probabilities: category to class to probability; each row sums to 1, and `other` is
            required.
    """

    source: str = ""
    probabilities: dict[str, dict[material_library.MaterialClass, material_library.Share]]

    def __post_init__(self) -> None:
        if FALLBACK_CATEGORY not in self.probabilities:
            raise InvalidDocument(
                f"needs a row {FALLBACK_CATEGORY!r} for categories not named",
                field="probabilities",
            )
        for category, row in self.probabilities.items():
            if abs(sum(row.values()) - 1) > 1e-6:
                raise InvalidDocument(
                    "probabilities must sum to 1",
                    field=f"probabilities.{category}",
                    value=sum(row.values()),
                )

    def row(self, category: str) -> dict[material_library.MaterialClass, material_library.Share]:
        """Probabilities of a category; those of `other` if it is not listed."""
        return self.probabilities.get(category, self.probabilities[FALLBACK_CATEGORY])


@lru_cache(maxsize=1)
def load_class_choice() -> ClassChoice:
    """The built-in probabilities."""
    return read_document(BUILT_IN, ClassChoice)


def draw_material_class(
    rng: np.random.Generator,
    category: str,
    *,
    allowed: Collection[material_library.MaterialClass] = material_library.MATERIAL_CLASSES,
    shares: Mapping[material_library.MaterialClass, float] | None = None,
) -> material_library.MaterialClass:
    """Draw the material class of an object; consumes one random number.

    Args:
        rng: the scene's generator.
        category: "bottle", ...; unknown ones count as "other".
        allowed: classes that an ablation leaves: `("raw",)` keeps the original materials; a set
            without "transparent" distributes its probability proportionally over the others.
        shares: probability of each class instead of the category's.

    Raises:
        ToolkitError: `allowed` is empty.
    """
    row = shares or load_class_choice().row(category)
    names = [c for c in material_library.MATERIAL_CLASSES if c in allowed]
    if not names:
        raise ToolkitError("no material class is allowed", field="allowed", value=list(allowed))
    weights = np.array([row.get(c, 0.0) for c in names])
    if weights.sum() == 0:  # the category has no probability for any allowed class
        weights = np.ones(len(names))
    at = int(np.searchsorted(np.cumsum(weights / weights.sum()), rng.random(), side="right"))
    return names[min(at, len(names) - 1)]
