"""What a seed decides, and what the switches of the ablations change of it."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import get_args

import msgspec
import numpy as np
import pytest

from sensors.assets import Asset, open_source
from sensors.lighting.environment_sources import EnvironmentMap, environment_source
from sensors.render.sim_renderer import QUALITIES
from sensors.simulation import world_builder
from sensors.simulation.options import (
    PRESETS,
    MaterialSwitch,
    PresetName,
    QualityName,
    SimulationOptions,
)
from sensors.simulation.scene_draw import (
    ALWAYS,
    SOMETIMES,
    SceneDraw,
    draw_categories,
    draw_scene,
    dress_scene,
    generator,
)
from std_toolkit.errors import ToolkitError

OPTIONS = SimulationOptions(views=3)
KNOWN = (*ALWAYS, *SOMETIMES, "other")


def drawn(seed: int, options: SimulationOptions = OPTIONS) -> SceneDraw:
    return draw_scene(seed, options, open_source("procedural"), environment_source())[0]


class OneOfEach:
    """Assets and light for tests of what else is drawn: one shape of each category, one map."""

    def __init__(self) -> None:
        source, rng = open_source("procedural"), np.random.default_rng(0)
        self.made = {name: source.sample(rng, name) for name in source.categories()}
        self.map = environment_source().draw(rng)

    def categories(self) -> tuple[str, ...]:
        return tuple(self.made)

    def sample(self, _: np.random.Generator, category: str) -> Asset:
        return self.made[category]

    def draw(self, _: np.random.Generator) -> EnvironmentMap:
        return self.map


@pytest.fixture(scope="module")
def one_of_each() -> OneOfEach:
    return OneOfEach()


@pytest.mark.slow
def test_a_seed_is_a_scene() -> None:
    assert drawn(5) == drawn(5)
    assert drawn(5) != drawn(6)
    assert msgspec.json.decode(msgspec.json.encode(drawn(5)), type=SceneDraw) == drawn(5)


@pytest.mark.slow
@pytest.mark.parametrize("materials", ["fixed", "opaque"])
def test_other_materials_leave_everything_else_as_it_was(materials: str) -> None:
    """Ablations differ in what they switch and in nothing else."""
    plain = drawn(2)
    switched = drawn(2, msgspec.structs.replace(OPTIONS, materials=materials))
    assert [
        msgspec.structs.replace(o, material=p.material, parts=p.parts, fill=p.fill, liquid=p.liquid)
        for o, p in zip(switched.objects, plain.objects, strict=True)
    ] == plain.objects
    assert (switched.floors, switched.light) == (plain.floors, plain.light)
    classes = {o.material.material_class for o in switched.objects}
    assert classes <= ({"raw"} if materials == "fixed" else {"raw", "diffuse", "specular"})


def test_scenes_hold_what_those_of_dreds_hold() -> None:
    counts = []
    for seed in range(300):
        categories = draw_categories(generator(seed, "objects"), OPTIONS, KNOWN)
        each = Counter(categories)
        assert all(each[c] == 1 for c in ALWAYS)
        assert all(each[c] <= 1 for c in SOMETIMES)
        assert 1 <= sum(each[c] for c in SOMETIMES) <= 4
        assert each["other"] >= 1
        counts.append(len(categories))
    assert set(counts) == {6, 7, 8, 9, 10}


def test_sources_with_other_categories_serve_as_well() -> None:
    categories = draw_categories(np.random.default_rng(0), OPTIONS, ("drill", "clamp"))
    assert set(categories) == {"drill", "clamp"}
    assert 6 <= len(categories) <= 10
    only_mugs = draw_categories(np.random.default_rng(0), OPTIONS, ("mug",))
    assert set(only_mugs) == {"mug", "other"}
    assert len(only_mugs) == OPTIONS.min_objects


@pytest.mark.slow
def test_only_vessels_are_transparent_and_instances_are_counted() -> None:
    for seed in range(6):
        scene = drawn(seed)
        assert [o.instance for o in scene.objects] == list(range(1, len(scene.objects) + 1))
        for thing in scene.objects:
            if thing.material.material_class == "transparent":
                assert thing.category in ALWAYS
        assert len(scene.light) == OPTIONS.views


def test_bad_options_name_the_field() -> None:
    with pytest.raises(ToolkitError, match="min_objects"):
        SimulationOptions(min_objects=8, max_objects=7)
    with pytest.raises(ToolkitError, match="max_objects"):
        SimulationOptions(max_objects=21)
    with pytest.raises(ToolkitError, match="seed"):
        generator(-1, "drop")
    with pytest.raises(ToolkitError, match="no categories"):
        draw_categories(np.random.default_rng(0), OPTIONS, ())


def test_the_command_line_offers_what_there_is() -> None:
    """The names of choices are apart from them, so that help loads nothing."""
    assert set(get_args(PresetName)) == set(PRESETS)
    assert set(get_args(QualityName)) == set(QUALITIES)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "fields"),
    [
        ("materials", ("objects",)),
        ("lighting", ("light",)),
        ("background", ("floors", "setting")),
        ("camera", ("color",)),
    ],
)
def test_a_factor_can_be_fixed_alone(factor: str, fields: tuple[str, ...]) -> None:
    options = msgspec.structs.replace(OPTIONS, fix=(factor,), views=3)
    free = msgspec.structs.replace(OPTIONS, views=3)
    one, other = drawn(5, options), drawn(6, options)
    for name in ("light", "floors", "setting", "color"):
        if name in fields:
            assert getattr(one, name) == getattr(other, name)
        else:
            assert getattr(one, name) == getattr(drawn(5, free), name)
    assert [o.asset for o in one.objects] == [o.asset for o in drawn(5, free).objects]
    if factor == "lighting":
        assert len({x.rotation_rad for x in one.light}) == 1


@pytest.mark.slow
def test_fixed_objects_lie_alike_in_all_scenes(monkeypatch) -> None:
    """Shapes, sizes and poses are shared; materials, light, floor and cameras are not."""
    # Convex hulls serve here, and take no time.
    monkeypatch.setattr(
        world_builder, "convex_parts", lambda asset, _cache, **_: (np.asarray(asset.vertices),)
    )
    options = msgspec.structs.replace(
        OPTIONS, views=1, fix=("objects",), min_objects=3, max_objects=3
    )

    def world(seed: int, options: SimulationOptions = options) -> world_builder.World:
        draw, assets, maps = draw_scene(
            seed, options, open_source("procedural"), environment_source()
        )
        return world_builder.build_world("x", draw, assets, maps, options, sensor="d415")

    one, other = world(5), world(6)
    for a, b in zip(one.record.objects, other.record.objects, strict=True):
        assert (a.asset_id, a.scale_m) == (b.asset_id, b.scale_m)
        assert np.array_equal(a.T_world_obj.matrix(), b.T_world_obj.matrix())
    assert one.draw.spread_m == other.draw.spread_m
    for name in ("light", "floors", "color", "pattern_seed"):
        assert getattr(one.draw, name) != getattr(other.draw, name)
    assert [o.material for o in one.draw.objects] != [o.material for o in other.draw.objects]
    assert not np.allclose(one.T_world_cam[0].matrix(), other.T_world_cam[0].matrix())
    # What is not fixed is that of the scene without the option.
    free = msgspec.structs.replace(options, fix=())
    assert one.draw.light == drawn(5, free).light
    assert [o.asset for o in drawn(5, free).objects] != [o.asset for o in drawn(6, free).objects]


def test_objects_of_a_given_material_have_it() -> None:
    """A flask is glass although its category is not known."""
    flask = replace(open_source("procedural").sample(np.random.default_rng(0), "can"), category="x")
    glass = replace(flask, material="transparent")

    def classes(materials: MaterialSwitch) -> list[str]:
        options = msgspec.structs.replace(OPTIONS, views=1, materials=materials)
        draw, _ = dress_scene(3, options, [glass, flask], environment_source())
        return [o.material.material_class for o in draw.objects]

    assert classes("mixed")[0] == "transparent"
    assert classes("mixed")[1] != "transparent"
    assert classes("fixed") == ["raw", "raw"]
    assert "transparent" not in classes("opaque")


def test_half_of_clear_scenes_is_glass_whatever_the_category(one_of_each: OneOfEach) -> None:
    options = msgspec.structs.replace(OPTIONS, views=1, materials="clear")
    scenes = [draw_scene(seed, options, one_of_each, one_of_each)[0] for seed in range(40)]
    made = [o for scene in scenes for o in scene.objects]
    glass = [o for o in made if o.material.material_class == "transparent"]
    assert 0.4 < len(glass) / len(made) < 0.6
    assert {o.category for o in glass} == {o.category for o in made}
    # Shapes and sizes are those of the scenes of DREDS.
    mixed = msgspec.structs.replace(options, materials="mixed")
    assert [(o.asset, o.diagonal_m) for o in drawn(3, options).objects] == [
        (o.asset, o.diagonal_m) for o in drawn(3, mixed).objects
    ]


def test_floors_of_clear_scenes_are_busy(one_of_each: OneOfEach) -> None:
    options = msgspec.structs.replace(OPTIONS, views=4)

    def kinds(materials: str) -> list[str]:
        of = msgspec.structs.replace(options, materials=materials)
        scenes = [draw_scene(seed, of, one_of_each, one_of_each)[0] for seed in range(20)]
        floors = [floor.material.texture for scene in scenes for floor in scene.floors]
        return ["" if texture is None else texture.kind for texture in floors]

    assert 0.45 < kinds("clear").count("collage") / 80 < 0.75
    plain = kinds("mixed")
    assert "collage" not in plain
    # The other floors are those of the other scenes.
    both = zip(kinds("clear"), plain, strict=True)
    assert all(a == b for a, b in both if a != "collage")


def test_objects_stand_in_half_of_mixed_scenes(one_of_each: OneOfEach) -> None:
    def upright(poses: str) -> list[bool]:
        options = msgspec.structs.replace(OPTIONS, views=1, object_poses=poses)
        scenes = [draw_scene(seed, options, one_of_each, one_of_each)[0] for seed in range(40)]
        return [scene.upright for scene in scenes]

    assert upright("any") == [False] * 40
    assert upright("upright") == [True] * 40
    assert 10 <= sum(upright("mixed")) <= 30


def test_light_and_floor_differ_between_views() -> None:
    scene = drawn(3, msgspec.structs.replace(OPTIONS, views=6))
    assert len({x.rotation_rad for x in scene.light}) == 6
    assert len({x.environment for x in scene.light}) > 3
    assert len({f.material.name for f in scene.floors}) > 3
    assert all(abs(c.exposure_ev) <= 1.5 for c in scene.color)
    # A recording along a path has one light, one floor, and plain pictures.
    film = drawn(3, msgspec.structs.replace(OPTIONS, views=6, order="arc"))
    assert len({x.rotation_rad for x in film.light}) == 1
    assert len({f.material.name for f in film.floors}) == 1 and film.color == []
