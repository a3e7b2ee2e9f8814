"""Putting an object onto the table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import numpy as np

from annotator.session.edits import SetPoses
from annotator.session.requests.base import Outcome, Request, Watch
from annotator.session.snapshot import Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.se3 import rotation_angle
from std_toolkit.scene.document import Count

if TYPE_CHECKING:
    from std_toolkit.labels.support.plane import Plane, TablePlane
    from std_toolkit.labels.support.solid import PlacedThing

Numbers4 = Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]


class SnapToTable(Request, frozen=True, kw_only=True, tag="snap_to_table"):
    """The object stands on the table: moved along its normal, or also laid onto its nearest facet.

    Attributes:
        frame: the frame in which the new pose is told; default: the one it was placed in.
        mode: "drop" turns nothing; "rest" lays a facet on which the object can stand flat.
        table: (nx, ny, nz, offset) with `n . p + offset = 0`, n up, metres: in the world, or
            without metric camera poses in the frame's camera. Default: the table is searched for,
            in sensor depth, in the reconstruction, under the other objects.
    """

    object: str
    frame: Count | None = None
    mode: Literal["drop", "rest"] = "drop"
    table: Numbers4 | None = None

    @property
    def title(self) -> str:
        return f"Put {self.object} onto the table"

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        del watch
        from std_toolkit.labels.support.snap import snap_to_plane

        thing = snapshot.object(self.object)
        frame = self.frame if self.frame is not None else next(iter(thing.placements), None)
        T_cam_obj = snapshot.pose(self.object, frame) if frame is not None else None
        if frame is None or T_cam_obj is None:
            raise ToolkitError(
                "this object has no pose to start from",
                field="object",
                value=self.object,
                hint="place it near the table first",
            )
        # The world where there is one, else the camera of the frame.
        T_cam_common = SE3.identity()
        if (T_world_cam := snapshot.T_world_cam(frame)) is not None:
            T_cam_common = T_world_cam.inverse()
        plane, source, warnings = self._plane(snapshot, frame)
        start = T_cam_common.inverse() @ T_cam_obj
        mesh = snapshot.mesh(thing.model)
        end = snap_to_plane(mesh, start, plane, mode=self.mode)
        centre = snapshot.centre(thing.model)
        moved = 1000 * float(np.linalg.norm(end @ centre - start @ centre))
        turned = np.rad2deg(rotation_angle(end.R @ start.R.T))
        edit = SetPoses.one(
            self.object,
            frame,
            T_cam_common @ end,
            method="snap",
            refinement=f"put onto the table ({source})",
            label=self.title,
        )
        report = [f"{self.object}: moved by {moved:.1f} mm, turned by {turned:.1f} deg; {source}"]
        return Outcome(edit, report, warnings)

    def _plane(self, snapshot: Snapshot, frame: int) -> tuple[Plane, str, list[str]]:
        """The table, where it is known from, and doubts about it."""
        from std_toolkit.labels.support.plane import WORLD, Plane, camera_frame_name

        if self.table is not None:
            name = WORLD if snapshot.posed else camera_frame_name(frame)
            return Plane(np.array(self.table[:3]), self.table[3], name), "table as given", []
        found = self._search(snapshot, frame)
        source = f"table from {found.source}, known to {1000 * found.uncertainty_m:.1f} mm"
        warnings = []
        if found.quality == "doubtful":
            warnings.append(f"The table is doubtful: {'; '.join(found.notes)}.")
        return found.plane, source, warnings

    def _search(self, snapshot: Snapshot, frame: int) -> TablePlane:
        from std_toolkit.labels.support.table import search_table

        camera_frame = None if snapshot.posed else frame
        things = placed_things(snapshot, camera_frame)
        others = [t for t in things if t.name != self.object]
        found = search_table(snapshot.scene, objects=things, camera_frame=camera_frame)
        if found.table is not None and found.table.source == "objects":
            # What the object says about the table itself must not hold it where it is.
            found = search_table(snapshot.scene, objects=others, camera_frame=camera_frame)
        if found.table is None:
            raise ToolkitError(
                found.reason or "no table found",
                field="object",
                value=self.object,
                hint="place an object that stands on it first, or move this one by hand",
            )
        return found.table


def placed_things(snapshot: Snapshot, camera_frame: int | None) -> list[PlacedThing]:
    """The placed objects in the world, or in the camera of a frame.

    Raises:
        ToolkitError: a mesh cannot be read.
    """
    from std_toolkit.labels.support.solid import PlacedThing

    poses = {
        o.name: snapshot.T_world_obj(o.name)
        if camera_frame is None
        else snapshot.pose(o.name, camera_frame)
        for o in snapshot.state.objects
    }
    return [
        PlacedThing(o.name, snapshot.mesh(o.model), T)
        for o in snapshot.state.objects
        if (T := poses[o.name]) is not None
    ]
