"""The table behind and beside an object, from photos of a plain table."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

pytest.importorskip("manifold3d")

from std_toolkit.geometry import Camera
from std_toolkit.scanning.masks.masks import dilated
from std_toolkit.scanning.masks.table_comparison import compare
from std_toolkit.scanning.masks.table_model import _agreed, _gain, model_table
from std_toolkit.scanning.photos.views import View
from tests.std_toolkit.scanning.ball import look_at

CAMERA = Camera(160, 120, 150, 150, 79.5, 59.5)
TABLE, BOX = np.array([200.0, 195, 190]), np.array([90.0, 20, 20])
CORNERS = np.array([[0.09, 0.09, 0.0], [-0.09, -0.09, 0.0]])
HALF, HIGH = np.array([0.05, 0.015]), 0.1


def photos_of_a_box(count: int = 12, *, panel: bool = False) -> list[View]:
    """A dark box, wide one way, on a bright table; with a panel of the colour of the table."""
    low, high = np.array([*-HALF, 0.0]), np.array([*HALF, HIGH])
    views = []
    for n in range(count):
        a = 2 * np.pi * n / count
        eye = np.array([0.35 * np.cos(a), 0.35 * np.sin(a), 0.2])
        T = look_at(eye, np.array([0, 0, 0.04]))
        rays = CAMERA.rays() @ T.R.T
        with np.errstate(divide="ignore"):
            ends = np.stack([(low - eye) / rays, (high - eye) / rays])
        near, far = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
        box = (near < far) & (far > 0)
        look = np.broadcast_to(BOX, rays.shape)
        if panel:
            at = eye + near[..., None] * rays
            white = (np.abs(at[..., 0]) < 0.008) & (np.abs(at[..., 2] - 0.05) < 0.008)
            look = np.where(white[..., None], TABLE + 2, look)
        image = np.where(box[..., None], look, np.where(rays[..., 2:] < 0, TABLE, 40.0))
        views.append(View(f"{n}.png", image.astype(np.uint8), CAMERA, T, box))
    return views


@pytest.mark.slow
def test_cells_that_no_photo_shows_are_unknown_and_raise_no_warning() -> None:
    views = photos_of_a_box(8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = model_table(views, np.array([-0.9, -0.9]), np.array([0.9, 0.9]), CORNERS)
    assert not table.seen.all()
    assert not (table.known & ~table.seen).any()


@pytest.mark.slow
def test_the_table_is_known_up_to_the_foot_of_the_object() -> None:
    views = photos_of_a_box()
    table = model_table(views, np.array([-0.2, -0.2]), np.array([0.2, 0.2]), CORNERS)
    foot = np.round((np.array([0.0, HALF[1] + 0.008]) - table.low) / table.cell).astype(int)
    assert table.known[foot[1], foot[0]]
    assert np.allclose(table.color[foot[1], foot[0]], TABLE, atol=10)
    for i, view in enumerate(views):
        found = compare(view, [table], i)
        assert view.mask is not None
        assert not (found.clear & view.mask).any()
        assert (found.clear[~view.mask & found.known]).mean() > 0.95


@pytest.mark.slow
def test_where_the_first_table_ends_the_second_is_compared() -> None:
    views = photos_of_a_box()
    near = model_table(views, np.array([-0.1, -0.1]), np.array([0.1, 0.1]), CORNERS)
    far = model_table(views, np.array([-0.4, -0.4]), np.array([0.4, 0.4]), CORNERS)
    alone, both = compare(views[0], [near], 0), compare(views[0], [near, far], 0)
    assert both.known.sum() > 1.5 * alone.known.sum()
    assert both.clear.sum() > 1.5 * alone.clear.sum()
    assert both.different.sum() > alone.different.sum()


def test_the_table_is_what_photos_agree_on_though_most_show_an_object() -> None:
    rng = np.random.default_rng(0)
    table = 200 + rng.normal(0, 1, (9, 3))
    shades = np.linspace(120, 190, 15)[:, None] * np.ones(3)
    samples = np.rint(np.concatenate([table, shades]))[:, None].astype(np.uint8)
    seen, gains = np.ones((24, 1), bool), np.ones((24, 3), np.float32)
    color, spread = _agreed(samples, seen, gains)
    assert np.allclose(color[0], 200, atol=2)
    assert spread[0] < 5
    nothing = _agreed(samples, ~seen, gains)
    assert nothing[1][0] == 255
    assert np.isfinite(nothing[0]).all()


def test_the_exposure_is_that_of_the_table_though_an_object_hides_most_of_it() -> None:
    rng = np.random.default_rng(0)
    table = np.array([1.1, 1.0, 0.9]) + rng.normal(0, 0.01, (400, 3))
    hidden = rng.uniform(0.05, 0.8, (600, 1)) * np.ones(3)
    assert np.allclose(_gain(np.concatenate([table, hidden])), [1.1, 1.0, 0.9], atol=0.01)


def test_the_exposure_is_the_median_where_no_other_suits_clearly_more_cells() -> None:
    rng = np.random.default_rng(0)
    # A shadow's even grey agrees best, but most of the board is in the light.
    light = 1.0 + rng.normal(0, 0.02, (600, 1)) * np.ones(3)
    shadow = 0.8 + rng.normal(0, 0.001, (400, 1)) * np.ones(3)
    assert np.allclose(_gain(np.concatenate([light, shadow])), 1.0, atol=0.03)


@pytest.mark.slow
def test_the_table_is_known_where_too_large_an_outline_blocks_it() -> None:
    views = photos_of_a_box()
    too_large = [dilated(v.shown, 8) for v in views]
    low, high = np.array([-0.2, -0.2]), np.array([0.2, 0.2])
    table = model_table(views, low, high, CORNERS, too_large)
    # No photo shows these cells beside the outline.
    beside = np.round((np.array([0.0, HALF[1] + 0.01]) - low) / table.cell).astype(int)
    assert not table.seen[beside[1], beside[0]]
    assert table.known[beside[1], beside[0]]
    assert not table.known[table.known.shape[0] // 2, table.known.shape[1] // 2]
    for i, view in enumerate(views):
        assert view.mask is not None
        assert not (compare(view, [table], i).clear & view.mask).any()


def test_a_cell_of_two_colours_is_in_doubt() -> None:
    samples = np.repeat(np.array([[200, 198, 190], [90, 20, 20]], np.uint8), [14, 10], axis=0)
    seen, gains = np.ones((24, 1), bool), np.ones((24, 3), np.float32)
    assert _agreed(samples[:, None], seen, gains)[1][0] == 255
    seen[14:18] = seen[20:] = False
    color, spread = _agreed(samples[:, None], seen, gains)
    assert np.allclose(color[0], [200, 198, 190])
    assert spread[0] < 1


@pytest.mark.slow
def test_texture_of_the_table_is_clear_only_where_the_photo_shows_it() -> None:
    views = photos_of_a_box()
    table = model_table(views, np.array([-0.2, -0.2]), np.array([0.2, 0.2]), CORNERS)
    row = table.color.shape[0] // 2 - 60
    table.color[row - 20 : row + 20 : 4] = 20
    table.known[row - 20 : row + 20] = True
    view = views[0]
    found = compare(view, [table], 0)
    cells = np.array([table.low[0] + 0.1, table.low[1] + row * table.cell, 0.0])
    uv, _ = view.project(cells[None])
    x, y = np.rint(uv[0]).astype(int)
    assert found.known[y, x]
    assert not found.clear[y, x]


@pytest.mark.slow
def test_squares_of_texture_larger_than_pixels_are_clear() -> None:
    """In a sharp photo a square of a tag is many pixels wide, and alike within."""
    camera = Camera(120, 90, 900, 900, 59.5, 44.5)
    views = []
    for n in range(8):
        a = 2 * np.pi * n / 8
        eye = np.array([0.25 * np.cos(a), 0.25 * np.sin(a), 0.3])
        T = look_at(eye, np.zeros(3))
        rays = camera.rays() @ T.R.T
        at = eye - eye[2] / rays[..., 2:] * rays
        dark = (np.floor(at[..., :2] / 0.006).sum(axis=-1) % 2 == 0) & (np.abs(at[..., 0]) < 0.012)
        image = np.where(dark[..., None], 30, TABLE).astype(np.uint8)
        views.append(View(f"{n}.png", image, camera, T, dark))
    table = model_table(views, np.array([-0.03, -0.03]), np.array([0.03, 0.03]), CORNERS / 4)
    for i, view in enumerate(views):
        found = compare(view, [table], i)
        assert view.mask is not None
        assert found.clear[view.mask & found.known].mean() > 0.8
