"""Feet of stemmed glasses, which outlines from above leave filled."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from std_toolkit.geometry import Camera
from std_toolkit.scanning.vessel.foot import with_foot
from std_toolkit.scanning.vessel.outline_rays import (
    OutlineRays,
    TurnedProfile,
    mask_outline,
    outline_rays,
    ray_gaps,
)
from std_toolkit.scanning.vessel.revolve import fit_revolution
from std_toolkit.scanning.vessel.revolved_surface import OutlineView
from tests.std_toolkit.scanning.vessels import (
    WHISKY,
    WINE,
    WINE_INSIDE,
    outlines,
    surface_of,
    turned,
)

CAMERA = Camera(fx=300.0, fy=300.0, cx=159.5, cy=119.5, width=320, height=240)
LOWEST = np.tan(np.deg2rad(20))


@pytest.fixture(scope="module")
def views() -> list[OutlineView]:
    glass = turned(WINE, WINE_INSIDE)
    return outlines(glass, CAMERA, np.array([0.003, 0.002, 0.095]), 0.36, 8)


@pytest.fixture(scope="module")
def rays(views: list[OutlineView]) -> OutlineRays:
    return outline_rays(views, [mask_outline(v.mask) for v in views])


def filled_glass() -> TurnedProfile:
    """The glass with a foot that fills what the lines of sight from 20 degrees leave."""
    true = surface_of(WINE)
    foot = true.radii[:12].max()
    hull = np.sqrt(np.maximum(foot**2 - (true.heights / LOWEST) ** 2, 0))
    radii = np.where(true.heights < 0.03, np.maximum(true.radii, hull), true.radii)
    return TurnedProfile(radii, true.height, np.zeros(4))


def off_mm(radii: NDArray[np.float64], heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest and mean difference from the true radii, above the edge of the foot."""
    true = surface_of(WINE)
    low = (heights > 0.002) & (heights < 0.02)
    apart = 1000 * np.abs(radii - np.interp(heights, true.heights, true.radii))[low]
    return np.array([apart.max(), apart.mean()])


def test_outlines_do_not_tell_a_filled_foot_from_a_thin_one(rays: OutlineRays) -> None:
    filled = filled_glass()
    thin, hidden = with_foot(rays, filled, 3.0)
    assert off_mm(filled.radii, filled.heights).max() > 12
    largest, mean = off_mm(thin.radii, thin.heights)
    assert largest < 4 and mean < 1.5
    gaps = [np.abs(ray_gaps(rays, s).distance * rays.px_per_m).mean() for s in (filled, thin)]
    assert gaps[1] < gaps[0] + 0.05
    assert hidden.any()
    # Nothing but the foot changes, and nothing is added.
    assert (thin.radii <= filled.radii + 1e-12).all()
    high = thin.heights > 0.02
    assert np.array_equal(thin.radii[high], filled.radii[high])


@pytest.mark.slow
def test_foot_of_a_fitted_glass(views: list[OutlineView]) -> None:
    found = fit_revolution(views)
    largest, mean = off_mm(found.radii, found.heights)
    assert largest < 5 and mean < 2
    assert 2 * found.radii[found.heights < 0.01].max() == pytest.approx(0.067, abs=0.0015)
    assert any("interpolated" in line for line in found.warnings)


def test_without_a_stem_nothing_changes(rays: OutlineRays) -> None:
    plain = surface_of(WHISKY)
    state = TurnedProfile(plain.radii, plain.height, np.zeros(4))
    same, hidden = with_foot(rays, state, 3.0)
    assert same is state
    assert not hidden.any()


def test_a_foot_that_outlines_show_stays() -> None:
    """A bell under a stem is steeper than the lines of sight: a thin foot does not explain it."""
    bell = [(36, 0), (34, 20), (28, 30), (5, 40), (4, 60), (4, 90), (30, 110), (34, 150)]
    inner = [(33, 150), (28, 112), (0, 105)]
    views = outlines(turned([(0, 0), *bell], inner), CAMERA, np.array([0, 0, 0.075]), 0.36, 4)
    rays = outline_rays(views, [mask_outline(v.mask) for v in views])
    true = surface_of([(0, 0), *bell])
    found, _ = with_foot(rays, TurnedProfile(true.radii, true.height, np.zeros(4)), 3.0)
    assert 1000 * np.abs(found.radii - true.radii).max() < 2.5
