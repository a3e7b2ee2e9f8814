"""Crossing faces of a mesh are found, as Open3D finds them and more, and taken apart."""

from __future__ import annotations

import numpy as np
import trimesh

from std_toolkit.geometry.crossing_faces import crossing_faces, without_crossings
from std_toolkit.geometry.ray_caster import import_open3d


def ball(noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    random = np.random.default_rng(0)
    vertices = np.asarray(mesh.vertices)
    return vertices + random.normal(0, noise, vertices.shape), np.asarray(mesh.faces)


def test_a_ball_has_no_crossing_faces() -> None:
    assert not crossing_faces(*ball()).any()


def test_faces_that_meet_at_a_vertex_do_not_cross_unless_one_goes_through_the_other() -> None:
    vertices = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.8, 0.2, 1], [0.2, 0.2, 1], [0.2, 0.2, -1.0]]
    )
    apart = np.array([[0, 1, 2], [0, 3, 4]])
    assert not crossing_faces(vertices, apart).any()
    through = np.array([[0, 1, 2], [0, 4, 5]])
    assert crossing_faces(vertices, through).all()


def test_no_crossing_face_of_open3d_is_missed() -> None:
    vertices, faces = ball(0.003)
    o3d = import_open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces)
    )
    other = np.unique(np.asarray(mesh.get_self_intersecting_triangles()))
    assert len(other) > 10
    assert crossing_faces(vertices, faces)[other].all()


def test_crossing_faces_are_taken_apart_and_the_rest_stays() -> None:
    vertices, faces = ball()
    spiked = vertices.copy()
    # Past its neighbours, just below the surface.
    sideways = np.cross(vertices[7], vertices[7][[1, 2, 0]])
    spiked[7] = 0.95 * vertices[7] + 0.02 * sideways / np.linalg.norm(sideways)
    assert crossing_faces(spiked, faces).any()
    for before in (None, vertices):
        found = without_crossings(spiked, faces, before)
        assert not crossing_faces(found, faces).any()
        far = np.linalg.norm(vertices - vertices[7], axis=1) > 0.035
        assert np.array_equal(found[far], vertices[far])


def test_what_smoothing_does_not_part_goes_back_to_where_it_was() -> None:
    vertices, faces = ball()
    upper = vertices[:, 2] > 0
    through = vertices.copy()
    # The upper half of the ball below its lower half.
    through[upper, 2] *= -2
    found = without_crossings(through, faces, vertices)
    assert not crossing_faces(found, faces).any()
