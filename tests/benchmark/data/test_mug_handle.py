"""Where a mug's handle is, and what shows it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from benchmark.data.true_poses import LEAST_HANDLE_PIXELS, find_handle, mesh_handle


def mug(angle_deg: float) -> trimesh.Trimesh:
    """A mug of 8 cm with a handle of 3 cm at an angle about y, away from the origin."""
    up = trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
    body = trimesh.creation.cylinder(0.04, 0.1, transform=up, sections=64)
    handle = trimesh.creation.torus(0.025, 0.005)
    handle.apply_translation([0.045, 0, 0])
    whole = trimesh.util.concatenate([body, handle])
    turn = trimesh.transformations.rotation_matrix(np.radians(angle_deg), [0, 1, 0])
    whole.apply_transform(turn)
    whole.apply_translation([0.3, -0.2, 0.1])
    return whole


@pytest.mark.parametrize(
    ("angle_deg", "axis", "side"), [(0, 0, 1), (180, 0, -1), (90, 2, -1), (-90, 2, 1)]
)
def test_the_handle_is_found_at_its_side(angle_deg: float, axis: int, side: int) -> None:
    mesh = mug(angle_deg)
    found = mesh_handle(mesh)
    assert found is not None
    assert found.axis == axis
    diagonal = np.linalg.norm(mesh.extents)
    assert found.radius == pytest.approx(0.04 / diagonal, rel=0.01)
    # The body's middle is on the other side of the box's.
    sticks_out = (mesh.extents[axis] / 2 - 0.04) / diagonal
    assert found.centre * side == pytest.approx(-sticks_out, rel=0.02)
    points = (mesh.vertices - mesh.bounds.mean(axis=0)) / diagonal
    outermost = points[points[:, axis] * side > 0.9 * (mesh.extents[axis] / 2) / diagonal]
    assert found.pixels(outermost) == len(outermost) >= LEAST_HANDLE_PIXELS
    assert found.is_visible(points)
    other_side = points[points[:, axis] * side < 0]
    assert found.pixels(other_side) == 0 and not found.is_visible(other_side)


def test_what_has_no_handle() -> None:
    ball = trimesh.creation.icosphere(radius=0.05)
    assert mesh_handle(ball) is None
    box = trimesh.creation.box((0.2, 0.1, 0.1))
    assert mesh_handle(box) is None, "what sticks out at both sides is no handle"
    assert find_handle(np.zeros((4, 3)), np.ones(4)) is None
