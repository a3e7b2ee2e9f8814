"""Renderer protocol, windows on the pixel grid, and the rays through their pixels.

A renderer draws one mesh into one window and returns depth and triangle per pixel. The other
modules of this package compute the rest (visibility, masks, NOCS, normals, occlusion, visible
fractions) in float, so that renderers differ only in depth and triangle.

Pixel centres are at integer coordinates. A renderer whose library has another convention converts
internally.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.geometry import SE3, Camera

NEAR_M = 0.01
"""Surfaces closer to the camera plane than this are not drawn."""


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels `x .. x + width - 1`, `y .. y + height - 1`.

    Coordinates are those of the image and may be outside it.
    """

    x: int
    y: int
    width: int
    height: int

    @property
    def x1(self) -> int:
        """First column right of the window."""
        return self.x + self.width

    @property
    def y1(self) -> int:
        """First row below the window."""
        return self.y + self.height

    def intersect(self, other: Window) -> Window | None:
        """Return the intersection, or None if it is empty."""
        x, y = max(self.x, other.x), max(self.y, other.y)
        x1, y1 = min(self.x1, other.x1), min(self.y1, other.y1)
        return Window(x, y, x1 - x, y1 - y) if x1 > x and y1 > y else None

    def slices_in(self, outer: Window) -> tuple[slice, slice]:
        """Return rows and columns of this window in an array that covers `outer`."""
        return (
            slice(self.y - outer.y, self.y1 - outer.y),
            slice(self.x - outer.x, self.x1 - outer.x),
        )


@dataclass(frozen=True, eq=False)
class Raster:
    """One mesh rendered in one window.

    Attributes:
        depth: (h,w) float32 z-depth in metres, 0 outside the mesh.
        face: (h,w) int32 index of the visible triangle, -1 outside the mesh.
    """

    depth: np.ndarray
    face: np.ndarray


@dataclass(frozen=True, eq=False)
class PlacedMesh:
    """A mesh at a pose in the camera frame (OpenCV axes, metres).

    Attributes:
        object_id: instance id, 1..254.
        mesh: a trimesh in metres, or one already prepared.
        T_cam_obj: maps mesh coordinates into the camera frame.
    """

    object_id: int
    mesh: trimesh.Trimesh | RenderMesh
    T_cam_obj: SE3

    @property
    def prepared(self) -> RenderMesh:
        """The prepared mesh (cached by content)."""
        return prepare_mesh(self.mesh)


@runtime_checkable
class Renderer(Protocol):
    """A renderer, registered in the entry-point group `std_toolkit.renderers`.

    Attributes:
        name: name in `--renderer` and in records.
        handles_distortion: whether `draw` supports `camera.distortion`.
    """

    name: str
    handles_distortion: bool

    def draw(self, camera: Camera, mesh: RenderMesh, T_cam_obj: SE3, *, window: Window) -> Raster:
        """Draw both sides of every triangle at pixel centres, without antialiasing.

        Args:
            camera: intrinsics; pixel centres at integer coordinates.
            mesh: prepared mesh (its vertices are relative to `mesh.centre`).
            T_cam_obj: maps mesh coordinates (not the centred ones) into the camera frame.
            window: pixels to draw; may extend beyond the image.
        """
        ...


RENDERERS: Registry[Callable[[], Renderer]] = Registry(
    "std_toolkit.renderers",
    {
        "pyrender": "std_toolkit.rendering.pyrender_renderer:PyrenderRenderer",
        "raycast": "std_toolkit.rendering.raycast:RaycastRenderer",
    },
)


def check_no_distortion(renderer_name: str, camera: Camera) -> None:
    """Raise ToolkitError for a camera with distortion, for renderers that support pinholes only."""
    if camera.is_distorted:
        raise ToolkitError(
            f"renderer {renderer_name} supports pinhole cameras only",
            field="distortion",
            value=list(camera.distortion),
            hint="use --renderer raycast, or undistort the recording",
        )


def image_window(camera: Camera) -> Window:
    """Return the window of the image."""
    return Window(0, 0, camera.width, camera.height)


