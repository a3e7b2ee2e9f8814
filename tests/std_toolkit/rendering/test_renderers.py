"""All renderers against closed formulas: depth, edges to a hundredth of a pixel, agreement."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.rendering.choose import get_renderer
from std_toolkit.rendering.maps import Maps, object_silhouette, render_scene_maps
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import PlacedMesh, Raster, Renderer, Window, image_window
from tests.skips import need_gl

CAMERA = Camera(640, 480, 600.0, 605.0, 322.3, 236.8)
BALL_CENTRE = np.array([-0.06, 0.02, 0.7])
BALL_RADIUS = 0.06
BOX_EXTENTS = np.array([0.10, 0.06, 0.08])
BOX_POSE = SE3(SE3.exp(np.array([0, 0, 0, 0.5, 0.6, 0.1])).R, np.array([0.09, 0.0, 0.7]))


def ball_and_box() -> list[PlacedMesh]:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=BALL_RADIUS)
    return [
        PlacedMesh(1, ball, SE3(np.eye(3), BALL_CENTRE)),
        PlacedMesh(9, trimesh.creation.box(BOX_EXTENTS), BOX_POSE),
    ]


def sphere_depth(camera: Camera) -> np.ndarray:
    """(H,W) z of the first hit of every ray with the ball, NaN beside it."""
    rays = camera.rays()
    a, b = np.einsum("hwi,hwi->hw", rays, rays), rays @ BALL_CENTRE
    root = b * b - a * (BALL_CENTRE @ BALL_CENTRE - BALL_RADIUS**2)
    return (b - np.sqrt(np.where(root > 0, root, np.nan))) / a


def box_depth(camera: Camera) -> np.ndarray:
    """(H,W) z of the first hit of every ray with the box (slab method), NaN beside it."""
    origin, rays = BOX_POSE.inverse().t, camera.rays() @ BOX_POSE.R
    first, last = (-BOX_EXTENTS / 2 - origin) / rays, (BOX_EXTENTS / 2 - origin) / rays
    enter, leave = np.minimum(first, last).max(axis=2), np.maximum(first, last).min(axis=2)
    return np.where(enter < leave, enter, np.nan)


@pytest.fixture
def maps(renderer: Renderer) -> Maps:
    return render_scene_maps(renderer, CAMERA, ball_and_box())


def tolerance_m(renderer: Renderer) -> float:
    return 0.1e-3 if renderer.name == "raycast" else 0.3e-3


def test_depth_of_a_box_is_exact(renderer: Renderer, maps: Maps) -> None:
    expected = box_depth(CAMERA)
    seen = (maps.mask == 9) & np.isfinite(expected)
    assert np.abs(maps.depth[seen] - expected[seen]).max() < min(tolerance_m(renderer), 5e-6)
    assert np.count_nonzero((maps.mask == 9) ^ np.isfinite(expected)) <= 3


def test_depth_of_a_sphere(renderer: Renderer, maps: Maps) -> None:
    """At grazing rays the facets of any mesh differ from the sphere, so those are left out."""
    expected = sphere_depth(CAMERA)
    normal = (CAMERA.rays() * expected[..., None] - BALL_CENTRE) / BALL_RADIUS
    rays = CAMERA.rays() / np.linalg.norm(CAMERA.rays(), axis=2, keepdims=True)
    facing = -np.einsum("hwi,hwi->hw", normal, rays) > 0.1
    seen = (maps.mask == 1) & facing
    assert np.count_nonzero(seen) > 0.97 * np.count_nonzero(maps.mask == 1)
    assert np.abs(maps.depth[seen] - expected[seen]).max() < tolerance_m(renderer)
    either = (maps.mask == 1) | np.isfinite(expected)
    assert np.count_nonzero((maps.mask == 1) & np.isfinite(expected)) / either.sum() > 0.999


def test_smooth_normals_of_a_sphere(maps: Maps) -> None:
    expected = (CAMERA.rays() * sphere_depth(CAMERA)[..., None] - BALL_CENTRE) / BALL_RADIUS
    seen = (maps.mask == 1) & np.isfinite(expected[..., 0])
    cosine = np.einsum("ni,ni->n", maps.normals[seen], expected[seen])
    assert np.rad2deg(np.arccos(np.clip(np.median(cosine), -1, 1))) < 0.05
    assert np.rad2deg(np.arccos(np.clip(cosine.min(), -1, 1))) < 1.0


def test_nocs_is_the_mesh_coordinate(maps: Maps) -> None:
    """(p - centre)/diagonal + 0.5 lies on the box's surface and projects to its own pixel."""
    seen = maps.mask == 9
    local = (maps.nocs[seen].astype(np.float64) - 0.5) * np.linalg.norm(BOX_EXTENTS)
    assert np.abs(np.abs(local) / (BOX_EXTENTS / 2)).max() < 1 + 1e-4
    assert np.abs((np.abs(local) / (BOX_EXTENTS / 2)).max(axis=1) - 1).max() < 1e-4
    pixels = CAMERA.project(BOX_POSE @ local)
    assert np.abs(pixels - CAMERA.pixel_grid()[seen]).max() < 1e-2


