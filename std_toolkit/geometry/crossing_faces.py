"""Faces of a mesh that cross other faces of it, and a mesh without them."""

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Mask
from std_toolkit.geometry.ray_caster import RayCaster

# Rounds of the repair, by neighbours and back, and after which one more ring of neighbours moves.
_ROUNDS, _WIDER_AFTER = 12, 4


def crossing_faces(vertices: Array, faces: NDArray[np.int64]) -> Mask:
    """Which faces (F,) of a mesh cross another face of it.

    An edge of one of them goes through the other. Faces that touch at common vertices do not cross.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3).
    """
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, of_face = np.unique(sides, axis=0, return_inverse=True)
    crossed = np.zeros(len(faces), bool)
    crossing = np.zeros(len(edges), bool)
    # Embree works in single precision. Lengths near 1 lose least.
    placed = vertices - vertices.mean(axis=0)
    placed = placed / (np.abs(placed).max() + 1e-20)
    caster = RayCaster(placed, faces)
    # From both ends: a hit at the very end of a ray may be missed from one.
    for a, b in ((0, 1), (1, 0)):
        start, end = placed[edges[:, a]], placed[edges[:, b]]
        ray, face, along = caster.crossed(np.concatenate([start, end - start], axis=1))
        within = (along > 0) & (along < 1)
        ray, face = ray[within], face[within]
        apart = ~(faces[face][:, :, None] == edges[ray][:, None, :]).any(axis=(1, 2))
        crossed[face[apart]] = True
        crossing[ray[apart]] = True
    return crossed | crossing[of_face.reshape(3, len(faces))].any(axis=0)


def without_crossings(
    vertices: Array, faces: NDArray[np.int64], before: Array | None = None
) -> Array:
    """Vertices (V, 3), those of crossing faces moved until no face crosses another.

    They move to the middle of their neighbours, every few rounds with one more ring of them; then
    back to where they were `before`. What crosses after the last round stays.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) of a closed mesh.
        before: (V, 3) vertices of the same faces with which hardly any cross.
    """
    moved = vertices.copy()
    back = np.zeros(len(moved), bool)
    for n in range(2 * _ROUNDS):
        bad = crossing_faces(moved, faces)
        if not bad.any():
            break
        chosen = np.zeros(len(moved), bool)
        chosen[faces[bad]] = True
        for _ in range(n % _ROUNDS // _WIDER_AFTER):
            chosen[faces[chosen[faces].any(axis=1)]] = True
        if before is None or n < _ROUNDS:
            moved[chosen] = _middles(moved, faces)[chosen]
            continue
        # What crosses where it was before is smoothed there.
        again = chosen & back
        moved[chosen & ~back] = before[chosen & ~back]
        moved[again] = _middles(moved, faces)[again]
        back |= chosen
    return moved


def _middles(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """(V, 3) mean of the neighbours of each vertex in a closed mesh."""
    total, count = np.zeros_like(vertices), np.zeros(len(vertices))
    for k in range(3):
        for other in (faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]):
            np.add.at(total, faces[:, k], vertices[other])
            np.add.at(count, faces[:, k], 1)
    return total / np.maximum(count, 1)[:, None]
