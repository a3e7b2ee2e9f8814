"""Where the cameras of a scene stood, and what follows for the poses of objects."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from annotator.session.state import AnnotationState
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene
from std_toolkit.scene.metres import require_metres


@dataclass(frozen=True)
class Cameras:
    """Camera poses of a scene, where they are known in metres; immutable.

    Attributes:
        problem: why poses of objects cannot be carried from frame to frame, for people; None if
            they can.
        frames: ids of the frames in which a pose can be set, in recording order.
    """

    problem: str | None
    frames: tuple[int, ...]
    _T_world_cam: dict[int, SE3] = field(repr=False)

    @staticmethod
    def of(scene: Scene) -> Cameras:
        """Raises ToolkitError if poses.json cannot be read."""
        problem = _pose_problem(scene)
        if problem is not None:
            return Cameras(problem, tuple(f.id for f in scene.frames), {})
        known = {f.id: T for f in scene.frames if (T := scene.T_world_cam(f.id)) is not None}
        return Cameras(None, tuple(known), known)

    @property
    def posed(self) -> bool:
        """One pose of an object holds in all frames."""
        return self.problem is None

    @cached_property
    def frame_set(self) -> frozenset[int]:
        return frozenset(self.frames)

    def T_world_cam(self, frame: int) -> SE3 | None:
        """Camera pose in metres; None if there is none."""
        return self._T_world_cam.get(frame)

    def pose(self, state: AnnotationState, name: str, frame: int) -> SE3 | None:
        """T_cam_obj of an object in a frame; None where it has none."""
        placements = state.object(name).placements
        if frame in placements:
            return placements[frame].pose
        T_world_cam, T_world_obj = self.T_world_cam(frame), self.T_world_obj(state, name)
        if T_world_cam is None or T_world_obj is None:
            return None
        return T_world_cam.inverse() @ T_world_obj

    def T_world_obj(self, state: AnnotationState, name: str) -> SE3 | None:
        """World pose of an object; None if it is not placed in a frame with a camera pose."""
        for frame, placement in state.object(name).placements.items():
            T_world_cam = self.T_world_cam(frame)
            if T_world_cam is not None:
                return T_world_cam @ placement.pose
        return None


def _pose_problem(scene: Scene) -> str | None:
    if scene.poses is None or not scene.registered_frames():
        return "The scene has no camera poses, so each frame is labelled on its own."
    try:
        require_metres(scene)
    except ToolkitError:
        return (
            "The camera poses have no unit (no source of metres), so each frame is labelled on "
            "its own."
        )
    return None
