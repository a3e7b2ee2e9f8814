"""Holes of meshes are closed where cameras do not see it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from sensors.assets.mesh_closing import close_mesh
from std_toolkit.geometry.surface_colors import SurfaceColors

DOWN = (np.array([0.0, 0.0, -1.0]),)


def open_box() -> trimesh.Trimesh:
    """A box of 0.1 x 0.2 x 0.3 without its bottom; no vertex is shared by two faces."""
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.update_faces(box.face_normals[:, 2] > -0.5)
    box.unmerge_vertices()
    return box


def volume(mesh: trimesh.Trimesh) -> float:
    welded = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert welded.is_watertight and welded.is_winding_consistent
    return float(welded.volume)


def test_a_bottom_is_closed() -> None:
    found = close_mesh(open_box(), DOWN)
    assert (found.caps, found.problem) == (1, "")
    assert volume(found.mesh) == pytest.approx(0.1 * 0.2 * 0.3)


def test_faces_that_look_inside_are_turned() -> None:
    box = open_box()
    box.faces = box.faces[:, ::-1]
    assert volume(close_mesh(box, DOWN).mesh) == pytest.approx(0.006)
    mixed = open_box()
    mixed.faces[::2] = mixed.faces[::2, ::-1]
    assert volume(close_mesh(mixed, DOWN).mesh) == pytest.approx(0.006)


def test_an_opening_in_view_stays_and_is_told() -> None:
    box = open_box()
    found = close_mesh(box, (np.array([0.0, 0.0, 1.0]),))
    assert found.mesh is box and found.caps == 0
    # 0.1 x 0.2 of the five sides.
    assert found.problem == "an opening of 10 % of its surface is in view"
    # One of two objects of the mesh stands the other way.
    assert close_mesh(box, (DOWN[0], -DOWN[0])).problem


def test_a_pinhole_is_closed_anywhere() -> None:
    ball = trimesh.creation.icosphere(3, 0.05)
    whole = ball.volume
    ball.update_faces(np.arange(len(ball.faces)) != 7)
    found = close_mesh(ball)
    assert found.caps == 1 and volume(found.mesh) == pytest.approx(whole, rel=1e-6)


def test_two_holes_that_share_a_corner_are_closed() -> None:
    ball = trimesh.creation.icosphere(3, 0.05)
    at = np.flatnonzero((ball.faces == ball.faces[0, 0]).any(axis=1))
    other = next(f for f in at if len(set(ball.faces[f]) & set(ball.faces[0])) == 1)
    ball.update_faces(~np.isin(np.arange(len(ball.faces)), [0, other]))
    found = close_mesh(ball)
    assert found.caps == 2 and volume(found.mesh) > 0


def test_a_closed_mesh_is_returned_as_it_is() -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    found = close_mesh(box)
    assert found.mesh is box and not found.caps and not found.problem


def test_three_faces_at_an_edge_are_told() -> None:
    fin = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, 3], [0, 1, 4]]
    )
    assert close_mesh(fin).problem == "its faces do not agree on an outside"


@pytest.mark.parametrize("kind", ["vertex", "face", "texture"])
def test_colours_stay(kind: str) -> None:
    box = open_box()
    rng = np.random.default_rng(0)
    if kind == "vertex":
        box.visual.vertex_colors = rng.integers(0, 255, (len(box.vertices), 4), dtype=np.uint8)
    elif kind == "face":
        box.visual.face_colors = rng.integers(0, 255, (len(box.faces), 4), dtype=np.uint8)
    else:
        from PIL import Image

        image = Image.fromarray(rng.integers(0, 255, (16, 16, 3), dtype=np.uint8))
        material = trimesh.visual.material.SimpleMaterial(image=image)
        uv = rng.random((len(box.vertices), 2))
        box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    before, after = (SurfaceColors.from_mesh(m) for m in (box, close_mesh(box, DOWN).mesh))
    assert before is not None and after is not None
    np.testing.assert_array_equal(after.corners[: len(before.corners)], before.corners)
    if before.texture is not None:
        np.testing.assert_array_equal(after.texture, before.texture)
