"""Smooth normals and closedness of a prepared mesh against plain computations."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh


def test_corner_normals_are_weighted_by_angle() -> None:
    """A vertex of a curved mesh, computed face by face."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    stretched = trimesh.Trimesh(ball.vertices * [1.0, 1.1, 0.95], ball.faces, process=False)
    mesh = prepare_mesh(stretched)
    vertex = 50
    total = np.zeros(3)
    for face in stretched.faces[(stretched.faces == vertex).any(axis=1)]:
        corners = np.asarray(stretched.vertices)[np.roll(face, -int(np.argmax(face == vertex)))]
        u, v = corners[1] - corners[0], corners[2] - corners[0]
        normal = np.cross(u, v)
        angle = np.arctan2(np.linalg.norm(normal), u @ v)
        total += angle * normal / np.linalg.norm(normal)
    place = np.argwhere(mesh.faces == vertex)
    found = mesh.corner_normals[place[:, 0], place[:, 1]]
    assert np.abs(found - total / np.linalg.norm(total)).max() < 1e-6


def test_interpolated_normals_are_the_barycentric_mean_of_the_corners() -> None:
    rng = np.random.default_rng(3)
    mesh = prepare_mesh(trimesh.creation.icosphere(subdivisions=1, radius=0.05))
    face = rng.integers(0, len(mesh.faces), 200)
    weights = rng.dirichlet(np.ones(3), 200)
    points = np.einsum("nc,nci->ni", weights, mesh.vertices[mesh.faces[face]])
    table = mesh.interpolation[face].astype(np.float64)
    ones = np.append(points, np.ones((200, 1)), axis=1)
    second = np.einsum("ni,ni->n", table[:, 0:4], ones)
    third = np.einsum("ni,ni->n", table[:, 4:8], ones)
    assert np.abs(np.stack([second, third]) - weights.T[1:]).max() < 1e-5
    normal = table[:, 8:11] + second[:, None] * table[:, 11:14] + third[:, None] * table[:, 14:17]
    expected = np.einsum("nc,nci->ni", weights, mesh.corner_normals[face])
    assert np.abs(normal - expected).max() < 1e-5


@pytest.mark.parametrize("case", ["box", "inside out", "one face turned", "open"])
def test_only_watertight_meshes_wound_outwards_are_closed(case: str) -> None:
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    faces = np.array(box.faces)
    if case == "inside out":
        faces = faces[:, ::-1]
    elif case == "one face turned":
        faces[0] = faces[0, ::-1]
    elif case == "open":
        faces = faces[1:]
    assert RenderMesh.from_arrays(np.asarray(box.vertices), faces).closed is (case == "box")


def test_normals_of_a_ball_point_outwards_at_every_vertex() -> None:
    mesh = prepare_mesh(trimesh.creation.icosphere(subdivisions=3, radius=0.05))
    outwards = mesh.vertices[mesh.faces] / 0.05
    cosine = (mesh.corner_normals * outwards).sum(axis=2)
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 1.0