def test_box_normals_keep_their_edges(maps: Maps) -> None:
    """Edges of 90 degrees are not smoothed over."""
    seen = maps.mask == 9
    local = maps.normals[seen] @ BOX_POSE.R.astype(np.float32)
    assert np.abs(np.abs(local).max(axis=1) - 1).max() < 1e-5
    rays = CAMERA.rays()[seen]
    assert np.einsum("ni,ni->n", maps.normals[seen], rays).max() < 0


def test_renderers_agree() -> None:
    need_gl()
    a, b = (render_scene_maps(get_renderer(n), CAMERA, ball_and_box()) for n in RENDERERS)
    for object_id in (1, 9):
        one, other = a.mask == object_id, b.mask == object_id
        assert np.count_nonzero(one & other) / np.count_nonzero(one | other) >= 0.999
    both = (a.mask == b.mask) & (a.mask > 0)
    assert np.quantile(np.abs(a.depth - b.depth)[both], 0.999) < 2e-5
    assert np.quantile(np.abs(a.nocs - b.nocs)[both], 0.999) < 1e-4
    assert np.quantile(np.abs(a.normals - b.normals)[both], 0.999) < 1e-3


RENDERERS = ("raycast", "pyrender")


def rectangle(left: float, top: float, right: float, bottom: float) -> RenderMesh:
    """A rectangle at z = 1 whose edges project to the given pixel coordinates."""
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    points = CAMERA.unproject(np.array(corners), 1.0)
    return RenderMesh.from_arrays(points, np.array([[0, 1, 2], [0, 2, 3]]))


@pytest.mark.parametrize("silhouette", [False, True], ids=["window", "silhouette"])
@pytest.mark.parametrize("edge", [0, 1, 2, 3])
@pytest.mark.parametrize("pixel", [(41, 37), (322, 236), (603, 447)])
def test_edges_lie_where_they_should_to_a_hundredth_of_a_pixel(
    renderer: Renderer, edge: int, pixel: tuple[int, int], silhouette: bool
) -> None:
    """An edge moved across a pixel's centre turns the pixel on where the edge meets the centre.

    Pixel centres are integers: moved by half a pixel, as in GL's own grid, the switch would be
    found 0.5 px away.
    """
    x, y = pixel
    centre = (x, y)[edge % 2]

    def is_on(position: float) -> bool:
        sides = [x - 9.3, y - 8.7, x + 9.6, y + 8.4]
        sides[edge] = position
        if silhouette:
            drawn = object_silhouette(renderer, CAMERA, rectangle(*sides), SE3.identity())
            return bool(drawn.image_mask(CAMERA)[y, x])
        window = Window(x - 3, y - 3, 7, 7)
        raster = renderer.draw(CAMERA, rectangle(*sides), SE3.identity(), window=window)
        return bool(raster.depth[3, 3] > 0)

    low, high = centre - 0.7, centre + 0.7
    assert is_on(low) != is_on(high)
    state = is_on(low)
    for _ in range(9):  # 1.4 px / 2**9 = 0.003 px
        middle = (low + high) / 2
        low, high = (middle, high) if is_on(middle) == state else (low, middle)
    assert abs((low + high) / 2 - centre) < 0.01


def test_centroid_of_discs(renderer: Renderer) -> None:
    """The mean pixel of a disc is its centre's projection: no half pixel anywhere.

    One disc's border pixels are on or off by chance (0.02 px); many discs' are not.
    """
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    rim = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), 0 * angle], axis=1)
    fan = np.stack([np.zeros(360, int), 1 + np.arange(360), 1 + (np.arange(360) + 1) % 360], axis=1)
    disc = RenderMesh.from_arrays(np.concatenate([np.zeros((1, 3)), rim]), fan)
    errors = []
    for uv in np.random.default_rng(0).uniform([150, 150], [450, 350], (64, 2)):
        pose = SE3(np.eye(3), CAMERA.unproject(uv, 0.9))
        window = Window(int(uv[0]) - 80, int(uv[1]) - 80, 161, 161)
        raster = renderer.draw(CAMERA, disc, pose, window=window)
        v, u = np.nonzero(raster.depth)
        errors.append([u.mean() + window.x - uv[0], v.mean() + window.y - uv[1]])
    assert np.abs(np.mean(errors, axis=0)).max() < 0.01


