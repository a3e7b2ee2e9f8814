"""Putting an object onto a plane: down until it touches, or also level on its nearest facet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.labels.support.plane import Plane
from std_toolkit.labels.support.solid import solid_of

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import NDArray

    from std_toolkit.rendering.mesh import RenderMesh

LARGEST_TILT = np.radians(30.0)


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
