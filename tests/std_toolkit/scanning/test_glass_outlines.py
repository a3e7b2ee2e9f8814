"""Clear vessels from differences along their outlines alone, without masks."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.vessel.glass_outlines import fit_vessel
from std_toolkit.scanning.vessel.glass_profile import outline_evidence

CAMERA = Camera(fx=280, fy=280, cx=159.5, cy=119.5, width=320, height=240)
BOARD = np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]], float)
TOP, MIDDLE = 0.09, np.array([0.006, -0.004, 0.0])


def radius(height: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.027 + 0.1 * height


@pytest.fixture(scope="module")
def photos() -> tuple[list[View], list[NDArray[np.float32]]]:
    """Photos of a tumbler of which a line along the outline shows, here and there broken."""
    height = np.linspace(0, TOP, 30)
    line = np.stack([radius(height), height], axis=1)
    solid = trimesh.creation.revolve(np.vstack([[0, 0], line, [0, TOP]]), sections=96)
    caster = RayCaster(np.asarray(solid.vertices) + MIDDLE, np.asarray(solid.faces))
    rng = np.random.default_rng(0)
    views, evidence = [], []
    for i in range(12):
        azimuth, elevation = 2 * np.pi * i / 6, np.deg2rad(24 if i < 6 else 48)
        away = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                         np.sin(elevation)])  # fmt: skip
        z = -away
        x = np.cross(z, [0, 0, 1])
        x /= np.linalg.norm(x)
        pose = SE3(np.stack([x, np.cross(z, x), z], axis=1), 0.35 * away + [0, 0, 0.04])
        row, column = np.mgrid[:240, :320]
        rays = CAMERA.unproject(np.stack([column, row], axis=-1).astype(float)) @ pose.R.T
        start = np.broadcast_to(pose.t, rays.shape)
        mask = np.isfinite(caster.cast(np.concatenate([start, rays], axis=-1)).distance)
        shown = mask & ~(cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0)
        broken = cv2.GaussianBlur(rng.normal(size=mask.shape), (0, 0), 6) > 0.03
        value = 1.5 * (shown & ~broken) + rng.uniform(0, 0.1, mask.shape)
        views.append(View(f"{i}.jpg", np.full((240, 320, 3), 128, np.uint8), CAMERA, pose))
        evidence.append(value.astype(np.float32))
    return views, evidence


@pytest.mark.slow
def test_vessel_is_found_from_lines_along_its_outline(
    photos: tuple[list[View], list[NDArray[np.float32]]],
) -> None:
    found, views = fit_vessel(*photos, BOARD)
    assert np.abs(found.T_world_axis.t - MIDDLE).max() < 0.001
    assert found.heights[-1] == pytest.approx(TOP, abs=0.003)
    inner = (found.heights > 0.005) & (found.heights < TOP - 0.005)
    off = found.radii[inner] - radius(found.heights[inner])
    assert np.median(np.abs(off)) < 0.0007
    assert all(v.shown.any() for v in views)


def test_a_bare_table_shows_no_vessel(
    photos: tuple[list[View], list[NDArray[np.float32]]],
) -> None:
    views, evidence = photos
    noise = [np.where(e > 1, 0.05, e).astype(np.float32) for e in evidence]
    with pytest.raises(ToolkitError, match="outline of an upright vessel") as caught:
        fit_vessel(views, noise, BOARD)
    assert "--masks" in str(caught.value.hint)


def test_shine_of_the_table_is_no_evidence() -> None:
    off = np.full((240, 320), 0.8, np.float32)
    off[100:140, 150:153] = 1.9
    off[:20] = np.nan
    (value,) = outline_evidence([off])
    assert np.isnan(value[:20]).all()
    assert value[120, 151] == pytest.approx(1.1, abs=0.05)
    assert np.nanmax(value[60:, :140]) < 0.05
