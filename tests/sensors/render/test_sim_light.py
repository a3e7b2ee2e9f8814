"""How much light arrives: both tracers agree, glass lets the projector through, noise, seeds."""

from __future__ import annotations

import gc

import msgspec
import numpy as np
import pytest
import trimesh

from sensors.lighting.environment_sources import studio_map
from sensors.materials.material_draw import Glass, draw_material
from sensors.render import mitsuba_scene as shapes
from sensors.render.mitsuba_renderer import MitsubaRenderer, bounded_mean, clipped_mean
from sensors.render.sim_renderer import LoadedScene, RenderOptions, SimRenderer
from sensors.render.sim_scene import Projector, SceneObject, SimScene, SurfaceMesh, TruthCaster
from sensors.render.smoke import looking_down
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

CAMERA = Camera(64, 48, 70.0, 70.0, 31.5, 23.5)
VIEW = looking_down(0.7)
LAMP = Projector(
    np.ones((64, 64), np.float32), 80.0, VIEW @ SE3(np.eye(3), np.array([0.05, 0, 0])), power=0.3
)


def mesh_of(shape) -> SurfaceMesh:
    return SurfaceMesh(np.asarray(shape.vertices), np.asarray(shape.faces))


@pytest.fixture(scope="module")
def mixed(square, chalk) -> SimScene:
    """A ball of each class on chalk, under a studio's light."""
    rng = np.random.default_rng(4)
    ball = mesh_of(trimesh.creation.icosphere(3, 0.08))
    objects = [SceneObject(0, square, SE3.identity(), chalk)]
    for i, name in enumerate(("diffuse", "specular", "transparent")):
        T = SE3(np.eye(3), np.array([0.2 * (i - 1), 0.02, 0.08]))
        objects.append(SceneObject(i + 1, ball, T, draw_material(rng, name)))
    return SimScene(tuple(objects), studio_map(3), 0.7)


@pytest.fixture(scope="module")
def loaded(mixed, variant):
    return MitsubaRenderer(variant=variant, check=False).load(mixed)


def test_the_renderer_keeps_the_protocol(mixed, variant, loaded) -> None:
    renderer = MitsubaRenderer(variant=variant, check=False)
    assert isinstance(renderer, SimRenderer)
    assert isinstance(loaded, LoadedScene)
    assert renderer.name == f"mitsuba/{variant}"


@pytest.mark.slow
def test_own_tracer_agrees_with_mitsuba_s(mixed, compiled) -> None:
    """Another integrator, sensor, environment and projector, the same light; without glass."""
    mixed = SimScene(mixed.objects[:3], mixed.environment, mixed.environment_rotation_rad)
    import mitsuba as mi

    from sensors.render.builtin_tracer import BuiltinTracer

    own = MitsubaRenderer(variant=compiled, check=False).load(mixed)
    others = {
        name: BuiltinTracer(
            shapes.build(mi, mixed, infrared=name == "infrared")[0].everything,
            shapes.environment(mi, mixed),
        )
        for name in ("color", "infrared")
    }
    options = RenderOptions(samples=256, chunk=16, max_depth=8, diffuse_bounces=8)

    def reference(name: str, *args: object, **keywords: object) -> np.ndarray:
        # Its image of a bright metal ball differs by 3 % from seed to seed, ours by 0.4 %.
        seeds = (3, 4, 5)
        images = [
            clipped_mean(others[name].radiance(*args, options=options, seed=seed, **keywords))
            for seed in seeds
        ]
        return np.mean(images, axis=0)

    pairs = {
        "color": (
            own.color(CAMERA, VIEW, ambient=0.5, options=options, seed=5).radiance,
            reference("color", CAMERA, VIEW, None, ambient=0.5, grey=False),
        ),
        "infrared": (
            own.infrared(CAMERA, VIEW, LAMP, ambient=0.05, options=options, seed=5),
            reference("infrared", CAMERA, VIEW, LAMP, ambient=0.05, grey=True),
        ),
    }
    mask = TruthCaster(mixed).maps(CAMERA, VIEW).mask
    for name, (a, b) in pairs.items():
        assert np.asarray(a).size == b.size
        for i in range(3):
            ratio = float(np.mean(a[mask == i]) / np.mean(b[mask == i]))
            assert ratio == pytest.approx(1, abs=0.015), (name, i)