def canvas_window(camera: Camera, canvas: int) -> Window:
    """Return the window of `canvas` x `canvas` images (odd) with the image in the middle."""
    side = (canvas - 1) // 2
    return Window(
        -side * camera.width, -side * camera.height, canvas * camera.width, canvas * camera.height
    )


def camera_points(mesh: RenderMesh, T_cam_obj: SE3) -> np.ndarray:
    """Return (K,3) hull points of the mesh in the camera frame."""
    return mesh.hull @ T_cam_obj.R.T + (T_cam_obj.R @ mesh.centre + T_cam_obj.t)


def depth_range(mesh: RenderMesh, T_cam_obj: SE3) -> tuple[float, float]:
    """Return the smallest and largest z of the mesh in metres."""
    z = camera_points(mesh, T_cam_obj)[:, 2]
    return float(z.min()), float(z.max())


def object_window(
    camera: Camera, mesh: RenderMesh, T_cam_obj: SE3, *, canvas: int = 1
) -> Window | None:
    """Return the smallest canvas window with all pixels that the mesh can cover, or None.

    For a camera with distortion, `canvas` must be 1, because a distortion model is not valid
    outside the image it was fitted on.
    """
    bounds = _normalised_bounds(camera_points(mesh, T_cam_obj))
    if bounds is None:
        return None
    x0, y0, x1, y1 = bounds
    if camera.is_distorted:
        return _distorted_window(camera, bounds)
    u0, u1 = camera.fx * x0 + camera.cx, camera.fx * x1 + camera.cx
    v0, v1 = camera.fy * y0 + camera.cy, camera.fy * y1 + camera.cy
    outer = canvas_window(camera, canvas)
    # A margin for rounding keeps the border of the silhouette inside the window.
    u0, u1 = np.clip([u0 - 0.01, u1 + 0.01], outer.x - 2, outer.x1 + 2)
    v0, v1 = np.clip([v0 - 0.01, v1 + 0.01], outer.y - 2, outer.y1 + 2)
    left, top = int(np.ceil(u0)), int(np.ceil(v0))
    width, height = int(np.floor(u1)) - left + 1, int(np.floor(v1)) - top + 1
    if width <= 0 or height <= 0:
        return None
    return Window(left, top, width, height).intersect(outer)


def _normalised_bounds(points: np.ndarray) -> tuple[float, float, float, float] | None:
    """Bounding box of x/z, y/z; unbounded if the mesh extends behind the camera."""
    front = points[:, 2] > NEAR_M
    if not front.any():
        return None
    if not front.all():
        return (-np.inf, -np.inf, np.inf, np.inf)
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _distorted_window(camera: Camera, bounds: tuple[float, float, float, float]) -> Window | None:
    x, y = _distorted_grid(camera)
    slack = 0.1 / min(camera.fx, camera.fy)
    inside = (
        (x >= bounds[0] - slack)
        & (x <= bounds[2] + slack)
        & (y >= bounds[1] - slack)
        & (y <= bounds[3] + slack)
    )
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if len(rows) == 0:
        return None
    return Window(
        int(columns[0]),
        int(rows[0]),
        int(columns[-1] - columns[0]) + 1,
        int(rows[-1] - rows[0]) + 1,
    )


def normalised_rays(camera: Camera, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Return x/z and y/z of the rays through the pixel centres of a window, float64.

    Returns:
        Arrays that broadcast to (h,w): (1,w) and (h,1) for a pinhole, twice (h,w) with distortion
        (the window must then be inside the image).
    """
    if camera.is_distorted:
        rows, columns = window.slices_in(image_window(camera))
        x, y = _distorted_grid(camera)
        return x[rows, columns], y[rows, columns]
    u = np.arange(window.x, window.x1, dtype=np.float64)
    v = np.arange(window.y, window.y1, dtype=np.float64)
    x, y = camera.pinhole_rays(u, v)
    return x[None, :], y[:, None]


@lru_cache(maxsize=8)
def _distorted_grid(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    rays = camera.rays()
    return np.ascontiguousarray(rays[..., 0]), np.ascontiguousarray(rays[..., 1])
