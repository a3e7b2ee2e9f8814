"""An asset's own look as a renderer takes it: one texture on one pair of coordinates per vertex."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sensors.assets import Asset
from sensors.render import SurfaceMesh

# Texels of one colour in a palette: more than one, so that filtering does not mix neighbours.
_SWATCH = 4


def own_surface(asset: Asset, diagonal_m: float) -> tuple[SurfaceMesh, NDArray[np.uint8] | None]:
    """The asset at its size, and the texture image that shows its own colours.

    A picture is taken as it is; colours of faces become a palette, each face's corners pointing
    into the middle of its swatch. Vertices are doubled where corners differ.

    Args:
        asset: in its canonical frame.
        diagonal_m: bounding-box diagonal of the object, metres.

    Returns:
        The mesh in metres, and (h, w, 3) uint8 sRGB or None where the asset has no colours.
    """
    vertices = asset.vertices * diagonal_m
    if asset.texture is not None and asset.corner_uv is not None:
        return _with_corners(vertices, asset.faces, asset.corner_uv), asset.texture
    if asset.face_colors is None:
        return SurfaceMesh(vertices, asset.faces), None
    palette, of_face = np.unique(asset.face_colors, axis=0, return_inverse=True)
    image = np.repeat(np.repeat(palette[None], _SWATCH, axis=0), _SWATCH, axis=1)
    u = (of_face.reshape(-1) + 0.5) / len(palette)
    corners = np.stack([u, np.full(len(u), 0.5)], axis=1)
    uv = np.repeat(corners[:, None], 3, axis=1)
    return _with_corners(vertices, asset.faces, uv), np.ascontiguousarray(image)


def _with_corners(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], uv: NDArray[np.floating]
) -> SurfaceMesh:
    """A mesh whose vertices have one pair of coordinates each, doubled where corners differ."""
    keys = np.concatenate([faces.reshape(-1, 1), uv.reshape(-1, 2)], axis=1)
    used, index = np.unique(keys, axis=0, return_inverse=True)
    return SurfaceMesh(
        vertices[used[:, 0].astype(np.int64)],
        index.reshape(-1, 3),
        np.ascontiguousarray(used[:, 1:]),
    )
