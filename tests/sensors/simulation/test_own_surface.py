"""Colours of an asset reach the renderer as a texture."""

from __future__ import annotations

import numpy as np
import pytest

from sensors.assets import open_source
from sensors.assets.asset import Asset
from sensors.simulation.world_builder import own_surface


@pytest.fixture(scope="module")
def can() -> Asset:
    return open_source("procedural").sample(np.random.default_rng(3), "can")


def test_faces_keep_their_places_and_colours(can: Asset) -> None:
    mesh, texture = own_surface(can, 0.15)
    assert can.face_colors is not None and texture is not None and mesh.uv is not None
    np.testing.assert_allclose(mesh.vertices[mesh.faces], 0.15 * can.vertices[can.faces])
    uv = mesh.uv[mesh.faces].mean(axis=1)
    column = np.floor(uv[:, 0] * texture.shape[1]).astype(int)
    np.testing.assert_array_equal(texture[texture.shape[0] // 2, column], can.face_colors)
    size = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    assert size == pytest.approx(0.15, rel=1e-4)


def test_a_picture_is_taken_as_it_is(can: Asset) -> None:
    picture = np.zeros((8, 8, 3), np.uint8)
    pictured = Asset("pictured", "can", can.mesh, corner_uv=can.corner_uv, texture=picture)
    mesh, texture = own_surface(pictured, 0.2)
    assert texture is picture and mesh.uv is not None and can.corner_uv is not None
    np.testing.assert_allclose(mesh.uv[mesh.faces], can.corner_uv)


def test_without_colours_there_is_no_texture(can: Asset) -> None:
    mesh, texture = own_surface(Asset("plain", "can", can.mesh), 0.2)
    assert texture is None and mesh.uv is None
    np.testing.assert_array_equal(mesh.faces, can.faces)
