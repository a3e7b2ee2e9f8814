"""Contents of a scene: objects, sizes, materials, light and floor, drawn from its seed.

Every aspect has its own random generator, so that an option which changes the materials leaves
shapes, sizes, poses and light unchanged: ablations differ only in the option that they change.
"""

from collections.abc import Sequence
from typing import Literal, get_args

import msgspec
import numpy as np
from msgspec.structs import replace

from sensors.assets import Asset, AssetSource, SourceOptions, draw_diagonal, open_source
from sensors.lighting import light_draw
from sensors.lighting.environment import EnvironmentMap
from sensors.lighting.environment_sources import EnvironmentSource
from sensors.materials.material_draw import (
    DrawnMaterial,
    collage,
    draw_liquid,
    draw_material,
    draw_material_class,
)
from sensors.materials.material_library import MATERIAL_CLASSES, MaterialClass
from sensors.render.color_image import ColorResponse, draw_response
from sensors.simulation.options import DROP, Factor, MaterialSwitch, SimulationOptions
from std_toolkit.errors import ToolkitError

Aspect = Literal[
    "objects",
    "sizes",
    "materials",
    "light",
    "floor",
    "drop",
    "views",
    "noise",
    "pattern",
    "parts",
    "color",
    "setting",
]
ASPECTS: tuple[Aspect, ...] = get_args(Aspect)
FACTORS: dict[Factor, tuple[Aspect, ...]] = {
    "objects": ("objects", "sizes", "drop"),
    "materials": ("materials", "parts"),
    "lighting": ("light",),
    "background": ("floor", "setting"),
    "camera": ("views", "color"),
}
"""Aspects that are the same in all scenes of a set where the option `fix` names them."""
# Materials that objects may have.
_CLASSES: dict[MaterialSwitch, tuple[MaterialClass, ...]] = {
    "mixed": MATERIAL_CLASSES,
    "clear": MATERIAL_CLASSES,
    "fixed": ("raw",),
    "opaque": tuple(c for c in MATERIAL_CLASSES if c != "transparent"),
}
# Classes where colour alone shall tell what is glass: any shape may be, and has its opaque twin.
CLEAR_SHARES: dict[MaterialClass, float] = {
    "raw": 0.15,
    "diffuse": 0.2,
    "transparent": 0.5,
    "specular": 0.15,
}
# Share of their floors and walls with a pattern of many colours: no pattern may be taken for glass.
BUSY_SHARE = 0.6
# Share of their opaque objects with such a pattern, and its tile.
PRINTED_SHARE, PRINT_TILE_M = 0.3, (0.03, 0.3)
# In every scene of DREDS, and the only categories that may be transparent.
ALWAYS = ("bottle", "bowl", "mug")
SOMETIMES = ("camera", "can", "car", "aeroplane")
SOMETIMES_COUNT = (1, 4)
OTHER = "other"
DISTRACTOR_COUNT = (1, 3)
# Share of the scenes whose objects fall on each other, and the half side of where they start.
PILED_SHARE, PILE_M = 0.3, (0.04, 0.12)
# Share of the scenes in which objects stand where poses are mixed.
UPRIGHT_SHARE = 0.5
# Parts of glass objects that are not glass.
OPAQUE_PARTS = ("cap", "label", "print")
# Share of the closed transparent bottles that contain a liquid, and its level.
FILLED_SHARE, FILL = 0.35, (0.15, 0.95)


