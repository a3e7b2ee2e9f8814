"""What a renderer is: it draws one mesh into one window of one camera's pixel grid.

Everything else (which object is in front, masks, NOCS, normals, occlusion, visible fractions) is
computed from that in float by the modules beside this one, so that two renderers differ in the
depth and the triangle they report and in nothing else.

Pixel centres lie at integer coordinates here; a renderer whose library puts them elsewhere
corrects that inside itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.geometry.camera import Camera
    from std_toolkit.geometry.se3 import SE3

NEAR_M = 0.01
"""Nothing closer to the camera plane than this is drawn."""


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels `x .. x + width - 1`, `y .. y + height - 1`.

    The numbers are those of the image's own grid and may lie outside the image.
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
        """The common rectangle, or None."""
        x, y = max(self.x, other.x), max(self.y, other.y)
        x1, y1 = min(self.x1, other.x1), min(self.y1, other.y1)
        return Window(x, y, x1 - x, y1 - y) if x1 > x and y1 > y else None

    def slices_in(self, outer: Window) -> tuple[slice, slice]:
        """Rows and columns of this window in an array that covers `outer`."""
        return (
            slice(self.y - outer.y, self.y1 - outer.y),
            slice(self.x - outer.x, self.x1 - outer.x),
        )


@dataclass(frozen=True, eq=False)
class Raster:
    """One mesh seen through one window.

    Attributes:
        depth: (h,w) float32 z-depth in metres, 0 where the mesh is not.
        face: (h,w) int32 index of the triangle seen, -1 where the mesh is not.
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
        """The mesh ready for rendering (cached by content)."""
        return prepare_mesh(self.mesh)


@runtime_checkable
class Renderer(Protocol):
    """A renderer. Register one under the entry-point group `std_toolkit.renderers`.

    Attributes:
        name: what `--renderer` and the records call it.
        handles_distortion: whether `draw` honours `camera.distortion`.
    """

    name: str
    handles_distortion: bool

    def draw(self, camera: Camera, mesh: RenderMesh, T_cam_obj: SE3, *, window: Window) -> Raster:
        """Draw both sides of every triangle at pixel centres, without antialiasing.

        Args:
            camera: intrinsics; pixel centres at integer coordinates.
            mesh: prepared mesh (its vertices are relative to `mesh.centre`).
            T_cam_obj: maps mesh coordinates (not the centred ones) into the camera frame.
            window: the pixels wanted; may reach beyond the image.
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
    """Refuse a camera with distortion in a renderer that draws pinholes only."""
    if camera.is_distorted:
        raise ToolkitError(
            f"renderer {renderer_name} draws pinhole cameras only",
            field="distortion",
            value=list(camera.distortion),
            hint="use --renderer raycast, or undistort the recording",
        )
