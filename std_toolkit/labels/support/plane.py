"""The plane on which objects stand.

Putting an object onto a plane: down until it touches, or also level on its nearest facet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.labels.support.solid import solid_of

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.rendering.mesh import RenderMesh

WORLD = "world"

LARGEST_TILT = np.radians(30.0)


@dataclass(frozen=True, eq=False)
class Plane:
    """An oriented plane: `normal . p + offset = 0`.

    Attributes:
        normal: (3,) unit vector; of a table it points up, to where the cameras are.
        offset: metres.
        frame: the coordinate frame: "world", or "camera 12" for the camera of frame 12.

    Raises:
        ToolkitError: a normal of no length, or a number that is not finite.
    """

    normal: NDArray[np.float64]
    offset: float
    frame: str = WORLD

    def __post_init__(self) -> None:
        normal = np.asarray(self.normal, dtype=np.float64)
        length = float(np.linalg.norm(normal)) if normal.shape == (3,) else 0.0
        if not np.isfinite(length) or length < 1e-9 or not np.isfinite(self.offset):
            raise ToolkitError(
                "a plane needs a normal of three finite numbers and an offset",
                value=[*np.ravel(normal).tolist(), float(self.offset)],
            )
        object.__setattr__(self, "normal", normal / length)
        object.__setattr__(self, "offset", float(self.offset) / length)

    def signed_distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Metres (...,) of points (..., 3) above the plane, negative below."""
        return np.asarray(points, dtype=np.float64) @ self.normal + self.offset

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Nearest points of the plane (..., 3)."""
        p = np.asarray(points, dtype=np.float64)
        return p - self.signed_distance(p)[..., None] * self.normal

    def moved(self, T_b_a: SE3, frame: str) -> Plane:
        """The same plane in another frame b, whose name is `frame`."""
        normal = T_b_a.R @ self.normal
        return Plane(normal, self.offset - float(normal @ T_b_a.t), frame)


def camera_frame_name(frame_id: int) -> str:
    """Name of the coordinate frame of a frame's camera."""
    return f"camera {frame_id}"


@dataclass(frozen=True, eq=False)
class TablePlane:
    """A plane that carries the objects, and how well it is known.

    Attributes:
        plane: in the world, or in a camera.
        source: what it was found in: sensor depth, points of the reconstruction, or the resting
            faces of objects that were placed already.
        rms_m: of the distances of the points that lie in it.
        points: number of these points.
        frames: number of frames whose depth was used; 0 without depth.
        centre: (3,) middle of these points, in the plane.
        radius_m: nine tenths of them lie within it.
        uncertainty_m: how far the plane may be off along its normal.
        depth_factor: how much too far the sensor reads (1.01: 1 %), where that could be told; the
            plane has been corrected for it.
        quality: "doubtful" planes are to be looked at before anything is put on them.
        notes: sentences on what was corrected, and why it is doubtful.
    """

    plane: Plane
    source: Literal["depth", "reconstruction", "objects"]
    rms_m: float
    points: int
    frames: int
    centre: NDArray[np.float64]
    radius_m: float
    uncertainty_m: float
    depth_factor: float | None = None
    quality: Literal["good", "doubtful"] = "good"
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class TableSearch:
    """Outcome of a search: the table, or a sentence that says why there is none."""

    table: TablePlane | None
    reason: str = ""


def snap_to_plane(
    mesh: trimesh.Trimesh | RenderMesh,
    T_frame_obj: SE3,
    plane: Plane,
    *,
    mode: Literal["drop", "rest"] = "drop",
    largest_tilt: float = LARGEST_TILT,
) -> SE3:
    """The pose that touches the plane with the object's lowest point.

    Snapping twice is snapping once.

    Args:
        mesh: in metres; need not be watertight.
        T_frame_obj: mesh to the frame in which the plane is given.
        plane: its normal points to the side on which the object stands.
        mode: "drop" moves the object along the normal and turns nothing. "rest" first turns it
            about its centre of mass by the smallest angle that lays a facet on which it can stand
            onto the plane; a round object keeps its roll.
        largest_tilt: radians; "rest" refuses to turn further.

    Raises:
        ToolkitError: an unknown mode, or "rest" with no standing facet within `largest_tilt`.
    """
    solid = solid_of(mesh)
    if mode == "rest":
        down = -T_frame_obj.R.T @ plane.normal
        resting, angle = solid.resting.nearest(down)
        if angle > largest_tilt:
            raise ToolkitError(
                f"the object would have to turn by {np.degrees(angle):.0f} degrees to stand on "
                f"the table; at most {np.degrees(largest_tilt):.0f} are done unasked",
                hint="turn it roughly as it stands first, or only drop it",
            )
        middle = T_frame_obj @ solid.centre_of_mass
        turn = _smallest_rotation(T_frame_obj.R @ resting, -plane.normal)
        R = turn @ T_frame_obj.R
        T_frame_obj = SE3(R, middle - R @ solid.centre_of_mass)
    elif mode != "drop":
        raise ToolkitError("unknown way to snap", value=mode, hint="one of drop, rest")
    lowest = float(plane.signed_distance(T_frame_obj @ solid.hull).min())
    return SE3(T_frame_obj.R, T_frame_obj.t - lowest * plane.normal)


def _smallest_rotation(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) rotation by the smallest angle that turns unit vector a into b."""
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        if a @ b > 0:
            return np.eye(3)
        axis = np.cross(a, np.eye(3)[int(np.abs(a).argmin())])
        return so3_exp(np.pi * axis / np.linalg.norm(axis))
    return so3_exp(float(np.arctan2(sine, a @ b)) * axis / sine)
