"""Colours of a mesh surface, and pictures of a textured mesh at a pose.

A picture is ray-cast with several rays per pixel from a texture reduced to the size of the pixels,
so that fine texture is averaged as a camera does it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.surface_colors import SurfaceColors

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

# A picture reduces a texture of at most this size to its pixels.
_LARGEST_DRAWN = 4096

# Faces of a mesh with more are smaller than a texel.
_MOST_FILLED = 200_000

# A face whose side is longer in the texture than usual by this factor lies across a seam.
_STRETCHED = 4.0

# An object nearer to the camera has no bounded picture.
_NEAREST_M = 0.02


@dataclass(frozen=True, eq=False)
class TexturePicture:
    """A textured mesh in a window of an image.

    Attributes:
        x, y: top-left pixel of the window.
        color: (h, w, 3) float32 RGB, 0 where the mesh is not.
        mask: (h, w) pixels whose rays all hit the mesh.
        sound: (h, w) pixels of the mask whose texture is not stretched: reduced meshes have faces
            across the seams of their texture, which show a piece of its unused rest.
        depth: (h, w) float32 z-depth in metres, inf beside the mesh.
        normal: (h, w, 3) float32 unit normal in the mesh frame, towards the camera.
    """

    x: int
    y: int
    color: Array32
    mask: NDArray[np.bool_]
    sound: NDArray[np.bool_]
    depth: Array32
    normal: Array32


class TexturedSurface:
    """A mesh with colours, drawn at any pose; the rays move instead of the mesh.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) triangles.
        colors: colours of the faces, at full resolution.
    """

    def __init__(self, vertices: Array, faces: NDArray[np.integer], colors: SurfaceColors) -> None:
        used = vertices[np.unique(faces)]
        low, high = used.min(axis=0), used.max(axis=0)
        self.centre: Array = (low + high) / 2
        self.colors = colors
        self._corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
                                  for z in (low[2], high[2])])  # fmt: skip
        self._caster = RayCaster(vertices - self.centre, faces)
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        self._areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        self._sides = np.stack([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))])
        self._levels: dict[int, SurfaceColors] = {}

    @classmethod
    def from_mesh(cls, mesh: trimesh.Trimesh) -> TexturedSurface | None:
        """The surface of a mesh; None if it has at most one colour."""
        colors = SurfaceColors.from_mesh(mesh, largest=_LARGEST_DRAWN)
        if colors is None:
            return None
        return cls(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces), colors)

    @cached_property
    def texels_per_metre(self) -> float:
        """Typical resolution of the texture on the surface; 0 for colours of corners."""
        if self.colors.texture is None or self._areas.sum() <= 0:
            return 0.0
        h, w = self.colors.texture.shape[:2]
        return float(np.sqrt(self._texture_areas.sum() * h * w / self._areas.sum()))

    @cached_property
    def _texture_areas(self) -> Array:
        """(F,) area of the faces in the texture, in parts of the texture."""
        a, b, c = (self.colors.corners[:, k].astype(np.float64) for k in range(3))
        p, q = b - a, c - a
        return np.asarray(np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]) / 2)

    @cached_property
    def _sound(self) -> NDArray[np.bool_]:
        """(F,) faces whose sides have a usual length in the texture."""
        if self.colors.texture is None:
            return np.ones(len(self._areas), dtype=bool)
        sides = [(0, 1), (1, 2), (2, 0)]
        c = self.colors.corners.astype(np.float64)
        in_texture = np.stack([np.linalg.norm(c[:, i] - c[:, j], axis=1) for i, j in sides])
        stretch = in_texture / np.maximum(self._sides, 1e-9)
        usual = float(np.median(stretch))
        return np.asarray((stretch < _STRETCHED * usual).all(axis=0))

    def window(self, camera: Camera, T_cam_obj: SE3) -> tuple[int, int, int, int] | None:
        """x0, y0, x1, y1 (x1, y1 exclusive) of the image that may show the mesh, or None."""
        p = T_cam_obj @ self._corners
        if p[:, 2].min() < _NEAREST_M:
            return None
        uv = camera.project(p)
        x0, y0 = np.maximum(np.floor(uv.min(axis=0)).astype(int) - 1, 0)
        x1, y1 = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + 2, camera.size)
        if x1 - x0 < 4 or y1 - y0 < 4:
            return None
        return int(x0), int(y0), int(x1), int(y1)

    def draw(
        self,
        camera: Camera,
        T_cam_obj: SE3,
        *,
        window: tuple[int, int, int, int] | None = None,
        rays: int = 2,
    ) -> TexturePicture | None:
        """Draw the mesh with its colours, without light.

        Args:
            camera: undistorted camera.
            T_cam_obj: pose of the mesh.
            window: see `window`; default: the one of this pose.
            rays: rays per pixel and axis.

        Returns:
            The picture; None if the mesh is out of view or reaches behind the camera.
        """
        window = window or self.window(camera, T_cam_obj)
        if window is None:
            return None
        x0, y0, x1, y1 = window
        h, w, n = y1 - y0, x1 - x0, rays
        offset = (np.arange(n) + 0.5) / n - 0.5
        u = (np.arange(x0, x1)[:, None] + offset).ravel()
        v = (np.arange(y0, y1)[:, None] + offset).ravel()
        grid = np.stack(np.meshgrid(u, v), axis=-1)
        found = self._cast(camera, T_cam_obj, grid)
        hit = np.isfinite(found.distance)
        color = np.zeros((*hit.shape, 3), np.float32)
        level = self._level(camera.fx * n / max(float((T_cam_obj @ self.centre)[2]), _NEAREST_M))
        color[hit] = level.at(found.face[hit].astype(np.int64), found.uv[hit])
        blocks = (h, n, w, n)
        count = hit.reshape(blocks).sum(axis=(1, 3))
        sound = np.zeros(hit.shape, bool)
        sound[hit] = self._sound[found.face[hit].astype(np.int64)]
        whole = np.asarray(sound.reshape(blocks).all(axis=(1, 3)))
        mean = color.reshape(*blocks, 3).sum(axis=(1, 3)) / np.maximum(count, 1)[..., None]
        middle = (slice(n // 2, None, n), slice(n // 2, None, n))
        depth = np.where(hit, found.distance, np.inf).astype(np.float32)[middle]
        return TexturePicture(
            x0, y0, mean.astype(np.float32), count == n * n, whole, depth, found.normal[middle]
        )

    def points(self, camera: Camera, T_cam_obj: SE3, uv: NDArray[np.floating]) -> Array:
        """(N, 3) points of the surface, mesh frame, at pixels uv (N, 2); NaN beside it."""
        found = self._cast(camera, T_cam_obj, np.asarray(uv, dtype=np.float64))
        depth = found.distance.astype(np.float64)
        depth[~np.isfinite(depth)] = np.nan
        return np.asarray(T_cam_obj.inverse() @ (camera.unproject(uv) * depth[:, None]))

    def _cast(self, camera: Camera, T_cam_obj: SE3, uv: Array) -> Any:
        direction = np.ones((*uv.shape[:-1], 3))
        direction[..., 0], direction[..., 1] = camera.pinhole_rays(uv[..., 0], uv[..., 1])
        rays = np.empty((*uv.shape[:-1], 6), np.float32)
        rays[..., :3] = T_cam_obj.inverse().t - self.centre
        rays[..., 3:] = direction @ T_cam_obj.R
        return self._caster.cast(rays)

    def _padded(self) -> SurfaceColors:
        """The colours with every texel that no face uses set to its nearest used one.

        The unused rest of a texture is often black; reduced textures would mix it into the seams.
        """
        texture = self.colors.texture
        if texture is None:
            return self.colors
        h, w = texture.shape[:2]
        unused = np.full((h, w), 255, np.uint8)
        uv = self.colors.corners % 1.0 if self.colors.corners.min() < 0 else self.colors.corners
        px = np.stack([uv[..., 0] * w, (1 - uv[..., 1]) * h], axis=-1) - 0.5
        if len(px) <= _MOST_FILLED:
            # One by one: polygons that share an edge in one call would cancel each other.
            for corners in np.round(px).astype(np.int32):
                cv2.fillConvexPoly(unused, corners, 0)
        else:
            at = np.round(np.concatenate([px.reshape(-1, 2), px.mean(axis=1)])).astype(np.int64)
            at = np.clip(at, 0, [w - 1, h - 1])
            unused[at[:, 1], at[:, 0]] = 0
        if unused.all() or not unused.any():
            return self.colors
        # The outermost used texels are mixtures with the background.
        used = unused == 0
        core = cv2.erode(used.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        unused = np.where(core if core.any() else used, 0, 255).astype(np.uint8)
        _, label = cv2.distanceTransformWithLabels(
            unused, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        v, u = np.nonzero(unused == 0)
        source = np.zeros((int(label.max()) + 1, 2), np.int64)
        source[label[v, u]] = np.stack([v, u], axis=1)
        take = source[label]
        return SurfaceColors(self.colors.corners, texture[take[..., 0], take[..., 1]])

    def _level(self, rays_per_metre: float) -> SurfaceColors:
        """The colours with a texture about as fine as the rays, in steps of a factor of two."""
        if self.texels_per_metre <= 0:
            return self.colors
        halvings = max(int(np.floor(np.log2(self.texels_per_metre / rays_per_metre))), 0)
        if not self._levels:
            self._levels[0] = self._padded()
        if halvings not in self._levels:
            self._levels[halvings] = self._levels[0].reduced(0.5**halvings)
        return self._levels[halvings]
