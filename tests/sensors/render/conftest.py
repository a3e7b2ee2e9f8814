"""Scenes that the renderer's tests share."""

from __future__ import annotations

import numpy as np
import pytest

from sensors.lighting.environment import EnvironmentMap
from sensors.materials.material_draw import DrawnMaterial
from sensors.render.sim_scene import SurfaceMesh

pytest.importorskip("mitsuba", reason="the simulator's extra is not installed")


@pytest.fixture(scope="session")
def variant() -> str:
    """The variant of Mitsuba that a simulation would take here."""
    from sensors.render.variant import choose_variant

    return choose_variant()


@pytest.fixture(scope="session")
def compiled(variant: str) -> str:
    """The same, for tests of what only compiled variants do."""
    if variant.startswith("scalar"):
        pytest.skip("no compiler for Mitsuba here; tools/system-libraries simulator installs it")
    return variant


@pytest.fixture(scope="session")
def white_sky() -> EnvironmentMap:
    return EnvironmentMap.normalised("white", np.ones((16, 32, 3), np.float32))


@pytest.fixture(scope="session")
def square() -> SurfaceMesh:
    """1 m x 1 m, z up, v upwards along y."""
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    return SurfaceMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), uv)


@pytest.fixture(scope="session")
def chalk() -> DrawnMaterial:
    """As matt as the description allows, its own colour alone."""
    return DrawnMaterial(
        name="chalk",
        material_class="raw",
        color=(0.5, 0.5, 0.5),
        own_share=1.0,
        specular=0.0,
        roughness=1.0,
    )
