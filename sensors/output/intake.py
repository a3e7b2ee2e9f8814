"""Takes in the frames of one scene: each once, all of them, and of the same cameras."""

from __future__ import annotations

from sensors.output.frame import SimulatedFrame, SimulatedScene
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3


class Intake:
    """What a writer knows of the frames that it was given, in any order.

    Attributes:
        poses: T_world_cam and T_world_ir by frame index.
        hidden: instance ids left out, by frame index.
    """

    def __init__(self, scene: SimulatedScene) -> None:
        self.scene = scene
        self.poses: dict[int, tuple[SE3, SE3]] = {}
        self.hidden: dict[int, tuple[int, ...]] = {}
        self._cameras: tuple[Camera, Camera, Camera, Camera] | None = None

    @property
    def color_camera(self) -> Camera:
        return self._known()[0]

    @property
    def label_camera(self) -> Camera:
        return self._known()[1]

    @property
    def infrared_camera(self) -> Camera:
        return self._known()[2]

    @property
    def depth_camera(self) -> Camera:
        return self._known()[3]

    def accept(self, frame: SimulatedFrame) -> None:
        """Check a frame against the scene and the frames before it.

        Raises:
            ToolkitError: not of this scene, here already, or seen by another camera.
        """
        where = f"frame {frame.index}"
        if frame.index >= self.scene.frames:
            raise ToolkitError(f"the scene has {self.scene.frames} frames", field=where)
        if frame.index in self.poses:
            raise ToolkitError("the frame was written before", field=where)
        known = {o.instance_id for o in self.scene.objects}
        seen, hidden = set(frame.instances), set(frame.hidden)
        for what, ids in (("mask", seen), ("hidden", hidden)):
            if ids - known:
                raise ToolkitError(
                    "the scene has no such object",
                    field=f"{where}: {what}",
                    value=sorted(ids - known),
                )
        if hidden & seen:
            raise ToolkitError(
                "an object that was left out is seen",
                field=f"{where}: hidden",
                value=sorted(hidden & seen),
            )
        cameras = (
            frame.color_camera,
            frame.label_camera,
            frame.infrared_camera,
            frame.depth_camera,
        )
        if self._cameras not in (None, cameras):
            raise ToolkitError("the frames of a scene have the same cameras", field=where)
        self._cameras = cameras
        self.poses[frame.index] = (frame.T_world_cam, frame.T_world_ir)
        self.hidden[frame.index] = tuple(sorted(hidden))

    def require_all(self) -> None:
        """Refuse a scene that lacks frames.

        Raises:
            ToolkitError: some were not accepted.
        """
        lost = sorted(set(range(self.scene.frames)) - set(self.poses))
        if lost:
            raise ToolkitError(
                f"{len(lost)} of {self.scene.frames} frames were not written",
                field=self.scene.name,
                value=lost,
            )

    def _known(self) -> tuple[Camera, Camera, Camera, Camera]:
        if self._cameras is None:
            raise ToolkitError("no frame was written yet", field=self.scene.name)
        return self._cameras
