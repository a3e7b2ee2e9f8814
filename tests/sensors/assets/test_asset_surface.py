"""Surfaces for rendering: round parts smooth, edges sharp, nothing moved."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from sensors.assets import Asset, canonical_frame
from sensors.assets.procedural.library import CATEGORIES, make
from sensors.assets.surface import render_surface
from sensors.assets.uv import wrapped_uv


def asset_of(mesh: trimesh.Trimesh) -> Asset:
    vertices, _ = canonical_frame(mesh.vertices, mesh.faces)
    shape = trimesh.Trimesh(vertices, mesh.faces, process=False)
    uv = wrapped_uv(vertices, np.asarray(mesh.faces))
    return Asset(id="shape", category="other", mesh=shape, corner_uv=uv)


def test_a_box_keeps_its_edges() -> None:
    surface = render_surface(asset_of(trimesh.creation.box((1, 2, 3))))
    corners = surface.vertices[surface.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(
        surface.normals[surface.faces], np.repeat(flat[:, None], 3, axis=1), atol=1e-9
    )


def test_a_ball_is_smooth_however_it_is_divided() -> None:
    ball = trimesh.creation.uv_sphere(count=(24, 40))
    surface = render_surface(asset_of(ball))
    truth = surface.vertices / np.linalg.norm(surface.vertices, axis=1, keepdims=True)
    error = np.degrees(np.arccos(np.clip((surface.normals * truth).sum(axis=1), -1, 1)))
    assert error.max() < 1.0
    # One normal at each place: only the texture's seam splits vertices.
    places = np.unique(surface.vertices.round(6), axis=0)
    normals = np.unique(np.hstack([surface.vertices, surface.normals]).round(3), axis=0)
    assert len(normals) <= 1.02 * len(places)


def test_a_cylinder_is_round_and_has_rims() -> None:
    rod = trimesh.creation.cylinder(1.0, 2.0, sections=32)
    surface = render_surface(asset_of(rod))
    along = np.abs(surface.normals[:, 2])
    assert set(along.round(6)) == {0.0, 1.0}
    side = along < 0.5
    radial = surface.vertices[side] * [1, 1, 0]
    radial /= np.linalg.norm(radial, axis=1, keepdims=True)
    np.testing.assert_allclose(surface.normals[side], radial, atol=1e-6)


@pytest.mark.parametrize("category", CATEGORIES)
def test_procedural_shapes_keep_their_geometry(category: str) -> None:
    asset = make(category, 1)
    surface = render_surface(asset)
    assert asset.face_colors is not None and surface.face_colors is not None
    assert surface.uv is not None and len(surface.uv) == len(surface.vertices)
    area = asset.mesh.area_faces
    np.testing.assert_array_equal(surface.source_vertex[surface.faces], asset.faces[area > 0])
    np.testing.assert_array_equal(surface.vertices, asset.vertices[surface.source_vertex])
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1, atol=1e-9)
    # Shading normals lean from the surface's by no more than the crease allows.
    corners = surface.vertices[surface.faces]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(cross, axis=1)
    sure = double / edge > 1e-5
    assert sure.mean() > 0.97
    lean = np.einsum(
        "fkd,fd->fk", surface.normals[surface.faces[sure]], cross[sure] / double[sure, None]
    )
    assert np.degrees(np.arccos(lean.min())) < 33


def test_bottles_shade_as_turned_bodies() -> None:
    """Normals of a turned body have no part round its axis."""
    asset = make("bottle", 0)
    surface = render_surface(asset)
    x, _, z = surface.vertices.T
    radius = np.hypot(x, z)
    out = radius > 0.02
    round_ = np.stack([z, 0 * x, -x], axis=1)[out] / radius[out, None]
    lean = np.degrees(np.arcsin(np.abs((surface.normals[out] * round_).sum(axis=1))))
    assert np.quantile(lean, 0.99) < 0.5
