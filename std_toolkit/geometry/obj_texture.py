"""Texture coordinates of the faces' corners of an OBJ file.

An OBJ file gives texture coordinates for each corner of a face. A mesh read in the file's order of
vertices has one for each vertex, so faces at the border of a patch of the texture span the patches.
"""

import warnings

import numpy as np
from numpy.typing import NDArray

CORNER_UV = "corner_uv"
"""Face attribute of a mesh: (F, 6) float64 u, v of the three corners of each face."""


def read_corner_uv(data: bytes, triangles: NDArray[np.floating]) -> NDArray[np.float64] | None:
    """Read the texture coordinates of the corners of every face.

    Args:
        data: content of the OBJ file.
        triangles: (F, 3, 3) corners of the faces as they were read from the file.

    Returns:
        (F, 6) u, v of the three corners. None if a face is no triangle with texture coordinates, or
        if the faces of the file are not `triangles` in their order.
    """
    lines = data.replace(b"\\\n", b" ").splitlines()
    faces = [line[2:] for line in lines if line.startswith(b"f ")]
    if len(faces) != len(triangles) or not faces:
        return None
    per_corner = faces[0].split()[0].count(b"/") + 1
    if per_corner < 2 or b"//" in faces[0]:
        return None
    index = _numbers(b" ".join(faces).replace(b"/", b" "))
    if index.size != len(faces) * 3 * per_corner:
        return None
    corners = index.astype(np.int64).reshape(-1, 3, per_corner) - 1
    points = _rows(lines, b"v ", 3)
    uv = _rows(lines, b"vt ", 2)
    if points is None or uv is None or corners.min() < 0:
        return None
    if corners[..., 0].max() >= len(points) or corners[..., 1].max() >= len(uv):
        return None
    if not np.allclose(points[corners[..., 0]], triangles, rtol=0, atol=1e-9):
        return None
    return uv[corners[..., 1]].reshape(-1, 6)


def _rows(lines: list[bytes], start: bytes, columns: int) -> NDArray[np.float64] | None:
    """Return the first columns of all lines of a kind; None if they differ in length."""
    rows = [line[len(start) :] for line in lines if line.startswith(start)]
    values = _numbers(b" ".join(rows))
    if not rows or values.size % len(rows) or values.size // len(rows) < columns:
        return None
    return values.reshape(len(rows), -1)[:, :columns]


def _numbers(text: bytes) -> NDArray[np.float64]:
    with warnings.catch_warnings():
        # NumPy stops at what is no number, now with a warning, later with a ValueError.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            return np.zeros(0)
