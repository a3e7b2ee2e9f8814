"""A film of shadow around the foot of an object is cut; flanges and flat objects are not."""

from __future__ import annotations

import numpy as np

from std_toolkit.scanning.photos.views import Grid
from std_toolkit.scanning.surface.skirt import without_skirt

GRID = Grid.around(np.array([-0.05, -0.05, 0.0]), np.array([0.05, 0.05, 0.05]), 0.001)


def block(half: float, height: float) -> np.ndarray:
    """Signed distance to an upright block on the table, about."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in GRID.shape), indexing="ij"), axis=-1)
    x, y, z = np.moveaxis(GRID.points(index.reshape(-1, 3)).reshape(*GRID.shape, 3), -1, 0)
    sides = np.maximum(np.abs(x), np.abs(y)) - half
    return np.maximum(sides, np.maximum(z - height, -z)).astype(np.float32)


def base(field: np.ndarray) -> float:
    """Half of the side of what is inside at the table, metres."""
    inside = (field < 0).any(axis=0)
    return 0.5 * GRID.step * float(np.sqrt(inside.sum()))


BOX = block(0.025, 0.04)
SKIRT = block(0.036, 0.0022)
NOTHING = np.zeros(GRID.shape, np.float32)


def test_a_film_around_a_box_is_cut_and_the_box_stays() -> None:
    field, share = without_skirt(np.minimum(BOX, SKIRT), NOTHING, GRID)
    assert share > 0.3
    assert abs(base(field) - 0.025) < 0.0011
    upper = GRID.origin[2] + np.arange(GRID.shape[0]) * GRID.step > 0.005
    assert np.array_equal(field[upper] < 0, BOX[upper] < 0)


def test_a_box_without_a_film_stays_as_it_is() -> None:
    field, share = without_skirt(BOX, NOTHING, GRID)
    assert share == 0 and field is BOX


def test_a_flange_that_depth_maps_measure_is_kept() -> None:
    both = np.minimum(BOX, SKIRT)
    support = np.where(np.abs(SKIRT) < 0.002, np.float32(9), np.float32(0))
    assert without_skirt(both, support, GRID)[1] == 0


def test_a_thicker_flange_is_kept() -> None:
    both = np.minimum(BOX, block(0.036, 0.006))
    assert without_skirt(both, NOTHING, GRID)[1] == 0


def test_a_flat_object_is_kept() -> None:
    assert without_skirt(block(0.04, 0.002), NOTHING, GRID)[1] == 0
    knob = np.minimum(block(0.04, 0.002), block(0.005, 0.02))
    assert without_skirt(knob, NOTHING, GRID)[1] == 0
