"""Tops without depth: level where outlines allow it, left where they show a knob."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

pytest.importorskip("manifold3d")

from std_toolkit.geometry import SE3
from std_toolkit.scanning.masks.hull import hull_field
from std_toolkit.scanning.photos.views import Grid, View
from std_toolkit.scanning.surface.plain_tops import levelled
from tests.std_toolkit.scanning.test_turned_over import photos, plain

TOP, RADIUS, STEP = 0.04, 0.03, 0.001
GRID = Grid.around(np.array([-0.032, -0.032, 0.0]), np.array([0.032, 0.032, 0.07]), STEP)


def can(*, knob: bool) -> trimesh.Trimesh:
    body = trimesh.creation.cylinder(RADIUS, TOP).apply_translation([0, 0, TOP / 2])
    if not knob:
        return body
    post = trimesh.creation.cylinder(0.008, 0.03).apply_translation([0, 0, TOP + 0.01])
    return trimesh.boolean.union([body, post], engine="manifold")


def places() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Height and distance from the axis of each voxel, metres."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in GRID.shape), indexing="ij"), axis=-1)
    at = GRID.points(index.reshape(-1, 3)).reshape(*GRID.shape, 3)
    return at[..., 2], np.hypot(at[..., 0], at[..., 1])


def measured(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float32], NDArray[np.float32], list[View]]:
    """Hull cut to the true top where depth is known, which is near the rim."""
    views = photos(mesh, SE3.identity(), plain)
    hull = hull_field(views, GRID)
    z, r = places()
    known = r > 0.6 * RADIUS
    field = np.where(known, np.maximum(hull, z - TOP), hull).astype(np.float32)
    return field, np.where(known, 20, 0.3).astype(np.float32), views


def test_a_plain_lid_is_spanned_between_what_is_measured() -> None:
    field, support, views = measured(can(knob=False))
    z, r = places()
    over = (r < 0.5 * RADIUS) & (z > TOP + STEP)
    assert (field[over] < 0).sum() > 2000
    found = levelled(field, support, GRID, views)
    assert (found[over] > 0).all()
    assert (found[(r < 0.5 * RADIUS) & (z < TOP - STEP) & (z > STEP)] < 0).all()
    assert (found >= field).all()


def test_a_knob_that_outlines_show_stays() -> None:
    field, support, views = measured(can(knob=True))
    assert np.array_equal(levelled(field, support, GRID, views), field)


def test_what_is_measured_within_a_plain_lid_stays() -> None:
    field, support, views = measured(can(knob=False))
    z, r = places()
    logo = r < 0.008
    field = np.where(logo, np.maximum(field, z - TOP - 0.003), field).astype(np.float32)
    found = levelled(field, np.where(logo, np.float32(20), support), GRID, views)
    assert (found[(r < 0.003) & (z > STEP) & (z < TOP + 0.002)] < 0).all()
    assert (found[(np.abs(r - 0.015) < 0.002) & (z > TOP + 0.004)] > 0).all()


def test_a_top_that_nothing_measured_surrounds_stays() -> None:
    field, support, views = measured(can(knob=False))
    assert np.array_equal(levelled(field, 0 * support, GRID, views), field)