@pytest.mark.slow
def test_dots_and_ambient_light_apart_add_up(mixed, compiled) -> None:
    """The same light as both together, without the noise of paths and with sharp dots."""
    pytest.importorskip("pyoidn", reason="the denoiser is not installed")
    # Dots of two pixels.
    dots = np.kron(np.random.default_rng(0).random((30, 30)) < 0.2, np.ones((8, 8)))
    lamp = Projector(dots.astype(np.float32), 80.0, LAMP.T_world_projector, power=0.3)
    loaded = MitsubaRenderer(variant=compiled, check=False).load(mixed)
    floor = TruthCaster(mixed).maps(CAMERA, VIEW).mask == 0

    def views(options: RenderOptions, seeds: range) -> np.ndarray:
        return np.stack(
            [
                loaded.infrared(CAMERA, VIEW, lamp, ambient=0.05, options=options, seed=seed)
                for seed in seeds
            ]
        )

    many = views(RenderOptions(samples=256, chunk=0), range(1))[0]
    apart = views(RenderOptions(samples=4, chunk=1, ambient_samples=4), range(4))
    together = views(RenderOptions(samples=16, chunk=4), range(4))
    assert apart.dtype == np.float32 and apart.shape == (4, 48, 64)
    assert apart[:, floor].mean() == pytest.approx(many[floor].mean(), rel=0.02)
    noise = [views_of.std(axis=0)[floor].mean() for views_of in (apart, together)]
    assert noise[0] < 0.5 * noise[1]
    assert np.corrcoef(apart[0][floor], many[floor])[0, 1] > 0.97
    assert apart[0][floor].std() == pytest.approx(many[floor].std(), rel=0.05)


@pytest.mark.slow
def test_what_is_denoised_has_no_dots(square, chalk, compiled) -> None:
    """Light of the projector is in it only after a diffuse surface has scattered it."""
    floor = SceneObject(0, square, SE3.identity(), chalk)
    wall = SceneObject(1, square, SE3.exp([0, 0.2, 0, np.pi / 2, 0, 0]), chalk)
    options = RenderOptions(samples=16, chunk=0)

    def lit(*objects: SceneObject, **how: object) -> float:
        scene = SimScene(objects, studio_map(0, height=16))
        tracer = MitsubaRenderer(variant=compiled, check=False).load(scene)._tracer(infrared=True)
        keywords = {"ambient": 1e-9, "options": options, "seed": 0, "grey": True, **how}
        return float(tracer.radiance(CAMERA, VIEW, LAMP, **keywords).mean())

    dots = lit(floor)
    assert lit(floor, indirect=True) < 1e-6 * dots
    assert 0.005 * dots < lit(floor, wall, indirect=True) < 0.3 * dots


def test_only_paths_brighter_than_dots_are_bounded() -> None:
    rng = np.random.default_rng(0)
    # Edges of dots: the paths of a pixel differ fully.
    paths = (rng.random((50, 60, 4)) < 0.3).astype(np.float32)
    np.testing.assert_allclose(bounded_mean(paths), paths.mean(axis=2), rtol=1e-6)
    spoilt = paths.copy()
    spoilt[7, 7, 1] = 500
    assert bounded_mean(spoilt)[7, 7] <= 1.5


@pytest.mark.slow
def test_the_same_seed_gives_the_same_image(loaded) -> None:
    options = RenderOptions(samples=8, chunk=4)

    def look(seed):
        return loaded.infrared(CAMERA, VIEW, LAMP, ambient=0.05, options=options, seed=seed)

    np.testing.assert_array_equal(look(1), look(1))
    assert np.mean(look(1) != look(2)) > 0.9
    assert look(1).dtype == np.float32
    assert look(1).shape == (48, 64)


def test_a_matt_floor_returns_the_sky_s_light_by_its_albedo(square, variant, white_sky) -> None:
    from sensors.materials.material_draw import DrawnMaterial

    dark = DrawnMaterial(
        name="x",
        material_class="diffuse",
        color=(0.2, 0.4, 0.8),
        own_share=0.0,
        specular=0.0,
        roughness=1.0,
    )
    scene = SimScene((SceneObject(0, square, SE3.identity(), dark),), white_sky)
    seen = MitsubaRenderer(variant=variant, check=False).load(scene)
    options = RenderOptions(samples=64, chunk=0)
    light = seen.color(CAMERA, looking_down(0.4), ambient=2.0, options=options).radiance
    middle = light[16:32, 24:40].mean(axis=(0, 1))
    # The principled diffuse lobe lies a few per cent off Lambert's law.
    np.testing.assert_allclose(middle, [0.4, 0.8, 1.6], rtol=0.06)


@pytest.mark.slow
def test_the_projector_passes_straight_through_a_pane(square, chalk, variant, white_sky) -> None:
    """A pane between projector and floor, outside the camera's view of the spot behind it."""
    glass = draw_material(np.random.default_rng(1), "transparent")
    assert glass.glass is not None
    pane = mesh_of(trimesh.creation.box((0.3, 0.3, 0.01)))
    lamp = Projector(
        np.ones((32, 32), np.float32), 30.0, looking_down(1.2) @ SE3.identity(), power=1.0
    )
    camera = Camera(32, 32, 60.0, 60.0, 15.5, 15.5)
    # From the side, below the pane: nothing but floor is seen.
    view = SE3.exp([0, 0, 0, 0, 0, 0])
    forward = np.array([-0.5, 0.0, -0.3]) / np.hypot(0.5, 0.3)
    right = np.array([0.0, 1.0, 0.0])
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    view = SE3(R, np.array([0.5, 0.0, 0.3]))
    floor = SceneObject(0, square, SE3.identity(), chalk)
    options = RenderOptions(samples=64, chunk=0)
    spot = {}
    for share in (None, 0.3, 0.8):
        objects = [floor]
        if share is not None:
            mixed = msgspec.structs.replace(
                glass, glass=Glass(ior=1.5, roughness=0.0, transmission=share)
            )
            T = SE3(np.eye(3), np.array([0.0, 0.0, 0.9]))
            objects.append(SceneObject(1, pane, T, mixed))
        loaded = MitsubaRenderer(variant=variant, check=False).load(
            SimScene(tuple(objects), white_sky)
        )
        image = loaded.infrared(camera, view, lamp, ambient=0.0, options=options)
        spot[share] = float(image[12:20, 12:20].mean())
    # Two of four faces, each reflecting 4 %; what the pane sends back down adds a little.
    for share in (0.3, 0.8):
        expected = share**0.5 * 0.96**2
        assert spot[share] / spot[None] == pytest.approx(expected, abs=0.02)