def test_a_surface_seen_from_behind_is_drawn(renderer: Renderer) -> None:
    """A bowl without thickness has no hole, and its normals point to the camera."""
    mesh = RenderMesh.from_arrays(
        np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    for turn in (0.0, np.pi):
        pose = SE3(SE3.exp(np.array([0, 0, 0, turn, 0, 0])).R, np.array([0, 0, 0.7]))
        maps = render_scene_maps(renderer, CAMERA, [PlacedMesh(1, mesh, pose)])
        assert np.count_nonzero(maps.mask) > 25000
        assert np.allclose(maps.normals[maps.mask == 1], [0, 0, -1], atol=1e-5)


def test_faces_are_those_under_the_pixel(renderer: Renderer) -> None:
    """The triangle reported holds the point that the depth gives."""
    item = ball_and_box()[0]
    mesh = item.prepared
    raster: Raster = renderer.draw(CAMERA, mesh, item.T_cam_obj, window=image_window(CAMERA))
    seen = raster.depth > 0
    assert np.array_equal(seen, raster.face >= 0)
    points = item.T_cam_obj.inverse() @ (CAMERA.rays() * raster.depth[..., None])[seen]
    triangles = mesh.vertices[mesh.faces[raster.face[seen]]] + mesh.centre
    offset = np.linalg.norm(points - triangles.mean(axis=1), axis=1)
    size = np.linalg.norm(triangles - triangles.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    assert (offset <= size * 1.05).mean() > 0.999


def test_meshes_far_from_their_origin_lose_no_precision(renderer: Renderer) -> None:
    mesh = trimesh.creation.box(BOX_EXTENTS)
    mesh.apply_translation([40.0, -25.0, 30.0])
    pose = BOX_POSE @ SE3(np.eye(3), -np.array([40.0, -25.0, 30.0]))
    maps = render_scene_maps(renderer, CAMERA, [PlacedMesh(9, mesh, pose)])
    expected = box_depth(CAMERA)
    seen = (maps.mask == 9) & np.isfinite(expected)
    assert np.count_nonzero(seen) > 1000
    assert np.abs(maps.depth[seen] - expected[seen]).max() < 5e-6


def test_windows_larger_than_a_tile(renderer: Renderer) -> None:
    wide = Camera(4300, 700, 4000.0, 4000.0, 2150.0, 350.0)
    plate = trimesh.creation.box((1.06, 0.04, 0.01))
    maps = render_scene_maps(
        renderer, wide, [PlacedMesh(1, plate, SE3(np.eye(3), np.array([0, 0, 1.0])))]
    )
    columns = np.flatnonzero(maps.mask.any(axis=0))
    assert len(columns) == columns[-1] - columns[0] + 1  # no seam
    assert len(columns) == pytest.approx(1.06 / 0.995 * 4000, abs=2)


def test_an_object_behind_or_through_the_camera(renderer: Renderer) -> None:
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    behind = PlacedMesh(1, box, SE3(np.eye(3), np.array([0, 0, -0.5])))
    around = PlacedMesh(2, box, SE3(np.eye(3), np.array([0, 0, 0.0])))
    maps = render_scene_maps(renderer, CAMERA, [behind, around])
    assert set(np.unique(maps.mask)) == {2}
    assert np.allclose(maps.depth, 0.1, atol=1e-4)  # the far wall, from inside


def test_distortion_is_exact_in_the_ray_caster() -> None:
    lens = Camera(640, 480, 600.0, 605.0, 322.3, 236.8, (-0.25, 0.08, 0.001, -0.002, 0.01))
    maps = render_scene_maps(RaycastRenderer(), lens, ball_and_box(), canvas=3)
    expected = box_depth(lens)
    seen = (maps.mask == 9) & np.isfinite(expected)
    assert np.count_nonzero((maps.mask == 9) ^ np.isfinite(expected)) <= 3
    assert np.abs(maps.depth[seen] - expected[seen]).max() < 5e-6


def test_pyrender_refuses_distortion() -> None:
    need_gl()
    lens = Camera(640, 480, 600.0, 605.0, 322.3, 236.8, (-0.25, 0.08, 0.0, 0.0))
    with pytest.raises(ToolkitError, match="pinhole"):
        render_scene_maps(get_renderer("pyrender"), lens, ball_and_box())


def test_prepared_meshes_are_cached_by_content() -> None:
    mesh = trimesh.creation.box((0.1, 0.1, 0.1))
    first = prepare_mesh(mesh)
    assert prepare_mesh(mesh.copy()) is first
    mesh.apply_scale(2.0)
    assert prepare_mesh(mesh) is not first
    assert prepare_mesh(mesh).diagonal == pytest.approx(2 * first.diagonal)


def test_threads_that_want_one_mesh_get_one() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=5)
    mesh.vertices *= 0.0371  # of no other test
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: prepare_mesh(mesh.copy()), range(16)))
    assert len({id(x) for x in found}) == 1


def test_meshes_without_faces_are_refused() -> None:
    with pytest.raises(ToolkitError, match="without faces"):
        RenderMesh.from_arrays(np.zeros((3, 3)), np.zeros((0, 3), int))
    with pytest.raises(ToolkitError, match="not finite"):
        RenderMesh.from_arrays(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))
    with pytest.raises(ToolkitError, match="does not exist"):
        RenderMesh.from_arrays(np.zeros((3, 3)), np.array([[0, 1, 3]]))
