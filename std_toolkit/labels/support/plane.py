"""The plane on which objects stand, and placement of objects on it."""

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
        normal: (3,) unit vector; that of a table points up, towards the cameras.
        offset: metres.
        frame: coordinate frame: "world", or "camera 12" for the camera of frame 12.

    Raises:
        ToolkitError: the normal has no length, or a number is not finite.
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
        """Return the height (...,) of points (..., 3) above the plane, metres; negative below."""
        return np.asarray(points, dtype=np.float64) @ self.normal + self.offset

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Project points (..., 3) onto the plane."""
        p = np.asarray(points, dtype=np.float64)
        return p - self.signed_distance(p)[..., None] * self.normal

    def moved(self, T_b_a: SE3, frame: str) -> Plane:
        """Return the same plane in another frame b, called `frame`."""
        normal = T_b_a.R @ self.normal
        return Plane(normal, self.offset - float(normal @ T_b_a.t), frame)


def camera_frame_name(frame_id: int) -> str:
    """Return the name of the coordinate frame of a frame's camera."""
    return f"camera {frame_id}"


@dataclass(frozen=True, eq=False)
class TablePlane:
    """The plane that supports the objects, and its accuracy.

    Attributes:
        plane: plane in the world, or in a camera.
        source: data in which it was found: sensor depth, points of the reconstruction, or the
            resting faces of placed objects.
        rms_m: root mean square of the distances of the points in the plane, metres.
        points: number of these points.
        frames: number of frames whose depth was used; 0 without depth.
        centre: (3,) mean of these points, in the plane.
        radius_m: radius around `centre` that contains nine tenths of the points, metres.
        uncertainty_m: possible error of the plane along its normal, metres.
        depth_factor: sensor depth over true depth (1.01: 1 % too far), if it could be determined;
            the plane is corrected for it.
        quality: check a "doubtful" plane before placing objects on it.
        notes: sentences on corrections, and on reasons for doubt.
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
    """Result of a search: the table, or a sentence on why none was found."""

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
    """Return the pose in which the lowest point of the object touches the plane.

    Idempotent.

    Args:
        mesh: mesh in metres; need not be watertight.
        T_frame_obj: mesh to the frame of the plane.
        plane: plane whose normal points to the side on which the object stands.
        mode: "drop" only moves the object along the normal. "rest" first rotates it about its
            centre of mass by the smallest angle that puts a facet on which it can stand onto the
            plane; a round object keeps its roll.
        largest_tilt: largest rotation of "rest", radians.

    Raises:
        ToolkitError: the mode is unknown, or "rest" finds no stable facet within `largest_tilt`.
    """
    solid = solid_of(mesh)
    if mode == "rest":
        down = -T_frame_obj.R.T @ plane.normal
        resting, angle = solid.resting.nearest(down)
        if angle > largest_tilt:
            raise ToolkitError(
                f"the object would have to turn by {np.degrees(angle):.0f} degrees to stand on "
                f"the table; the limit is {np.degrees(largest_tilt):.0f}",
                hint="rotate it approximately upright first, or only drop it",
            )
        middle = T_frame_obj @ solid.centre_of_mass
        turn = _smallest_rotation(T_frame_obj.R @ resting, -plane.normal)
        R = turn @ T_frame_obj.R
        T_frame_obj = SE3(R, middle - R @ solid.centre_of_mass)
    elif mode != "drop":
        raise ToolkitError("unknown mode", value=mode, hint="one of drop, rest")
    lowest = float(plane.signed_distance(T_frame_obj @ solid.hull).min())
    return SE3(T_frame_obj.R, T_frame_obj.t - lowest * plane.normal)


def _smallest_rotation(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) rotation by the smallest angle that maps unit vector a to b."""
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        if a @ b > 0:
            return np.eye(3)
        axis = np.cross(a, np.eye(3)[int(np.abs(a).argmin())])
        return so3_exp(np.pi * axis / np.linalg.norm(axis))
    return so3_exp(float(np.arctan2(sine, a @ b)) * axis / sine)
