"""Hull, closed surface and files of a ball of known size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

pytest.importorskip("manifold3d")

from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.masks.hull import hull_field, surface_of
from std_toolkit.scanning.masks.masks import volume_of_masks
from std_toolkit.scanning.model.bake import Texture
from std_toolkit.scanning.model.write_model import write_model
from std_toolkit.scanning.photos.views import Grid
from std_toolkit.scanning.photos.visibility import hull_depth
from std_toolkit.scanning.surface.depth_maps import DepthMap
from std_toolkit.scanning.surface.measured_surface import _hulls
from std_toolkit.scanning.surface.surface import agreeing, fuse, is_closed
from tests.std_toolkit.scanning.ball import CENTRE, RADIUS, ball_views

pytestmark = pytest.mark.slow


def test_the_hull_of_many_outlines_is_the_ball() -> None:
    views = ball_views(24)
    low, high = volume_of_masks(views)
    assert (low < CENTRE - RADIUS).all() and (high > CENTRE + RADIUS).all()
    field = hull_field(views, Grid.around(low, high, 0.002))
    vertices, faces = surface_of(field, Grid.around(low, high, 0.002))
    distance = np.linalg.norm(vertices - CENTRE, axis=1) - RADIUS
    assert is_closed(vertices, faces)
    assert abs(np.median(distance)) < 0.0006
    # Cameras above do not see the lowest part: the hull may only be too large.
    assert distance.min() > -0.0008


def test_one_bad_mask_cuts_the_hull_unless_it_may_be_contradicted() -> None:
    views = ball_views(16)
    views[3] = views[3].with_mask(np.zeros_like(views[3].shown))
    grid = Grid.around(CENTRE - 0.05, CENTRE + 0.05, 0.004)
    assert not (hull_field(views, grid) < 0).any()
    inside = hull_field(views, grid, allowed=1) < 0
    assert inside.sum() * grid.step**3 == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.15)


def test_depth_maps_outvote_the_masks_of_few_photos() -> None:
    """Three masks lack what is right of the middle; depth maps of all photos show it."""
    views = ball_views(24)
    for n in (2, 3, 4):
        cut = views[n].shown.copy()
        cut[:, 88:] = False
        views[n] = views[n].with_mask(cut)
    grid = Grid.around(CENTRE - RADIUS, CENTRE + RADIUS, 0.002)
    hull, disputed = hull_field(views, grid), hull_field(views, grid, allowed=3)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    caster = RayCaster(ball.vertices, ball.faces, threads=1)
    maps: list[DepthMap | None] = []
    for view in views:
        depth, normal = hull_depth(view, caster, CENTRE, (0, 0, *view.camera.size))
        maps.append(DepthMap(0, 0, depth, normal, np.zeros_like(depth), np.full_like(depth, 20)))
    seen = agreeing(views, [maps], CENTRE)
    unseen = [np.zeros_like(w) for w in seen]

    def lacking(weights: list[np.ndarray], larger: np.ndarray) -> float:
        """Largest distance from points of the ball to the fused surface."""
        fused = fuse(views, maps, weights, hull, larger, grid)
        side = np.abs(ball.vertices[:, 2]) < 0.5 * RADIUS
        return float(
            RayCaster(*surface_of(fused.field, grid)).distance(CENTRE + ball.vertices[side]).max()
        )

    assert lacking(seen, disputed) < 0.002
    assert lacking(seen, hull) > 0.005
    # Without depth, the outlines hold.
    assert lacking(unseen, disputed) > 0.005


@pytest.mark.parametrize(("photos", "filled"), [(16, False), (48, True)])
def test_only_many_photos_are_contradicted(photos: int, filled: bool) -> None:
    """One mask lacks a half of the ball: of few photos each carves what no other does."""
    views = ball_views(photos)
    cut = views[3].shown.copy()
    cut[:, 80:] = False
    views = [*views[:3], views[3].with_mask(cut), *views[4:]]
    if photos > 40:
        views = [v.with_mask(cut) if n in (5, 7) else v for n, v in enumerate(views)]
    grid = Grid.around(CENTRE - RADIUS, CENTRE + RADIUS, 0.004)
    hull, disputed = _hulls(views, grid, [], 1)
    ball = 4 / 3 * np.pi * RADIUS**3 / grid.step**3
    assert (hull < 0).sum() < 0.8 * ball
    assert ((disputed < 0).sum() > 0.95 * ball) == filled
    assert (disputed <= hull).all()


def test_the_files_hold_the_same_mesh_and_texture(tmp_path: Path) -> None:
    vertices = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype=np.float64)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    uv = np.zeros((4, 3, 2))
    for f in range(4):
        x, y = 0.5 * (f % 2), 0.5 * (f // 2)
        uv[f] = [[x + 0.05, y + 0.05], [x + 0.45, y + 0.05], [x + 0.05, y + 0.45]]
    image = np.zeros((64, 64, 3), np.uint8)
    image[:32, :32], image[:32, 32:], image[32:, :32] = (250, 0, 0), (0, 250, 0), (0, 0, 250)
    guessed = np.zeros((64, 64), bool)
    texture = Texture(uv, image, guessed, np.ones(4, np.int64), np.ones((1, 3)))
    paths = write_model(tmp_path, "tetra", vertices, faces, texture)
    for suffix in ("obj", "glb", "ply"):
        mesh = load_mesh(paths[suffix])
        assert len(mesh.faces) == 4
        assert mesh.area == pytest.approx(0.5 * 0.01 * (3 + np.sqrt(3)))
    assert load_mesh(paths["ply"]).is_watertight
    from std_toolkit.rendering.texture import SurfaceColors

    colors = SurfaceColors.from_mesh(load_mesh(paths["obj"]))
    assert colors is not None
    middle = colors.at(np.arange(4), np.full((4, 2), 0.2))
    # v = 0 is the bottom of the image.
    assert middle.argmax(axis=1).tolist()[0] == 2
    assert middle[2].argmax() == 0 and middle[3].argmax() == 1
