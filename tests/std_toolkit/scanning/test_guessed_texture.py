"""Colours of what no photo shows: of the nearest seen place on the surface, and marked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

pytest.importorskip("manifold3d")

from std_toolkit.geometry import Camera
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.io.images import read_mask
from std_toolkit.scanning.model.bake import bake_texture, nearest_colors
from std_toolkit.scanning.model.write_model import guessed_name, write_model
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.photos.visibility import hull_depth
from tests.std_toolkit.scanning.ball import look_at

CAMERA = Camera(320, 240, 420, 420, 159.5, 119.5)
SIZE = np.array([0.08, 0.06, 0.05])
# By the axis of the normal and its sign.
SIDES = {(0, 1): (220, 30, 30), (0, -1): (30, 200, 30), (1, 1): (30, 30, 220),
         (1, -1): (210, 200, 20), (2, 1): (240, 240, 240), (2, -1): (250, 0, 250)}  # fmt: skip


def colors_of(normals: np.ndarray) -> np.ndarray:
    axis = np.abs(normals).argmax(axis=1)
    sign = np.sign(normals[np.arange(len(normals)), axis]).astype(int)
    return np.array([SIDES[int(a), int(s)] for a, s in zip(axis, sign, strict=True)])


def box_and_views() -> tuple[trimesh.Trimesh, list[View]]:
    """A box with sides of one colour each, and photos of all but its underside."""
    mesh = trimesh.creation.box(SIZE).subdivide().subdivide().subdivide().subdivide()
    mesh.apply_translation([0, 0, SIZE[2] / 2])
    caster = RayCaster(mesh.vertices, mesh.faces)
    views = []
    for n in range(10):
        angle, height = 2 * np.pi * n / 10, (0.12, 0.26)[n % 2]
        eye = np.array([0.22 * np.cos(angle), 0.22 * np.sin(angle), height])
        bare = View(f"{n}.png", np.zeros((240, 320, 3), np.uint8), CAMERA,
                    look_at(eye, np.array([0, 0, 0.02])))  # fmt: skip
        depth, normal = hull_depth(bare, caster, np.zeros(3), (0, 0, 320, 240))
        mask = depth > 0
        bare.image[mask] = colors_of((normal[mask] @ bare.T_world_cam.R.T).astype(float))
        views.append(bare.with_mask(mask))
    return mesh, views


@pytest.mark.slow
def test_the_underside_takes_the_colour_of_the_nearest_side_and_is_marked(tmp_path: Path) -> None:
    mesh, views = box_and_views()
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64)
    texture = bake_texture(vertices, faces, views, size=256)
    write_model(tmp_path, "box", vertices, faces, texture)

    middle, below = mesh.triangles_center, mesh.face_normals[:, 2] < -0.9
    centre = texture.uv.mean(axis=1)
    row, column = ((1 - centre[:, 1]) * 256).astype(int), (centre[:, 0] * 256).astype(int)
    guessed = read_mask(tmp_path / guessed_name("box"))[row, column] == 255
    inner = np.abs(middle[:, :2]) < SIZE[:2] / 2 - 0.006
    assert guessed[below & inner.all(axis=1)].all()
    assert not guessed[(mesh.face_normals[:, 2] > 0.9) & inner.all(axis=1)].any()
    # Nearest by way of the edges of the mesh: where one side is clearly the nearest.
    away = SIZE[:2] / 2 - np.abs(middle[:, :2])
    axis = away.argmin(axis=1)
    clear = below & (away.max(axis=1) - away.min(axis=1) > 0.015)
    side = np.zeros((len(middle), 3))
    side[np.arange(len(middle)), axis] = np.sign(middle[np.arange(len(middle)), axis])
    off = np.abs(texture.image[row, column].astype(int) - colors_of(side)).max(axis=1)
    assert clear.sum() > 100
    assert (off[clear] < 60).mean() > 0.95
    # Nothing has the print of the underside, and nothing that of the top.
    assert not (texture.image[row, column][below].min(axis=1) > 150).any()

    loaded = trimesh.load(tmp_path / "box.ply", process=False)
    flag = loaded.metadata["_ply_raw"]["vertex"]["data"]["guessed"].ravel()
    assert flag[loaded.vertices[:, 2] < 1e-6].mean() > 0.7
    assert not flag[loaded.vertices[:, 2] > SIZE[2] - 1e-6].any()


def test_the_way_to_the_nearest_colour_leads_along_the_surface() -> None:
    """A sheet folded to two layers 1 mm apart: colours do not pass from one to the other."""
    along = np.linspace(0, 0.2, 41)
    x = np.r_[along[:21], 0.2 - along[21:]]
    z = np.where(np.arange(41) <= 20, 0.0, 0.001)
    rows = np.stack([x, np.zeros(41), z], axis=1)
    vertices = np.concatenate([rows, rows + np.array([0, 0.02, 0])])
    n = np.arange(40)
    faces = np.concatenate([np.stack([n, n + 1, n + 41], axis=1),
                            np.stack([n + 1, n + 42, n + 41], axis=1)])  # fmt: skip
    face = np.arange(len(faces))
    share = np.full((len(faces), 3), 1 / 3)
    place = np.arange(len(faces)) % 40
    known = (place < 18) | (place >= 38)
    colors = np.where((place < 18)[:, None], [0, 0, 200.0], [0, 200.0, 0])
    found = nearest_colors(vertices, faces, face, share, colors, known)
    # The upper layer, from its free end to the fold: its own colour in its nearer half.
    assert np.allclose(found[(place >= 31) & ~known], [0, 200, 0])
    assert np.allclose(found[(place > 19) & (place < 26)], [0, 0, 200])


def test_a_part_without_any_colour_is_grey() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0]], float)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    found = nearest_colors(
        vertices, faces, np.array([0, 1]), np.full((2, 3), 1 / 3), np.full((2, 3), 200.0),
        np.array([True, False]),
    )  # fmt: skip
    assert np.allclose(found, [[200] * 3, [128] * 3])