def test_dots_are_sharp_on_chalk_and_missing_on_metal(square, chalk, variant, white_sky) -> None:
    rng = np.random.default_rng(0)
    dots = np.zeros((300, 300), np.float32)
    dots[rng.integers(0, 300, 1500), rng.integers(0, 300, 1500)] = 1
    lamp = Projector(dots, 60.0, VIEW @ SE3(np.eye(3), np.array([0.05, 0, 0])), power=1.0)
    ball = mesh_of(trimesh.creation.icosphere(4, 0.12))
    T = SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    chrome = draw_material(np.random.default_rng(0), "specular", name="chrome")
    chrome = msgspec.structs.replace(chrome, own_share=0.0)
    contrast = {}
    camera = Camera(128, 96, 200.0, 200.0, 63.5, 47.5)
    for material in (chalk, chrome):
        scene = SimScene(
            (SceneObject(0, square, SE3.identity(), chalk), SceneObject(1, ball, T, material)),
            white_sky,
        )
        image = (
            MitsubaRenderer(variant=variant, check=False)
            .load(scene)
            .infrared(camera, VIEW, lamp, ambient=0.03, options=RenderOptions(samples=32, chunk=8))
        )
        # Inside the ball, away from the highlight in its middle.
        part = image[30:66, 84:96]
        contrast[material.name] = float(np.percentile(part, 98) - np.median(part))
    assert contrast["chalk"] > 5 * contrast["chrome"]


@pytest.mark.slow
def test_views_compile_no_new_kernels(loaded, compiled) -> None:
    import drjit as dr

    options = RenderOptions(samples=4, chunk=0)

    def kernels(i: int) -> list[dict]:
        """What the i-th view ran, in order."""
        move = SE3.exp([0.02 * i, 0, 0, 0, 0.01 * i, 0])
        lamp = Projector(LAMP.pattern, 80.0, VIEW @ move, power=0.3 + 0.01 * i)
        dr.kernel_history_clear()
        loaded.infrared(CAMERA, VIEW @ move, lamp, ambient=0.05 + 0.01 * i, options=options, seed=i)
        loaded.color(CAMERA, VIEW @ move, ambient=0.5 + 0.1 * i, options=options, seed=i)
        return dr.kernel_history([dr.KernelType.JIT])

    # A kernel contains how many surfaces are alive in the process. The first view makes those of
    # both kinds of light, after which none may come or go: other tests' scenes end here.
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        kernels(0)
        gc.collect()
        gc.disable()
        try:
            first, second, third = kernels(0), kernels(1), kernels(2)
        finally:
            gc.enable()
    # Hashes, because a hit may also come from the user's cache on disk.
    assert len(first) == 3
    hashes = [[k["hash"] for k in view] for view in (first, second, third)]
    assert hashes[1] == hashes[2] == hashes[0]
    assert all(k["cache_hit"] for k in (*second, *third))


def test_lens_distortion_is_refused(loaded) -> None:
    bent = Camera(64, 48, 70.0, 70.0, 31.5, 23.5, (0.1, 0, 0, 0))
    with pytest.raises(ToolkitError, match="pinhole"):
        loaded.color(bent, VIEW, ambient=1.0)


def test_clipping_removes_single_bright_paths_only() -> None:
    rng = np.random.default_rng(0)
    agreeing = rng.uniform(0.9, 1.1, (20, 20, 4, 1)).astype(np.float32)
    np.testing.assert_allclose(clipped_mean(agreeing), agreeing.mean(axis=2), rtol=1e-6)
    spoilt = agreeing.copy()
    spoilt[5, 5, 2] = 400
    cleaned = clipped_mean(spoilt)
    assert cleaned[5, 5, 0] < 1.5
    untouched = np.ones((20, 20), bool)
    untouched[5, 5] = False
    np.testing.assert_allclose(cleaned[untouched], agreeing.mean(axis=2)[untouched], rtol=1e-5)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"samples": 10, "chunk": 4}, "multiple of the chunk"),
        ({"samples": 0, "chunk": 0}, "samples: must be at least 1"),
        ({"max_depth": 0}, "max_depth"),
        ({"ambient_samples": -1}, "ambient_samples"),
    ],
)
def test_bad_options_are_refused(keywords, message) -> None:
    with pytest.raises(ToolkitError, match=message):
        RenderOptions(**keywords)
