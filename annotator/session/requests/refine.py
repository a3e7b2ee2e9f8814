"""Fitting objects to the images and the sensor depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from annotator.session.edits import PoseChange, SetPoses
from annotator.session.requests.base import Outcome, Request, RequestCancelled, Watch
from annotator.session.snapshot import Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.se3 import rotation_angle
from std_toolkit.scene.document import Count

if TYPE_CHECKING:
    from std_toolkit.labels.refine.auto import RefinedPose


class Refine(Request, frozen=True, kw_only=True, tag="refine"):
    """Objects are fitted together; the other placed ones hide what is behind them.

    Attributes:
        objects: names of the objects to fit.
        frame: the frame in which the new poses are told; default: the one each was placed in.
            Without metric camera poses it is the only one that is looked at, and must be given.
        frames: the frames to look at; default: `frame` and keyframes spread over the viewpoints.
        method: "auto" decides by the materials, "depth" trusts the sensor on any of them,
            "multiview" goes by edges alone.
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
        from std_toolkit.labels.refine.auto import RefineCancelled, refine_objects

        ids = {name: snapshot.object(name).id for name in self.objects}
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
        warnings = [
            f"{snapshot.scene.objects.object(i).name} keeps its pose: {error}"
            for i, error in found.failures.items()
        ]
        for refined in found.objects.values():
            told_in, T_cam_obj = self._told(snapshot, refined, alone)
            changes.append(
                PoseChange(
                    object=refined.name,
                    frame=told_in,
                    T_cam_obj=T_cam_obj.flat(),
                    method="refine",
                    refinement=refined.method,
                )
            )
            report.append(_line(snapshot, refined, poses[refined.object]))
            warnings += [f"{refined.name}: {text}" for text in refined.warnings]
        weak = {r.name: r.weak_direction for r in found.objects.values() if r.weak_direction}
        return Outcome(SetPoses(changes=changes, label=self.title), report, warnings, weak)

    def _lone_frame(self, snapshot: Snapshot) -> int | None:
        """The one frame that is looked at where poses hold in one frame only, else None."""
        given = [*(self.frames or []), *([] if self.frame is None else [self.frame])]
        known = list(dict.fromkeys(given))
        if snapshot.posed:
            for frame in known:
                self._require_pose(snapshot, frame)
            return None
        if len(known) != 1:
            raise ToolkitError(
                "without metric camera poses a refinement looks at one frame",
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

    def _told(self, snapshot: Snapshot, refined: RefinedPose, alone: int | None) -> tuple[int, SE3]:
        """The frame in which a refined pose is told, and T_cam_obj in it."""
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
    """Poses of all placed objects, by id: in the world, or in the camera of the only frame."""
    poses = {
        o.id: snapshot.T_world_obj(o.name) if alone is None else snapshot.pose(o.name, alone)
        for o in snapshot.state.objects
    }
    return {i: T for i, T in poses.items() if T is not None}


def _line(snapshot: Snapshot, refined: RefinedPose, start: SE3) -> str:
    """What was found for one object, for people."""
    centre = snapshot.centre(snapshot.object(refined.name).model)
    moved = 1000 * float(np.linalg.norm(refined.pose @ centre - start @ centre))
    turned = np.rad2deg(rotation_angle(refined.pose.R @ start.R.T))
    text = f"{refined.name}: moved by {moved:.1f} mm, turned by {turned:.1f} deg; {refined.method}"
    return f"{text}; {refined.weak_direction}" if refined.weak_direction else text
