"""Colours of a mesh surface, from its texture or the colours of its vertices or faces."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.obj_texture import CORNER_UV

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

_reading = threading.Lock()

# A larger texture is finer than the images that it is compared with.
_LARGEST_TEXTURE = 512


@dataclass(frozen=True, eq=False)
class SurfaceColors:
    """Colours of a mesh surface.

    Attributes:
        corners: (F, 3, 2) texture coordinates of the faces' corners, or (F, 3, 3) their colours.
        texture: (h, w, 3) float32 RGB, or None if the corners have colours.
    """

    corners: Array32
    texture: Array32 | None

    @staticmethod
    def from_mesh(
        mesh: trimesh.Trimesh, *, largest: int | None = _LARGEST_TEXTURE
    ) -> SurfaceColors | None:
        """From the mesh's texture or vertex colours; None if it has at most one colour.

        Args:
            mesh: the mesh.
            largest: longer side to which a larger texture is reduced, pixels; None keeps its size.
        """
        visual: Any = mesh.visual
        if visual.kind == "texture":
            material = visual.material
            image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
            uv = visual.uv
            if image is None or uv is None or len(uv) != len(mesh.vertices):
                return None
            texture = np.asarray(_pixels(image, largest), dtype=np.float32)
            if largest is not None:
                texture = _reduced(texture, largest / max(texture.shape[:2]))
            corners = np.asarray(mesh.face_attributes.get(CORNER_UV, ()), dtype=np.float32)
            if len(corners) != len(mesh.faces):
                corners = np.asarray(uv, dtype=np.float32)[mesh.faces]
            return SurfaceColors(corners.reshape(-1, 3, 2), texture)
        if visual.kind == "vertex":
            colors = np.asarray(visual.vertex_colors, dtype=np.float32)[:, :3]
            return SurfaceColors(colors[mesh.faces], None)
        if visual.kind == "face":
            colors = np.asarray(visual.face_colors, dtype=np.float32)[:, :3]
            return SurfaceColors(np.repeat(colors[:, None], 3, axis=1), None)
        return None

    def at(self, face: NDArray[np.integer], weights: NDArray[np.floating]) -> Array:
        """(N, 3) RGB, 0 to 255.

        Args:
            face: (N,) index of the face.
            weights: (N, 2) barycentric weights of its second and third corner.
        """
        b, c = weights[:, :1], weights[:, 1:]
        corner = self.corners[face]
        value = (1 - b - c) * corner[:, 0] + b * corner[:, 1] + c * corner[:, 2]
        if self.texture is None:
            return np.asarray(value, dtype=np.float64)
        h, w = self.texture.shape[:2]
        # v = 0 is the bottom of the image; coordinates beyond 0 to 1 repeat it.
        column = np.clip(np.floor((value[:, 0] % 1.0) * w), 0, w - 1).astype(np.int64)
        row = np.clip(np.floor(((1 - value[:, 1]) % 1.0) * h), 0, h - 1).astype(np.int64)
        return np.asarray(self.texture[row, column], dtype=np.float64)

    def reduced(self, factor: float) -> SurfaceColors:
        """The same with a smaller texture; colours of corners stay as they are."""
        if self.texture is None or factor >= 1:
            return self
        return SurfaceColors(self.corners, _reduced(self.texture, factor))


def _pixels(image: Any, largest: int | None) -> Any:
    """Return a texture as an RGB image, at most about twice as large as wanted."""
    # A texture file is read on its first use, which must not happen in two threads at once.
    with _reading:
        image = image.convert("RGB")
    factor = 1 if largest is None else max(image.size) // largest
    return image.reduce(factor) if factor > 1 else image


def _reduced(texture: Array32, factor: float) -> Array32:
    if factor >= 1:
        return texture
    h, w = texture.shape[:2]
    size = (max(1, round(w * factor)), max(1, round(h * factor)))
    return np.asarray(cv2.resize(texture, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
