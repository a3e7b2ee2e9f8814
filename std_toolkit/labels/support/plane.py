"""The plane on which objects stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3

if TYPE_CHECKING:
    from std_toolkit.labels.support.solid import PlacedThing
    from std_toolkit.scene.scene import Frame, Scene

WORLD = "world"


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


def find_table(
    scene: Scene,
    *,
    frames: Sequence[Frame] | None = None,
    objects: Sequence[PlacedThing] | None = None,
    camera_frame: int | None = None,
) -> TablePlane | None:
    """The table of a scene, or None; `table.search_table` also says why there is none.

    See `search_table` for the arguments and errors.
    """
    from std_toolkit.labels.support.table import search_table

    return search_table(scene, frames=frames, objects=objects, camera_frame=camera_frame).table