class ObjectDraw(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An object of a scene.

    Attributes:
        instance: 1, 2, ...: its value in the masks.
        asset: id within the asset source.
        category: of the asset.
        diagonal_m: of its bounding box, metres.
        material: its surface.
        parts: materials of the parts of a transparent object that have their own.
        fill: height of a liquid in a closed transparent object, as a fraction of the height that
            the object has as it lies; 0: empty.
        liquid: the liquid.
    """

    instance: int
    asset: str
    category: str
    diagonal_m: float
    material: DrawnMaterial
    parts: dict[str, DrawnMaterial] = {}
    fill: float = 0.0
    liquid: DrawnMaterial | None = None


class SceneDraw(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All random choices made before physics and rendering.

    Attributes:
        seed: of the scene.
        objects: in the order of their instances.
        floors: the floor in each view.
        light: of each view.
        pattern_seed: of the projector's dots; units of one sensor differ.
        color: settings of the colour camera in each view; empty: those of a good picture.
        setting: surroundings.
        spread_m: the objects start above a square of this half side, and fall on each other where
            it is small; None: above the whole floor.
        upright: the objects stand, if their shape lets them.
    """

    seed: int
    objects: list[ObjectDraw]
    floors: list[light_draw.FloorDraw]
    light: list[light_draw.LightingDraw]
    pattern_seed: int = 0
    color: list[ColorResponse] = []
    setting: light_draw.SettingDraw = light_draw.SettingDraw()
    spread_m: float | None = None
    upright: bool = False


def generator(
    seed: int, aspect: Aspect, options: SimulationOptions | None = None
) -> np.random.Generator:
    """Random generator of one aspect of one scene.

    Args:
        seed: of the scene.
        aspect: what is drawn.
        options: their `fix` may give all scenes the same one.

    Raises:
        ToolkitError: a negative seed.
    """
    if seed < 0:
        raise ToolkitError("must not be negative", field="seed", value=seed)
    if options is not None and any(aspect in FACTORS[factor] for factor in options.fix):
        seed = 0
    return np.random.default_rng([seed, ASPECTS.index(aspect)])


def draw_scene(
    seed: int,
    options: SimulationOptions,
    assets: AssetSource,
    environments: EnvironmentSource,
) -> tuple[SceneDraw, list[Asset], list[EnvironmentMap]]:
    """Draw a scene.

    Returns:
        The draw, the assets in the order of the objects, and the environment map of each view.

    Raises:
        ToolkitError: the sources lack a requested item.
    """
    chosen = _draw_assets(generator(seed, "objects", options), options, assets)
    draw, maps = dress_scene(seed, options, chosen, environments)
    return draw, chosen, maps


def dress_scene(
    seed: int,
    options: SimulationOptions,
    chosen: Sequence[Asset],
    environments: EnvironmentSource,
    *,
    dressed_as: str | None = None,
) -> tuple[SceneDraw, list[EnvironmentMap]]:
    """Draw sizes and materials of given objects, floor and light.

    Args:
        seed: of the scene.
        options: of the data set.
        chosen: the objects.
        environments: source of environment maps.
        dressed_as: category whose material classes all objects use; None: their own.

    Raises:
        ToolkitError: the sources lack a requested item.
    """
    sizes, looks = (generator(seed, a, options) for a in ("sizes", "materials"))
    parts = generator(seed, "parts", options)
    objects = []
    for instance, asset in enumerate(chosen, start=1):
        # A seed per object: one more random number in a material changes no other object.
        rng = np.random.default_rng(int(looks.integers(2**63)))
        own = np.random.default_rng(int(parts.integers(2**63)))
        material_class = draw_material_class(
            rng,
            dressed_as or asset.category,
            allowed=_CLASSES[options.materials],
            shares=CLEAR_SHARES if options.materials == "clear" else None,
        )
        if asset.material is not None and options.materials == "mixed":
            material_class = asset.material
        drawn = ObjectDraw(
            instance=instance,
            asset=asset.id,
            category=asset.category,
            diagonal_m=draw_diagonal(sizes, asset),
            material=draw_material(rng, material_class, textured=asset.texture is not None),
        )
        opaque = material_class in ("raw", "diffuse")
        if options.materials == "clear" and opaque and own.random() < PRINTED_SHARE:
            drawn = replace(drawn, material=collage(own, drawn.material, PRINT_TILE_M))
        objects.append(drawn if drawn.material.glass is None else with_parts(own, drawn, asset))
    # Views along a path are a recording: only its camera moves.
    still = options.order != "random"
    views = options.views
    rng = generator(seed, "light", options)
    once = still or "lighting" in options.fix
    maps = [environments.draw(rng) for _ in range(1 if once else views)]
    light = [light_draw.draw_lighting(rng, maps[i % len(maps)].name) for i in range(views)]
    if once:
        maps, light = maps * views, light[:1] * views
    rng = generator(seed, "floor", options)
    count = 1 if still or "background" in options.fix else views
    floors = [
        light_draw.draw_floor(rng, folder=options.floors, split=options.split) for _ in range(count)
    ]
    if options.materials == "clear":
        floors = [light_draw.busy(rng, f) if rng.random() < BUSY_SHARE else f for f in floors]
    rng = generator(seed, "color", options)
    color = [] if still else [draw_response(rng) for _ in range(views)]
    rng = generator(seed, "setting", options)
    setting = light_draw.draw_setting(rng, folder=options.floors, split=options.split)
    if options.materials == "clear" and setting.wall is not None and rng.random() < BUSY_SHARE:
        setting = replace(setting, wall=light_draw.busy(rng, setting.wall))
    rng = np.random.default_rng(int(generator(seed, "drop", options).integers(2**31)) + 1)
    piled = rng.random() < PILED_SHARE
    spread = float(rng.uniform(*PILE_M)) if piled else None
    upright = {
        "any": False,
        "upright": True,
        "mixed": bool(rng.random() < UPRIGHT_SHARE),
    }[options.object_poses]
    draw = SceneDraw(
        seed=seed,
        objects=objects,
        floors=floors * (views // count),
        light=light,
        pattern_seed=int(generator(seed, "pattern").integers(2**31)),
        color=color,
        setting=setting if options.scenes_from == DROP else light_draw.SettingDraw(),
        spread_m=spread,
        upright=upright,
    )
    return draw, maps


def with_parts(rng: np.random.Generator, drawn: ObjectDraw, asset: Asset) -> ObjectDraw:
    """Materials of a glass object's caps, labels and prints, and its liquid.

    Args:
        rng: consumed.
        drawn: a transparent object.
        asset: of it.
    """
    names = () if asset.face_parts is None else np.unique(asset.face_parts)
    parts = {
        str(name): draw_material(rng, "diffuse", name="paper_printed")
        if name == "label"
        else draw_material(rng, "raw")
        for name in names
        if name in OPAQUE_PARTS
    }
    if asset.cavity is None or rng.random() >= FILLED_SHARE:
        return replace(drawn, parts=parts)
    return replace(drawn, parts=parts, fill=float(rng.uniform(*FILL)), liquid=draw_liquid(rng))


def draw_categories(
    rng: np.random.Generator, options: SimulationOptions, known: tuple[str, ...]
) -> list[str]:
    """Categories of a scene's objects: one bottle, bowl and mug each, at most one of the others.

    Args:
        rng: consumed.
        options: limits of the number of objects.
        known: categories of the asset source; missing ones are left out, and from a source with
            other categories any of them are drawn. Where none is left for distractors, the
            category "other" is.

    Raises:
        ToolkitError: there is no category.
    """
    if not known:
        raise ToolkitError("the asset source has no categories", field="assets")
    named = [c for c in (*ALWAYS, *SOMETIMES) if c in known]
    if not named:
        count = int(rng.integers(options.min_objects, options.max_objects + 1))
        return [known[int(i)] for i in rng.integers(len(known), size=count)]
    always = [c for c in ALWAYS if c in known]
    others = [c for c in SOMETIMES if c in known]
    low, high = SOMETIMES_COUNT
    count = min(int(rng.integers(low, high + 1)), len(others))
    picked = [others[int(i)] for i in np.sort(rng.permutation(len(others))[:count])]
    own = [c for c in known if c not in (*ALWAYS, *SOMETIMES)]
    spare = own or [OTHER]
    low, high = DISTRACTOR_COUNT
    extra = int(rng.integers(low, high + 1))
    distractors = [spare[int(i)] for i in rng.integers(len(spare), size=extra)]
    found = [*always, *picked, *distractors]
    # A source of few categories: more objects of them too.
    more = options.min_objects - len(found)
    if more > 0:
        choice = own or [*named, OTHER]
        found += [choice[int(i)] for i in rng.integers(len(choice), size=more)]
    return found[: options.max_objects]


def _draw_assets(
    rng: np.random.Generator, options: SimulationOptions, source: AssetSource
) -> list[Asset]:
    known = tuple(source.categories())
    # Distractors of a source without any are procedural.
    own = open_source("procedural", SourceOptions(split=options.split))
    return [
        (source if category in known else own).sample(rng, category)
        for category in draw_categories(rng, options, known)
    ]
