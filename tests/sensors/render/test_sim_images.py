"""What sensors make of light, and what objects look like: exposure, noise, denoising, mixing."""

from __future__ import annotations

import builtins

import msgspec
import numpy as np
import pytest
import trimesh

from sensors.materials.material_draw import draw_material
from sensors.materials.textures import to_linear, to_srgb
from sensors.render.color_image import denoise, denoiser, develop
from sensors.render.mitsuba_scene import appearance, box_uv
from sensors.render.sim_renderer import ColorLight
from sensors.render.sim_scene import Projector, SceneObject, SimScene, SurfaceMesh
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3


def test_development_exposes_for_middle_grey_and_keeps_order() -> None:
    ramp = np.linspace(0.001, 30, 256, dtype=np.float32)
    exposure = 0.1
    image, _ = develop(np.repeat(ramp[None, :, None], 3, axis=2), exposure=exposure)
    assert image.dtype == np.uint8
    assert (np.diff(image[0, :, 0].astype(int)) >= 0).all()
    assert image[0, -1, 0] > 245
    flat, _ = develop(np.full((8, 8, 3), 7.0))
    np.testing.assert_allclose(flat, to_srgb(np.array(0.2)), atol=1)
    bright, used = develop(np.full((8, 8, 3), 7.0), exposure=exposure)
    assert used == exposure
    assert bright.mean() > flat.mean()


def noisy_light():
    v, u = np.mgrid[:96, :128]
    truth = np.where((u // 24 + v // 24) % 2 == 0, 0.6, 0.15)[..., None] * np.float32([1, 0.8, 0.6])
    rng = np.random.default_rng(0)
    noisy = truth * rng.gamma(6, 1 / 6, truth.shape)
    normal = np.broadcast_to(np.float32([0, 0, 1]), truth.shape).copy()
    return truth, ColorLight(noisy.astype(np.float32), truth.astype(np.float32), normal)


def test_denoising_comes_closer_to_the_truth() -> None:
    pytest.importorskip("pyoidn")
    denoiser.cache_clear()
    truth, light = noisy_light()
    before = np.sqrt(np.mean((light.radiance - truth) ** 2))
    after = np.sqrt(np.mean((denoise(light) - truth) ** 2))
    assert after < 0.25 * before


def test_without_a_denoiser_the_light_stays_and_a_warning_says_so(monkeypatch, caplog) -> None:
    real = builtins.__import__

    def refuse(name, *args, **keywords):
        if name == "pyoidn":
            raise ImportError("no such package")
        return real(name, *args, **keywords)

    monkeypatch.setattr(builtins, "__import__", refuse)
    denoiser.cache_clear()
    _, light = noisy_light()
    np.testing.assert_array_equal(denoise(light), light.radiance)
    assert "no denoiser" in caplog.text
    denoiser.cache_clear()


def test_own_look_and_material_mix_by_the_share(square) -> None:
    wood = draw_material(np.random.default_rng(0), "diffuse", name="wood_oak")
    plain = msgspec.structs.replace(wood, texture=None, own_share=0.75)
    flat = appearance(SceneObject(1, square, SE3.identity(), plain, color=(0.9, 0.1, 0.1)))
    expected = 0.75 * np.array([0.9, 0.1, 0.1]) + 0.25 * np.array(plain.color)
    np.testing.assert_allclose(to_linear(flat.image)[0, 0], expected, atol=0.01)

    print_ = np.random.default_rng(1).integers(0, 256, (64, 96, 3), dtype=np.uint8)
    own = appearance(SceneObject(1, square, SE3.identity(), plain, texture=print_))
    assert own.image.shape == print_.shape
    np.testing.assert_allclose(
        to_linear(own.image), 0.75 * to_linear(print_) + 0.25 * np.array(plain.color), atol=0.02
    )
    np.testing.assert_array_equal(own.uv, square.uv[square.faces].astype(np.float32))

    only = appearance(
        SceneObject(
            1, square, SE3.identity(), msgspec.structs.replace(wood, own_share=0.0), texture=print_
        )
    )
    assert only.image.shape == (256, 256, 3)
    # 1 m of floor shows as many tiles as fit.
    assert np.ptp(only.uv) == pytest.approx(1 / wood.texture.tile_m, rel=1e-5)


def test_boxes_are_textured_in_metres_on_every_side() -> None:
    box = trimesh.creation.box((0.2, 0.4, 0.6))
    uv = box_uv(SurfaceMesh(np.asarray(box.vertices), np.asarray(box.faces)))
    edges = np.ptp(uv, axis=1)
    assert {tuple(round(float(x), 3) for x in e) for e in edges} == {
        (0.2, 0.4),
        (0.2, 0.6),
        (0.4, 0.6),
    }


def test_bad_scenes_are_refused(square, chalk, white_sky) -> None:
    one = SceneObject(1, square, SE3.identity(), chalk)
    with pytest.raises(ToolkitError, match="instance ids must differ"):
        SimScene((one, one), white_sky)
    with pytest.raises(ToolkitError, match="at least one object"):
        SimScene((), white_sky)
    with pytest.raises(ToolkitError, match="instance_id"):
        SceneObject(255, square, SE3.identity(), chalk)
    with pytest.raises(ToolkitError, match=r"texture.*image of uint8"):
        SceneObject(1, square, SE3.identity(), chalk, texture=np.zeros((4, 4, 3)))  # type: ignore[arg-type]
    with pytest.raises(ToolkitError, match="uv: needs one pair per vertex"):
        SurfaceMesh(square.vertices, square.faces, np.zeros((3, 2)))
    with pytest.raises(ToolkitError, match="vertex that does not exist"):
        SurfaceMesh(square.vertices, square.faces + 2)
    with pytest.raises(ToolkitError, match="one grey image"):
        Projector(np.zeros((4, 4, 3)), 60.0)
    with pytest.raises(ToolkitError, match="fov_x_deg"):
        Projector(np.zeros((4, 4)), 190.0)
