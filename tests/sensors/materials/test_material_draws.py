"""The material library, draws from it, class probabilities and procedural textures."""

from __future__ import annotations

import json
from typing import get_args

import msgspec
import numpy as np
import pytest

from sensors.materials.material_draw import (
    DrawnMaterial,
    DrawnTexture,
    draw_material,
    draw_material_class,
)
from sensors.materials.material_library import (
    BUILT_IN,
    MATERIAL_CLASSES,
    PARAMETERS,
    TextureKind,
    class_id,
    load_library,
)
from sensors.materials.textures import make_texture, tiling_noise, to_linear, to_srgb
from std_toolkit.errors import ToolkitError


def test_library_holds_the_unified_materials() -> None:
    library = load_library()
    counts = {c: len(library.of_class(c)) for c in MATERIAL_CLASSES}
    assert counts == {"raw": 0, "diffuse": 36, "transparent": 4, "specular": 27}
    families = {m.family for m in library.opaque}
    assert families == {
        *("metal", "porcelain", "clean_plastic", "paint"),
        *("rubber", "leather", "wood", "fabric", "coarse_plastic", "paper", "clay"),
    }
    assert [class_id(c) for c in MATERIAL_CLASSES] == [0, 1, 2, 3]


def test_metals_reflect_sharply_and_diffuse_materials_do_not() -> None:
    library = load_library()
    for material in library.opaque:
        if material.family == "metal":
            assert material.base.metallic == 1
        if library.families[material.family].material_class == "specular":
            assert material.base.roughness <= 0.4
        else:
            assert material.base.metallic == 0
            assert material.base.roughness >= 0.5


@pytest.mark.parametrize("material_class", MATERIAL_CLASSES)
def test_draws_are_seeded_recordable_and_within_range(material_class) -> None:
    for seed in range(60):
        drawn = draw_material(np.random.default_rng(seed), material_class, textured=seed % 2 == 0)
        again = draw_material(np.random.default_rng(seed), material_class, textured=seed % 2 == 0)
        assert drawn == again
        assert drawn.material_class == material_class
        assert msgspec.json.decode(msgspec.json.encode(drawn), type=DrawnMaterial) == drawn
        assert all(0 <= getattr(drawn, p) <= 1 for p in PARAMETERS)
        assert (drawn.glass is not None) == (material_class == "transparent")


def test_parameters_vary_by_the_family_s_jitter() -> None:
    rng = np.random.default_rng(5)
    draws = [draw_material(rng, "specular", name="steel_polished") for _ in range(400)]
    roughness = np.array([d.roughness for d in draws])
    assert 0.02 <= roughness.min() < 0.04
    assert 0.13 < roughness.max() <= 0.15
    mixed = np.mean([d.own_share > 0 for d in draws])
    assert abs(mixed - 0.75) < 0.08
    shares = [d.own_share for d in draws if d.own_share > 0]
    assert 0.6 <= min(shares) < 0.64
    assert 0.86 < max(shares) <= 0.9


def test_textured_objects_keep_more_of_their_own_look() -> None:
    rng = np.random.default_rng(6)
    shares = [draw_material(rng, "diffuse", textured=True).own_share for _ in range(200)]
    assert 0.7 <= min(shares) < 0.73
    assert 0.92 < max(shares) <= 0.95


def test_classes_follow_the_category_s_probabilities() -> None:
    rng = np.random.default_rng(7)
    for category, expected in (
        ("mug", (0.125, 0.125, 0.5, 0.25)),
        ("camera", (0.25, 0.75, 0, 0)),
        ("never heard of", (0.25, 0, 0, 0.75)),
    ):
        drawn = [draw_material_class(rng, category) for _ in range(2000)]
        for name, share in zip(MATERIAL_CLASSES, expected, strict=True):
            assert abs(drawn.count(name) / 2000 - share) < 0.04, (category, name)


def test_ablations_restrict_the_classes() -> None:
    rng = np.random.default_rng(8)
    opaque = [c for c in MATERIAL_CLASSES if c != "transparent"]
    drawn = [draw_material_class(rng, "bowl", allowed=opaque) for _ in range(2000)]
    assert "transparent" not in drawn
    assert abs(drawn.count("specular") / 2000 - 0.5) < 0.04
    assert draw_material_class(rng, "bowl", allowed=("raw",)) == "raw"
    assert draw_material_class(rng, "camera", allowed=("transparent",)) == "transparent"
    with pytest.raises(ToolkitError, match="allowed"):
        draw_material_class(rng, "bowl", allowed=())


