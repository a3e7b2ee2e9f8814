"""Requests that compute poses: refinement, PnP from clicked points, snapping to the table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import numpy as np

from annotator.session.edits import PoseChange, SetPoses
from annotator.session.edits.object_edits import refuse_locked
from annotator.session.requests.mesh_requests import Outcome, Request, RequestCancelled, Watch
from annotator.session.state import Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_angle
from std_toolkit.labels.entry.pnp import solve_pnp
from std_toolkit.scene.document import Count, Positive

if TYPE_CHECKING:
    from std_toolkit.labels.auto_refine import RefinedPose
    from std_toolkit.labels.support.plane import Plane, TablePlane
    from std_toolkit.labels.support.solid import PlacedObject

Numbers4 = Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]


class Refine(Request, frozen=True, kw_only=True, tag="refine"):
    """Fits objects jointly; the other placed objects, and locked ones, act as occluders.

    Attributes:
        objects: names of the objects to fit.
        frame: the frame of the new poses; default: the one each object was placed in. Without
            metric camera poses it is the only frame used, and required.
        frames: the frames to use; default: `frame` and keyframes spread over the viewpoints.
        method: "auto" selects by material, "depth" uses sensor depth on any material, "multiview"
            uses edges only.
    """

    objects: list[str]
    frame: Count | None = None
    frames: list[Count] | None = None
    method: Literal["auto", "depth", "multiview"] = "auto"

    def check(self) -> None:
        if not self.objects:
            raise ToolkitError("no object is named", field="objects")

    @property
    def title(self) -> str:
        names = ", ".join(self.objects[:3]) + (", ..." if len(self.objects) > 3 else "")
        return f"Refine {names}"

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        from std_toolkit.labels.auto_refine import RefineCancelled, refine_objects

        named = [snapshot.object(name) for name in self.objects]
        ids = {obj.name: obj.id for obj in named if not obj.locked}
        if not ids:
            refuse_locked(named[0])
        alone = self._lone_frame(snapshot)
        poses = _poses(snapshot, alone)
        frame = self.frame
        try:
            found = refine_objects(
                snapshot.scene,
                poses,
                list(ids.values()),
                frames=[alone] if alone is not None else self.frames,
                method=self.method,
                always=[] if frame is None else [frame],
                mesh=snapshot.mesh,
                progress=watch.progress,
                cancelled=watch.cancelled,
            )
        except RefineCancelled as error:
            raise RequestCancelled("the refinement was cancelled") from error
        changes, report = [], []
        warnings = [f"{obj.name} is locked and keeps its pose." for obj in named if obj.locked]
        warnings += [
            f"{snapshot.scene.objects.object(i).name} keeps its pose: {error}"
            for i, error in found.failures.items()
        ]
        warnings += [f"{line[:1].upper()}{line[1:]}." for line in found.left_out]
        for refined in found.objects.values():
            frame_of_pose, T_cam_obj = self._placed_in(snapshot, refined, alone)
            changes.append(
                PoseChange(
                    object=refined.name,
                    frame=frame_of_pose,
                    T_cam_obj=T_cam_obj.flat(),
                    method="refine",
                    refinement=refined.method,
                )
            )
            report.append(_line(snapshot, refined, poses[refined.object]))
            warnings += [f"{refined.name}: {text}" for text in refined.warnings]
        weak = {r.name: r.weak_direction for r in found.objects.values() if r.weak_direction}
        textures = {r.name: r.texture for r in found.objects.values() if r.texture is not None}
        warnings += [
            f"{name}: {found.sentence()}; press Y to take that turn"
            for name, found in textures.items()
            if found.verdict == "turned"
        ]
        warnings += [
            f"{name}: {found.sentence()}"
            for name, found in textures.items()
            if found.verdict == "other"
        ]
        return Outcome(
            SetPoses(changes=changes, label=self.title), report, warnings, weak, textures
        )

    def _lone_frame(self, snapshot: Snapshot) -> int | None:
        """Return the only frame to use if poses hold in one frame only, otherwise None."""
        given = [*(self.frames or []), *([] if self.frame is None else [self.frame])]
        known = list(dict.fromkeys(given))
        if snapshot.posed:
            for frame in known:
                self._require_pose(snapshot, frame)
            return None
        if len(known) != 1:
            raise ToolkitError(
                "without metric camera poses a refinement uses one frame",
                field="frames",
                value=known,
                hint="name one frame",
            )
        snapshot.scene.frame(known[0])
        return known[0]

    @staticmethod
    def _require_pose(snapshot: Snapshot, frame: int) -> None:
        snapshot.scene.frame(frame)
        if frame not in snapshot.cameras.frame_set:
            raise ToolkitError(
                "this frame has no camera pose",
                field="frame",
                value=frame,
                hint="refine in a frame that has one",
            )

    def _placed_in(
        self, snapshot: Snapshot, refined: RefinedPose, alone: int | None
    ) -> tuple[int, SE3]:
        """Return the frame of a refined pose, and T_cam_obj in it."""
        if alone is not None:
            return alone, refined.pose
        frame = self.frame
        T_world_cam = snapshot.T_world_cam(frame) if frame is not None else None
        if frame is None or T_world_cam is None:
            placed = snapshot.object(refined.name).placements
            frame = next(f for f in placed if snapshot.T_world_cam(f) is not None)
            T_world_cam = snapshot.T_world_cam(frame)
        assert T_world_cam is not None
        return frame, T_world_cam.inverse() @ refined.pose


def _poses(snapshot: Snapshot, alone: int | None) -> dict[int, SE3]:
    """Return poses of all placed objects by id, in the world or in the camera of the only frame."""
    poses = {
        o.id: snapshot.T_world_obj(o.name) if alone is None else snapshot.pose(o.name, alone)
        for o in snapshot.state.objects
    }
    return {i: T for i, T in poses.items() if T is not None}


def _line(snapshot: Snapshot, refined: RefinedPose, start: SE3) -> str:
    """Return a line of text on the result for one object."""
    centre = snapshot.centre(snapshot.object(refined.name).model)
    moved = 1000 * float(np.linalg.norm(refined.pose @ centre - start @ centre))
    turned = np.rad2deg(rotation_angle(refined.pose.R @ start.R.T))
    text = f"{refined.name}: moved by {moved:.1f} mm, turned by {turned:.1f} deg; {refined.method}"
    return f"{text}; {refined.weak_direction}" if refined.weak_direction else text


class SolvePnP(Request, frozen=True, kw_only=True, tag="solve_pnp"):
    """Computes the pose of an object from the points clicked in a frame (PnP).

    Attributes:
        threshold_px: largest residual of an inlier.
    """

    object: str
    frame: Count
    threshold_px: Positive = 4.0

    @property
    def title(self) -> str:
        return f"Pose of {self.object} from points"

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        del watch
        obj = snapshot.object(self.object)
        refuse_locked(obj)
        clicks = obj.clicks.get(self.frame, [])
        frame = snapshot.scene.frame(self.frame)
        if len(clicks) < 4:
            raise ToolkitError(
                f"{len(clicks)} points are clicked in frame {self.frame}",
                field="object",
                value=self.object,
                hint="a pose needs at least 4, spread over the object",
            )
        found = solve_pnp(
            np.array([c.point for c in clicks]),
            np.array([(c.u, c.v) for c in clicks]),
            snapshot.scene.camera(frame),
            threshold_px=self.threshold_px,
        )
        std = np.sqrt(np.diag(found.covariance))
        report = [
            f"{int(found.inliers.sum())} of {len(clicks)} points fit, rms {found.rmse_px:.2f} px; "
            f"standard deviation {np.linalg.norm(std[:3]) * 1000:.1f} mm, "
            f"{np.rad2deg(np.linalg.norm(std[3:])):.2f} deg"
        ]
        report += [
            f"point {i + 1}: {residual:.2f} px" + ("" if fits else " (left out)")
            for i, (residual, fits) in enumerate(
                zip(found.residuals_px, found.inliers, strict=True)
            )
        ]
        left_out = [str(i + 1) for i, fits in enumerate(found.inliers) if not fits]
        warnings = []
        if left_out:
            warnings.append(
                f"{self.object}: point {', '.join(left_out)} does not fit the others and was "
                "left out; correct or remove it"
            )
        edit = SetPoses.one(
            self.object, self.frame, found.T_cam_obj, method="pnp", label=self.title
        )
        return Outcome(edit, report, warnings)


class SnapToTable(Request, frozen=True, kw_only=True, tag="snap_to_table"):
    """Places an object on the table: moves it along the normal, optionally rotating it to rest.

    Attributes:
        frame: the frame of the new pose; default: the one it was placed in.
        mode: "drop" keeps the rotation; "rest" rotates the object onto its nearest stable facet.
        table: (nx, ny, nz, offset) with `n . p + offset = 0`, n up, metres: in the world, or
            without metric camera poses in the frame's camera. Default: estimate the table from
            sensor depth, from the reconstruction, or from the other objects.
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
        from std_toolkit.labels.support.plane import snap_to_plane

        obj = snapshot.object(self.object)
        refuse_locked(obj)
        frame = self.frame if self.frame is not None else next(iter(obj.placements), None)
        T_cam_obj = snapshot.pose(self.object, frame) if frame is not None else None
        if frame is None or T_cam_obj is None:
            raise ToolkitError(
                "this object has no pose to start from",
                field="object",
                value=self.object,
                hint="place it near the table first",
            )
        # The world if it exists, otherwise the camera of the frame.
        T_cam_common = SE3.identity()
        if (T_world_cam := snapshot.T_world_cam(frame)) is not None:
            T_cam_common = T_world_cam.inverse()
        plane, source, warnings = self._plane(snapshot, frame)
        start = T_cam_common.inverse() @ T_cam_obj
        mesh = snapshot.mesh(obj.model)
        end = snap_to_plane(mesh, start, plane, mode=self.mode)
        centre = snapshot.centre(obj.model)
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
        """Return the table, its source, and warnings."""
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
        objects = placed_objects(snapshot, camera_frame)
        others = [t for t in objects if t.name != self.object]
        found = search_table(snapshot.scene, objects=objects, camera_frame=camera_frame)
        if found.table is not None and found.table.source == "objects":
            # Exclude the object from the estimate, which would otherwise keep it in place.
            found = search_table(snapshot.scene, objects=others, camera_frame=camera_frame)
        if found.table is None:
            raise ToolkitError(
                found.reason or "no table found",
                field="object",
                value=self.object,
                hint="place an object that stands on it first, or move this one by hand",
            )
        return found.table


def placed_objects(snapshot: Snapshot, camera_frame: int | None) -> list[PlacedObject]:
    """Return the placed objects in the world, or in the camera of a frame.

    Raises:
        ToolkitError: a mesh cannot be read.
    """
    from std_toolkit.labels.support.solid import PlacedObject

    poses = {
        o.name: snapshot.T_world_obj(o.name)
        if camera_frame is None
        else snapshot.pose(o.name, camera_frame)
        for o in snapshot.state.objects
    }
    return [
        PlacedObject(o.name, snapshot.mesh(o.model), T)
        for o in snapshot.state.objects
        if (T := poses[o.name]) is not None
    ]
