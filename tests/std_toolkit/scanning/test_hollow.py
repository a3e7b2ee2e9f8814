"""The hollow of an open vessel from the thickness of its wall."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.options import KnownCameras
from std_toolkit.scanning.options import ScanOptions
from std_toolkit.scanning.photos.views import Grid, View
from std_toolkit.scanning.surface.hollow import hollowed
from tests.std_toolkit.scanning.ball import ball_views, look_at

STEP, WALL, RIM = 0.0008, 0.003, 0.07
GRID = Grid((-0.075, -0.05, 0.0), STEP, (130, 125, 188))


def views(slope_deg: float = 25.0) -> list[View]:
    """Cameras that look down at a vessel; their pictures do not count."""
    flat = []
    for view in ball_views(16):
        a = np.arctan2(view.T_world_cam.t[1], view.T_world_cam.t[0])
        away = np.array([np.cos(a), np.sin(a), np.tan(np.deg2rad(slope_deg))])
        target = np.array([0, 0, RIM / 2])
        flat.append(replace(view, T_world_cam=look_at(target + 0.4 * away, target)))
    return flat


def places() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    z, y, x = (np.arange(n) * STEP for n in GRID.shape)
    return np.meshgrid(z, y - 0.05, x - 0.075, indexing="ij")


def outer_radius(z: np.ndarray) -> np.ndarray:
    return 0.028 + 0.15 * z


def hull_of_a_cup(*, handle: bool) -> np.ndarray:
    """Field of a flaring cup that outlines fill, with the cone that they leave above its rim."""
    z, y, x = places()
    r = np.hypot(x, y)
    cone = RIM + (outer_radius(np.array(RIM)) - r) * np.tan(np.deg2rad(25))
    field = np.maximum(r - outer_radius(z), z - cone)
    if handle:
        across = np.hypot(np.hypot(x - 0.04, z - 0.04) - 0.015, y)
        field = np.minimum(field, across - 0.006)
    return field.astype(np.float32)


@pytest.mark.parametrize("handle", [False, True])
def test_a_cup_is_open_down_to_its_base(handle: bool) -> None:
    hull = hull_of_a_cup(handle=handle)
    found, share = hollowed(hull, hull, GRID, views(), WALL)
    z, y, x = places()
    r = np.hypot(x, y)
    # The wall is as thick across as it is said to be.
    inner = outer_radius(z) - WALL * np.sqrt(1 + 0.15**2)
    cavity = (r < inner - 1.5 * STEP) & (z > WALL + 1.5 * STEP)
    assert (found[cavity] > 0).all()
    wall = (hull < -STEP) & ((r > inner + 1.5 * STEP) | (z < WALL - 1.5 * STEP)) & (z < RIM - WALL)
    assert (found[wall] < 0).all()
    assert share == pytest.approx(1 - (found < 0).sum() / (hull < 0).sum())


def test_what_photos_opened_further_stays_open() -> None:
    hull = hull_of_a_cup(handle=False)
    z, y, x = places()
    measured = np.maximum(hull, np.where((np.hypot(x, y) < 0.02) & (z > 0.001), STEP, -1))
    found, _ = hollowed(measured.astype(np.float32), hull, GRID, views(), WALL)
    assert (found >= measured - 1e-6).all()


def test_the_narrow_neck_of_a_bottle_is_opened_straight_down_alone() -> None:
    z, y, x = places()
    r = np.hypot(x, y)
    radius = np.interp(z, [0, 0.04, 0.055, RIM + 0.02], [0.035, 0.035, 0.014, 0.014])
    cone = RIM + (0.014 - r) * np.tan(np.deg2rad(25))
    hull = np.maximum(r - radius, z - cone).astype(np.float32)
    found, _ = hollowed(hull, hull, GRID, views(), WALL)
    below = (z > 0.006) & (z < RIM)
    assert (found[below & (r < 0.014 - WALL - 2 * STEP)] > 0).all()
    assert (found[below & (r > 0.014) & (hull < -STEP)] < 0).all()


def test_without_a_flat_top_nothing_is_opened() -> None:
    z, y, x = places()
    # A cone far steeper than the photos look.
    hull = (np.hypot(x, y) - 0.5 * (RIM - z)).astype(np.float32)
    found, share = hollowed(hull, hull, GRID, views(), WALL)
    assert share == 0
    np.testing.assert_array_equal(found, hull)


def test_a_wall_needs_an_upright_world(tmp_path: Path) -> None:
    known = KnownCameras(cameras=tmp_path / "cameras.json")
    with pytest.raises(ToolkitError, match=r"--wall-mm.*tells what is upright"):
        ScanOptions(photos=tmp_path, out=tmp_path / "out", wall_mm=3.0, known=known)
