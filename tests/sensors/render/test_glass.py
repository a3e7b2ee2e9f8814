"""Glass: Snell's law, Fresnel's losses, parts of objects, and scenes that change their look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from sensors.lighting.environment_sources import studio_map
from sensors.materials.material_draw import DrawnMaterial, Glass, draw_material
from sensors.render.mitsuba_renderer import MitsubaRenderer
from sensors.render.sim_renderer import RenderOptions
from sensors.render.sim_scene import Projector, SceneObject, SimScene, SurfaceMesh
from sensors.render.smoke import looking_down, smallest_scene
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

CAMERA = Camera(64, 48, 70.0, 70.0, 31.5, 23.5)
LAMP = Projector(np.ones((32, 32), np.float32), 80.0, looking_down(0.7), power=0.3)


def glass(**numbers: float) -> DrawnMaterial:
    return DrawnMaterial(
        name="x",
        material_class="transparent",
        color=(1, 1, 1),
        own_share=0.0,
        glass=Glass(**{"ior": 1.5, "roughness": 0.0, "transmission": 1.0, **numbers}),
    )


def edge_through_slab(square, compiled, material: DrawnMaterial | None) -> float:
    """Where the edge of a black half of the floor is seen, in metres on the floor."""
    picture = np.full((2, 64, 3), 250, np.uint8)
    picture[:, :32] = 5
    floor = SurfaceMesh(
        np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
        np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]),
    )
    own = DrawnMaterial(name="print", material_class="raw", color=(1, 1, 1), own_share=1.0)
    objects = [SceneObject(0, floor, SE3.identity(), own, texture=picture)]
    if material is not None:
        slab = trimesh.creation.box((0.6, 0.6, THICK))
        tilted = SE3.exp([0, 0, 0, 0, np.deg2rad(TILT), 0])
        mesh = SurfaceMesh(np.asarray(slab.vertices), np.asarray(slab.faces))
        objects.append(SceneObject(1, mesh, SE3(tilted.R, np.array([0, 0, 0.3])), material))
    scene = SimScene(tuple(objects), studio_map(0, height=16))
    loaded = MitsubaRenderer(variant=compiled, check=False).load(scene)
    # From far away rays are nearly parallel.
    camera = Camera(400, 100, 2000.0, 2000.0, 199.5, 49.5)
    albedo, _ = loaded._tracer(infrared=False).features(
        camera, looking_down(4.0), samples=4, seed=0
    )
    row = albedo.mean(axis=(0, 2))
    return float(np.abs(row - 0.5 * (row.min() + row.max())).argmin() - 199.5) / 500


THICK, TILT = 0.04, 30.0


@pytest.mark.slow
def test_a_tilted_slab_shifts_what_lies_behind_by_snell_s_law(square, compiled) -> None:
    plain = edge_through_slab(square, compiled, None)
    shift = abs(edge_through_slab(square, compiled, glass()) - plain)
    sin, cos = np.sin(np.deg2rad(TILT)), np.cos(np.deg2rad(TILT))
    exact = THICK * sin * (1 - cos / np.sqrt(1.5**2 - sin**2))
    assert shift == pytest.approx(exact, abs=0.002)
    # A sheet as thin as its bend says.
    thin = abs(edge_through_slab(square, compiled, glass(bend=0.0)) - plain)
    assert thin < 0.002


@pytest.mark.slow
def test_faces_lose_light_by_fresnel_and_never_gain(compiled) -> None:
    import mitsuba as mi

    mi.set_variant(compiled)
    from sensors.render import glass as optics

    cosine = mi.Float(np.linspace(0.02, 1, 50))
    ours = np.array(optics.fresnel(cosine, mi.Float(1.5)))
    theirs = np.array(mi.fresnel(cosine, mi.Float(1.5))[0])
    np.testing.assert_allclose(ours, theirs, atol=1e-5)
    assert ours[-1] == pytest.approx(0.04, abs=1e-4)


def test_an_object_divides_into_its_parts() -> None:
    item = smallest_scene().objects[2]
    cap = draw_material(np.random.default_rng(0), "raw")
    numbers = np.array([0, 0, 1, 1, 0, 0])
    body, top = replace(item, face_parts=numbers, part_materials=(cap,)).surfaces()
    assert body.material is item.material and top.material is cap
    assert len(body.mesh.faces) == 4 and len(top.mesh.faces) == 2
    assert item.surfaces() == [item]
    with pytest.raises(ToolkitError, match="face_parts"):
        replace(item, face_parts=numbers)


@pytest.mark.slow
def test_a_changed_scene_is_that_of_a_new_one(compiled) -> None:
    """Light and floor are swapped: the images agree, but for rounding."""
    renderer = MitsubaRenderer(variant=compiled, check=False)
    scene = smallest_scene()
    floor = replace(scene.objects[0], material=draw_material(np.random.default_rng(5), "diffuse"))
    fresh = renderer.load(
        SimScene((floor, *scene.objects[1:]), studio_map(9), environment_rotation_rad=1.0)
    )
    changed = renderer.load(scene)
    options = RenderOptions(samples=4, chunk=0)

    def looks(loaded) -> tuple[np.ndarray, np.ndarray]:
        T = looking_down(0.7)
        color = loaded.color(CAMERA, T, ambient=0.5, options=options).radiance
        return color, loaded.infrared(CAMERA, T, LAMP, ambient=0.05, options=options)

    before = looks(changed)
    changed.change(studio_map(9), 1.0, floor)
    for was, now, wanted in zip(before, looks(changed), looks(fresh), strict=True):
        assert not np.array_equal(was, now)
        np.testing.assert_allclose(now, wanted, rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_both_eyes_in_one_launch_see_what_each_sees(compiled) -> None:
    pytest.importorskip("pyoidn", reason="the denoiser is not installed")
    loaded = MitsubaRenderer(variant=compiled, check=False).load(smallest_scene())
    T = looking_down(0.7)
    other = T @ SE3(np.eye(3), np.array([0.05, 0, 0]))
    options = RenderOptions(samples=16, chunk=1, ambient_samples=16)
    pair = loaded.infrared_pair(CAMERA, (T, other), LAMP, ambient=0.05, options=options, seed=1)
    for image, eye in zip(pair, (T, other), strict=True):
        alone = loaded.infrared(CAMERA, eye, LAMP, ambient=0.05, options=options, seed=7)
        assert image.shape == (48, 64)
        assert np.corrcoef(image.ravel(), alone.ravel())[0, 1] > 0.95
        assert image.mean() == pytest.approx(alone.mean(), rel=0.05)
    assert np.abs(pair[0] - pair[1]).mean() > 0.02 * pair[0].mean()