def change(document, *path_and_value):
    *path, value = path_and_value
    for key in path[:-1]:
        document = document[key]
    document[path[-1]] = value


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (("opaque", 3, "base", "roughness", 1.4), r"opaque\[3\]\.base\.roughness"),
        (("glass", 1, "ior", [1.6, 1.5]), r"glass\[1\]\.ior: must be a rising pair"),
        (("opaque", 0, "family", "glass"), r"opaque\[0\]\.family: needs a family"),
        (("opaque", 0, "colour", [1, 1, 1]), "colour"),
        (("families", "wood", "jitter", "shine", [0, 1]), r"jitter\.shine: no such parameter"),
        (("opaque", 1, "name", "chrome"), "appears twice"),
        (("opaque", 40, "texture", {"kind": "wool", "tile_m": [1, 1], "contrast": [0, 0]}), "wool"),
    ],
)
def test_a_wrong_library_is_refused_with_the_place(tmp_path, edit, message) -> None:
    document = json.loads(BUILT_IN.read_text())
    change(document, *edit)
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(document))
    with pytest.raises(ToolkitError, match=message) as caught:
        load_library(path)
    assert "mine.json" in str(caught.value)


def test_a_user_s_library_is_drawn_from(tmp_path) -> None:
    document = json.loads(BUILT_IN.read_text())
    document["opaque"] = [m for m in document["opaque"] if m["name"] == "gold"]
    path = tmp_path / "gold.json"
    path.write_text(json.dumps(document))
    library = load_library(path)
    assert draw_material(np.random.default_rng(0), "specular", library=library).name == "gold"
    with pytest.raises(ToolkitError, match="no diffuse material"):
        draw_material(np.random.default_rng(0), "diffuse", library=library)
    with pytest.raises(ToolkitError, match="no such material class"):
        draw_material(np.random.default_rng(0), "shiny", library=library)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", get_args(TextureKind))
def test_textures_tile_and_keep_their_colour(kind) -> None:
    color = (0.4, 0.25, 0.12)
    texture = DrawnTexture(kind=kind, tile_m=0.1, contrast=0.5, seed=11)
    image = make_texture(texture, color)
    assert image.shape == (256, 256, 3)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, make_texture(texture, color))
    other = make_texture(msgspec.structs.replace(texture, seed=12), color)
    assert np.mean(other != image) > 0.1
    # Across the border of two tiles the steps are as large as within one.
    steps = np.abs(np.diff(image.astype(int), axis=1)).mean()
    seam = np.abs(image[:, 0].astype(int) - image[:, -1]).mean()
    assert seam < 4 * steps + 2
    if kind not in ("print", "collage"):  # they have inks of their own
        np.testing.assert_allclose(to_linear(image).mean(axis=(0, 1)), color, rtol=0.12)
    flat = make_texture(msgspec.structs.replace(texture, contrast=0.0), color)
    assert np.ptp(flat.reshape(-1, 3), axis=0).max() <= 1


@pytest.mark.parametrize("seed", range(12))
def test_every_collage_has_a_few_colours_of_its_own(seed) -> None:
    texture = DrawnTexture(kind="collage", tile_m=0.1, contrast=1.0, seed=seed)
    image = make_texture(texture, (0.5, 0.5, 0.5))
    assert image.astype(int).reshape(-1, 3).std(axis=0).max() > 4
    assert 1 < len(np.unique(image.reshape(-1, 3) // 32, axis=0)) < 120


def test_srgb_round_trip_and_noise_statistics() -> None:
    every = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(to_srgb(to_linear(every)), every)
    noise = tiling_noise(np.random.default_rng(0), 64, slope=1.0, stretch=30.0)
    along, across = (np.abs(np.diff(noise, axis=a)).mean() for a in (1, 0))
    assert along < 0.5 * across
    assert abs(noise.mean()) < 1e-5


def test_materials_have_their_own_brightness_in_infrared() -> None:
    library = load_library()
    assert all(m.infrared is not None for m in library.opaque)
    by_name = {m.name: m for m in library.opaque}
    # Dye fades beyond the visible, carbon black does not.
    for name in ("wood_ebony", "fabric_denim", "leather_brown"):
        low, high = by_name[name].infrared or (0.0, 0.0)
        assert low + high > 2 * sum(by_name[name].color[1]) / 3
    assert (by_name["rubber_black"].infrared or (1.0, 1.0))[1] < 0.1
    for seed in range(20):
        drawn = draw_material(np.random.default_rng(seed), "diffuse")
        low, high = by_name[drawn.name].infrared or (0.0, 0.0)
        assert drawn.infrared is not None and low <= drawn.infrared <= high
        assert library.raw.infrared[0] <= drawn.own_infrared <= library.raw.infrared[1]
    raw = draw_material(np.random.default_rng(0), "raw")
    assert raw.infrared == raw.own_infrared
