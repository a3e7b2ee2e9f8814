"""Points that stand for a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def even_points(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], spacing: float
) -> NDArray[np.float64]:
    """(n, 3) points of a surface, about `spacing` metres apart; the same mesh, the same points."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    count = max(64, round(6 * float(mesh.area) / spacing**2))
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=0)
    # One of each cube: the one nearest to its middle, so that they keep apart.
    cubes = np.floor(np.asarray(points) / spacing)
    apart = np.linalg.norm(points - (cubes + 0.5) * spacing, axis=1)
    order = np.argsort(apart, kind="stable")
    first = np.unique(cubes[order], axis=0, return_index=True)[1]
    return np.asarray(points)[order[first]]
