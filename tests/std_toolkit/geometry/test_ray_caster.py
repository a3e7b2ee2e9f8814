"""Rays, distances and insides against boxes whose answers are known."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import trimesh

from std_toolkit.geometry.ray_caster import RayCaster

BOX = trimesh.creation.box((2.0, 2.0, 2.0))


def two_boxes() -> RayCaster:
    """Around the origin and around x = 5."""
    caster = RayCaster(BOX.vertices, BOX.faces)
    caster.add(BOX.vertices + np.array([5, 0, 0]), BOX.faces)
    return caster


def test_rays_meet_the_nearest_face_of_the_right_mesh() -> None:
    rays = np.array([[-3, 0.1, 0.2, 1, 0, 0], [3, 0.1, 0.2, 2, 0, 0], [0, 0, 3, 0, 0, 1.0]])
    hits = two_boxes().cast(rays)
    np.testing.assert_allclose(hits.distance, [2, 0.5, np.inf])
    np.testing.assert_array_equal(hits.mesh[:2], [0, 1])
    np.testing.assert_allclose(hits.normal[:2], [[-1, 0, 0]] * 2, atol=1e-6)
    b, c = hits.uv[0]
    corners = BOX.vertices[BOX.faces[hits.face[0]]]
    np.testing.assert_allclose([1 - b - c, b, c] @ corners, [-1, 0.1, 0.2], atol=1e-6)
    np.testing.assert_array_equal(two_boxes().occluded(rays), [True, True, False])
    np.testing.assert_array_equal(two_boxes().crossings(rays), [4, 2, 0])


@pytest.mark.parametrize("threads", [0, 1])
def test_points_know_their_distance_and_side(threads: int) -> None:
    caster = RayCaster(BOX.vertices, BOX.faces, threads=threads)
    points = np.array([[[0, 0, 0.4]], [[0.3, 0.2, 3.0]]])
    np.testing.assert_allclose(caster.distance(points), [[0.6], [2.0]], rtol=1e-6)
    np.testing.assert_array_equal(caster.inside(points), [[True], [False]])
    nearest, normal = caster.closest(points)
    np.testing.assert_allclose(nearest, [[[0, 0, 1]], [[0.3, 0.2, 1]]], atol=1e-6)
    np.testing.assert_allclose(normal, [[[0, 0, 1]], [[0, 0, 1]]], atol=1e-6)


def test_nothing_is_met_where_there_is_no_mesh() -> None:
    assert np.isinf(RayCaster().cast(np.ones((2, 3, 6))).distance).all()


def test_open3d_is_imported_without_its_web_server() -> None:
    code = (
        "import sys; from std_toolkit.geometry.ray_caster import import_open3d; "
        "o3d = import_open3d(); assert 'dash' not in sys.modules; "
        "assert o3d.visualization.draw_plotly.__name__ == 'draw_plotly'; "
        "assert 'open3d.visualization.draw_plotly' not in sys.modules; "
        "assert import_open3d() is o3d"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
