"""Surfaces of revolution from outlines: a tumbler with exact and with wandering outlines."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.vessel.inside import StatedInside, with_inside
from std_toolkit.scanning.vessel.outline_rays import mask_outline
from std_toolkit.scanning.vessel.revolve import fit_outline_points, fit_revolution
from std_toolkit.scanning.vessel.revolved_surface import OutlineView, RevolvedSurface
from tests.std_toolkit.scanning.vessels import outlines

CAMERA = Camera(fx=420.0, fy=420.0, cx=159.5, cy=119.5, width=320, height=240)
# Radius and height in metres, outside then inside: a tumbler with a waist.
PROFILE = [(0, 0), (0.026, 0), (0.022, 0.03), (0.03, 0.09), (0.028, 0.09), (0.02, 0.03), (0, 0.01)]
CENTRE = np.array([0.012, -0.02, 0.0])


def tumbler() -> trimesh.Trimesh:
    """z up, beside the origin of the world."""
    return trimesh.creation.revolve(np.array(PROFILE), sections=96).apply_translation(CENTRE)


def views_of(mesh: trimesh.Trimesh, count: int = 6) -> list[OutlineView]:
    return outlines(mesh, CAMERA, CENTRE + np.array([0.004, 0.003, 0.045]), 0.28, count)


@pytest.fixture(scope="module")
def fitted() -> RevolvedSurface:
    views = views_of(tumbler())
    return with_inside(fit_revolution(views), views, StatedInside(wall_mm=2))


@pytest.mark.slow
def test_profile_and_axis_of_a_tumbler(fitted: RevolvedSurface) -> None:
    assert np.abs(fitted.T_world_axis.t[:2] - CENTRE[:2]).max() < 2e-4
    assert fitted.heights[-1] == pytest.approx(0.09, abs=7e-4)  # a pixel is 0.67 mm
    side = (fitted.heights > 0.004) & (fitted.heights < 0.085)
    true = np.interp(fitted.heights, [0, 0.03, 0.09], [0.026, 0.022, 0.03])
    apart = np.abs(fitted.radii - true)[side]
    assert np.median(apart) < 1.5e-4
    assert apart.max() < 1e-3
    assert fitted.outside < 0.01
    assert np.median(fitted.deviation_m) < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("start_m", [0.084, 0.095])
def test_rim_that_only_photos_from_above_show(start_m: float) -> None:
    """A lower rim that widens has the same outline from there."""
    views = views_of(tumbler(), 12)
    rng = np.random.default_rng(1)
    points = []
    for k, view in enumerate(views):
        uv = mask_outline(view.mask)
        if k % 2 == 0:  # before the unknown background
            below = view.T_world_cam.inverse() @ (CENTRE + np.array([0, 0, 0.08]))
            uv = uv[uv[:, 1] > CAMERA.project(below)[1]]
        points.append(uv + rng.normal(0, 0.4, uv.shape))
    found = fit_outline_points(
        views, points, centre=CENTRE[:2], heights=np.array([0, 0.03, start_m]),
        radii=np.array([0.026, 0.022, 0.03]), most_outside=0.1,
    )  # fmt: skip
    assert found.heights[-1] == pytest.approx(0.09, abs=1e-3)
    assert found.radii[-1] == pytest.approx(0.03, abs=1e-3)


@pytest.mark.slow
def test_mesh_is_watertight_and_lies_on_the_vessel(fitted: RevolvedSurface) -> None:
    truth = RayCaster(tumbler().vertices, tumbler().faces)
    vertices, faces = fitted.mesh()
    mesh = trimesh.Trimesh(vertices, faces)
    assert mesh.is_watertight and mesh.volume > 0
    assert np.median(truth.distance(vertices)) < 5e-4
    assert any("base is a guess" in line for line in fitted.warnings)


@pytest.mark.slow
def test_handle_is_no_surface_of_revolution() -> None:
    handle = trimesh.creation.annulus(0.018, 0.024, 0.01)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    handle.apply_translation(CENTRE + np.array([0.03, 0, 0.05]))
    with pytest.raises(ToolkitError, match="no surface of revolution"):
        fit_revolution(views_of(trimesh.util.concatenate([tumbler(), handle]), 6))


def test_few_views() -> None:
    with pytest.raises(ToolkitError, match="3 photos show the outline"):
        fit_revolution(views_of(tumbler(), 3))
