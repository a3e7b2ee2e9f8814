"""Where things appear: pixel centres, axes, projector, texture, and the exact maps."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
import trimesh

from sensors.materials.material_draw import draw_material
from sensors.render.mitsuba_renderer import MitsubaRenderer
from sensors.render.sim_renderer import RenderOptions
from sensors.render.sim_scene import Projector, SceneObject, SimScene, SurfaceMesh, TruthCaster
from sensors.render.smoke import looking_down
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

# Neither centred nor of square pixels in the middle of the image: mistakes of half a pixel show.
CAMERA = Camera(96, 64, 110.0, 110.0, 50.3, 29.1)
T_WORLD_CAM = looking_down(0.8) @ SE3.exp([0.02, -0.03, 0.0, 0.12, -0.2, 0.3])
EVERYWHERE = Projector(np.ones((256, 256), np.float32), 120.0, T_WORLD_CAM, power=1.0)


def centroid(image) -> np.ndarray:
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(image * u).sum(), (image * v).sum()]) / image.sum()


@pytest.mark.slow
@pytest.mark.parametrize("which", ["best", "scalar_rgb"])
def test_pixel_centres_lie_at_integers(which, variant, square, chalk, white_sky) -> None:
    small = SurfaceMesh(square.vertices * [0.25, 0.15, 1], square.faces)
    T = SE3(np.eye(3), np.array([0.03, 0.02, 0.0]))
    scene = SimScene((SceneObject(1, small, T, chalk),), white_sky)
    renderer = MitsubaRenderer(variant=variant if which == "best" else which, check=False)
    image = renderer.load(scene).infrared(
        CAMERA, T_WORLD_CAM, EVERYWHERE, ambient=0.0, options=RenderOptions(samples=256, chunk=0)
    )
    # What an imager with square pixels sees: the share of every pixel that the square covers.
    T_cam_obj = T_WORLD_CAM.inverse() @ T
    covered = np.zeros(image.shape)
    fine = 32
    steps = (np.arange(fine) + 0.5) / fine - 0.5
    for du in steps:
        for dv in steps:
            rays = CAMERA.unproject(CAMERA.pixel_grid() + np.array([du, dv]))
            R, t = T_cam_obj.R, T_cam_obj.t
            on = rays * ((R[:, 2] @ t) / (rays @ R[:, 2]))[..., None]
            local = (on - t) @ R
            inside = (np.abs(local[..., 0]) < 0.125) & (np.abs(local[..., 1]) < 0.075)
            distance2 = (on**2).sum(-1)
            cosine = np.abs(on @ R[:, 2]) / np.sqrt(distance2)
            covered += np.where(inside, cosine / distance2, 0)
    # The light of the projector at the camera falls off with distance and slant as above.
    assert image.max() > 0
    np.testing.assert_allclose(centroid(image), centroid(covered), atol=0.01)


def test_a_texture_stands_upright(variant, square, chalk, white_sky) -> None:
    image = np.zeros((32, 32, 3), np.uint8)
    image[:16, :, 0] = 255  # red at v = 1, which is +y
    image[:, 16:, 2] = 255  # blue at u = 1, which is +x
    scene = SimScene((SceneObject(0, square, SE3.identity(), chalk, texture=image),), white_sky)
    seen = MitsubaRenderer(variant=variant, check=False).load(scene)
    view = seen.color(
        Camera(32, 32, 40.0, 40.0, 15.5, 15.5),
        looking_down(0.8),  # image x is world x, image y is world -y
        ambient=1.0,
        options=RenderOptions(samples=16, chunk=0),
    ).radiance
    top, bottom, left, right = view[:12], view[20:], view[:, :12], view[:, 20:]
    assert top[..., 0].mean() > 10 * bottom[..., 0].mean()
    assert right[..., 2].mean() > 10 * left[..., 2].mean()


@pytest.mark.slow
@pytest.mark.parametrize("which", ["best", "scalar_rgb"])
def test_the_projector_s_image_lands_where_it_should(
    which, variant, square, chalk, white_sky
) -> None:
    pattern = np.zeros((61, 81), np.float32)
    pattern[20:23, 50:53] = 1  # right of and above its middle
    T_world_projector = T_WORLD_CAM @ SE3.exp([0.05, 0.01, 0.0, 0.05, -0.04, 0.1])
    projector = Projector(pattern, 60.0, T_world_projector, power=1.0)
    scene = SimScene((SceneObject(0, square, SE3.identity(), chalk),), white_sky)
    camera = Camera(192, 128, 220.0, 220.0, 100.3, 59.1)
    renderer = MitsubaRenderer(variant=variant if which == "best" else which, check=False)
    image = renderer.load(scene).infrared(
        camera, T_WORLD_CAM, projector, ambient=0.0, options=RenderOptions(samples=64, chunk=0)
    )
    tan_x, tan_y = projector.tan_half
    ray = np.array([((51 + 0.5) / 81 * 2 - 1) * tan_x, ((21 + 0.5) / 61 * 2 - 1) * tan_y, 1])
    along = T_world_projector.R @ ray
    point = T_world_projector.t - along * T_world_projector.t[2] / along[2]
    np.testing.assert_allclose(
        centroid(image), camera.project(T_WORLD_CAM.inverse() @ point), atol=0.06
    )
    # Irradiance where the pattern is 1: power / distance^2 times the cosine on the floor. The
    # surface is Lambertian to a few per cent only.
    distance = np.linalg.norm(point - T_world_projector.t)
    cosine = abs(along[2]) / np.linalg.norm(along)
    expected = 0.5 / np.pi * cosine / distance**2
    assert image.max() == pytest.approx(expected, rel=0.15)


def cluttered_scene(white_sky, chalk, square) -> SimScene:
    rng = np.random.default_rng(2)
    shapes = [trimesh.creation.torus(0.06, 0.025), trimesh.creation.icosphere(3, 0.05)]
    shapes.append(trimesh.creation.box((0.09, 0.06, 0.13)))
    objects = [SceneObject(0, square, SE3.identity(), chalk)]
    for i, shape in enumerate(shapes):
        pose = SE3.exp([0, 0, 0, *rng.normal(0, 1, 3)])
        pose = SE3(pose.R, np.array([0.15 * (i - 1), 0.03 * i, 0.1]))
        mesh = SurfaceMesh(np.asarray(shape.vertices), np.asarray(shape.faces))
        name = ("specular", "transparent", "diffuse")[i]
        objects.append(SceneObject(i + 1, mesh, pose, draw_material(rng, name)))
    return SimScene(tuple(objects), white_sky)


def test_exact_maps_agree_with_the_renderer_s_own_hits(compiled, square, chalk, white_sky) -> None:
    scene = cluttered_scene(white_sky, chalk, square)
    maps = TruthCaster(scene).maps(CAMERA, T_WORLD_CAM)
    loaded = MitsubaRenderer(variant=compiled, check=False).load(scene)
    depth, normal = loaded.first_hits(CAMERA, T_WORLD_CAM)
    assert set(np.unique(maps.mask)) == {0, 1, 2, 3}
    assert (maps.depth > 0).mean() > 0.5
    differs = np.abs(maps.depth - depth) > 1e-5
    assert differs.mean() < 1e-3  # rays that graze an edge
    # Flat faces: the box's normals are the triangles' own, turned towards the camera.
    box = (maps.mask == 3) & ~differs
    seen = normal[box] @ T_WORLD_CAM.R
    towards = np.einsum("ij,ij->i", seen, CAMERA.rays()[box]) > 0
    seen[towards] *= -1
    np.testing.assert_allclose(seen, maps.normals[box], atol=1e-4)


def test_exact_maps_of_a_known_view(square, chalk, white_sky) -> None:
    ball = trimesh.creation.icosphere(5, 0.1)
    mesh = SurfaceMesh(np.asarray(ball.vertices), np.asarray(ball.faces))
    T = SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    scene = SimScene(
        (SceneObject(0, square, SE3.identity(), chalk), SceneObject(7, mesh, T, chalk)), white_sky
    )
    camera = Camera(65, 65, 80.0, 80.0, 32.0, 32.0)
    maps = TruthCaster(scene).maps(camera, looking_down(0.8))
    assert maps.depth[32, 32] == pytest.approx(0.6, abs=2e-4)
    assert maps.mask[32, 32] == 7
    np.testing.assert_allclose(maps.normals[32, 32], [0, 0, -1], atol=0.03)
    # Top of the ball in its own frame, divided by the box's diagonal.
    np.testing.assert_allclose(
        maps.nocs[32, 32], [0.5, 0.5, 0.5 + 0.1 / (0.2 * np.sqrt(3))], atol=2e-3
    )
    assert maps.depth[2, 2] == pytest.approx(0.8, abs=1e-6)
    assert maps.mask[2, 2] == 0
    assert (maps.nocs[2, 2] == 0).all()
    np.testing.assert_allclose(maps.normals[2, 2], [0, 0, -1], atol=1e-6)


def test_shares_of_glass_do_not_move_the_truth(square, chalk, white_sky) -> None:
    scene = cluttered_scene(white_sky, chalk, square)
    glass = draw_material(np.random.default_rng(0), "transparent")
    clear = tuple(
        SceneObject(o.instance_id, o.mesh, o.T_world_obj, msgspec.structs.replace(glass))
        for o in scene.objects
    )
    a = TruthCaster(scene).maps(CAMERA, T_WORLD_CAM)
    b = TruthCaster(SimScene(clear, white_sky)).maps(CAMERA, T_WORLD_CAM)
    np.testing.assert_array_equal(a.depth, b.depth)
