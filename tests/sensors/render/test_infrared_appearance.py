"""Surfaces in infrared: how bright, and how much of their pattern is left."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from sensors.materials.material_draw import DrawnMaterial
from sensors.materials.textures import to_linear
from sensors.render.mitsuba_renderer import MitsubaRenderer
from sensors.render.mitsuba_scene import appearance, infrared_appearance
from sensors.render.sim_renderer import RenderOptions
from sensors.render.sim_scene import Projector, SceneObject, SimScene
from sensors.render.smoke import looking_down
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

STRIPES = np.zeros((64, 64, 3), np.uint8)
STRIPES[:, ::2] = 200


@pytest.fixture
def cloth(chalk) -> DrawnMaterial:
    return msgspec.structs.replace(
        chalk, own_share=0.75, infrared=0.2, own_infrared=0.6, infrared_pattern=0.3
    )


def test_pattern_fades_and_brightness_is_the_material_s(square, cloth) -> None:
    item = SceneObject(1, square, SE3.identity(), cloth, texture=STRIPES)
    seen = appearance(item)
    look = infrared_appearance(seen, cloth)
    light = to_linear(look.image)
    assert light.mean() == pytest.approx(0.75 * 0.6 + 0.25 * 0.2, abs=0.005)
    assert np.ptp(light, axis=-1).max() == 0
    visible = to_linear(seen.image).mean(axis=-1)
    contrast = [(x.max() - x.min()) / x.mean() for x in (light, visible)]
    assert contrast[0] == pytest.approx(0.3 * contrast[1], rel=0.05)
    np.testing.assert_array_equal(look.uv, seen.uv)


def test_without_a_value_infrared_is_as_seen(square, chalk) -> None:
    look = appearance(SceneObject(1, square, SE3.identity(), chalk, texture=STRIPES))
    assert infrared_appearance(look, chalk) is look


@pytest.mark.slow
@pytest.mark.parametrize("which", ["best", "scalar_rgb"])
def test_each_kind_of_image_shows_its_own_brightness(which, variant, square, chalk, white_sky):
    """Colour stays as it is, infrared gets what the material has there."""
    coat = msgspec.structs.replace(chalk, infrared=0.6, own_infrared=0.6)
    renderer = MitsubaRenderer(variant=variant if which == "best" else which, check=False)
    camera, view = Camera(24, 24, 60.0, 60.0, 11.5, 11.5), looking_down(0.5)
    lamp = Projector(np.ones((8, 8), np.float32), 60.0, view, power=1.0)
    options = RenderOptions(samples=32, chunk=0)
    seen = []
    for material in (chalk, coat):
        item = SceneObject(1, square, SE3.identity(), material, color=(0.2, 0.2, 0.2))
        loaded = renderer.load(SimScene((item,), white_sky))
        color = loaded.color(camera, view, ambient=1.0, options=options).radiance.mean()
        infrared = loaded.infrared(camera, view, lamp, ambient=0.1, options=options).mean()
        seen.append((float(color), float(infrared)))
    assert seen[1][0] == pytest.approx(seen[0][0], rel=0.02)
    assert seen[1][1] == pytest.approx(3 * seen[0][1], rel=0.05)
