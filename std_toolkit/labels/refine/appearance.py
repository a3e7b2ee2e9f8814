"""The colours of a mesh's surface, to tell apart poses whose shapes agree.

A box turned by half a turn, or a can about its axis, fits sensor depth as well as the right pose:
only its print decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

# A print that is larger than this in the file is finer than the images that it is compared with.
_LARGEST_TEXTURE = 512
# A surface whose colours vary by less than the first figure (standard deviation, grey levels)
# shows nothing but noise and shading, one by more than the second a print.
_PLAIN, _PRINTED = 10.0, 25.0
_SMOOTHING_PX = 1.0


@dataclass(frozen=True, eq=False)
class SurfaceColors:
    """Colours by place on a mesh.

    Attributes:
        corners: (F, 3, 2) texture coordinates of the faces' corners, or (F, 3, 3) their colours.
        texture: (h, w, 3) float32 RGB, or None where the corners have colours.
    """

    corners: NDArray[np.float32]
    texture: NDArray[np.float32] | None

    @staticmethod
    def of(mesh: trimesh.Trimesh) -> SurfaceColors | None:
        """From the mesh's texture or vertex colours; None if it has one colour at most."""
        visual: Any = mesh.visual
        if visual.kind == "texture":
            material = visual.material
            image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
            uv = visual.uv
            if image is None or uv is None or len(uv) != len(mesh.vertices):
                return None
            texture = np.asarray(image.convert("RGB"), dtype=np.float32)
            h, w = texture.shape[:2]
            shrink = _LARGEST_TEXTURE / max(h, w)
            if shrink < 1:
                size = (max(1, round(w * shrink)), max(1, round(h * shrink)))
                texture = np.asarray(cv2.resize(texture, size, interpolation=cv2.INTER_AREA))
            return SurfaceColors(np.asarray(uv, dtype=np.float32)[mesh.faces], texture)
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


def color_agreement(
    rendered: list[NDArray[np.float32]],
    seen: list[NDArray[np.float32]],
    masks: list[NDArray[np.bool_]],
) -> float:
    """Correlation -1 to 1 of rendered and photographed colours over several views.

    The light of each view shifts and scales its colours: means are taken off view by view. Both
    are smoothed within the mask, so that a pose that is off by a pixel still agrees.

    Args:
        rendered, seen: per view (h, w, 3) RGB.
        masks: per view (h, w) where the object shows.

    Returns:
        The correlation, drawn towards 0 where the surface shows too little print to tell.
    """
    shared = rendered_power = seen_power = 0.0
    count = 0
    for drawn, taken, mask in zip(rendered, seen, masks, strict=True):
        if mask.sum() < 30:
            continue
        a, b = (_smoothed(x, mask)[mask].astype(np.float64) for x in (drawn, taken))
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        shared += float((a * b).sum())
        rendered_power += float((a * a).sum())
        seen_power += float((b * b).sum())
        count += a.size
    if count == 0 or rendered_power <= 0 or seen_power <= 0:
        return 0.0
    contrast = float(np.sqrt(rendered_power / count))
    clear = float(np.clip((contrast - _PLAIN) / (_PRINTED - _PLAIN), 0, 1))
    return clear * shared / float(np.sqrt(rendered_power * seen_power))


def _smoothed(image: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Gaussian means over the pixels of the mask."""
    weight = mask.astype(np.float32)
    total = cv2.GaussianBlur(weight, (0, 0), _SMOOTHING_PX)
    mixed = cv2.GaussianBlur(image * weight[..., None], (0, 0), _SMOOTHING_PX)
    return np.asarray(mixed / np.maximum(total, 1e-6)[..., None], dtype=np.float32)
