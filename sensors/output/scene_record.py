"""Frames received by the writers of a scene, and the record of the scene.

A writer accepts the frames of one scene: each once, all of them, with the same cameras.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from sensors.output.simulated_frame import SimulatedFrame, SimulatedScene
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.jobs.artefact import changed_files
from std_toolkit.scene import model


class ObjectRecord(model.Document, frozen=True, kw_only=True):
    """An object; `instance_id` is its value in masks, `scale_m` its diagonal in metres."""

    instance_id: model.ObjectId
    asset_id: str
    category: str
    class_id: model.Count
    material_class: model.Material
    scale_m: model.Positive
    T_world_obj: model.Pose16


class ViewRecord(model.Document, frozen=True, kw_only=True):
    """A frame: poses of the colour and the left infrared camera."""

    index: model.Count
    T_world_cam: model.Pose16
    T_world_ir: model.Pose16


class SceneRecord(model.Document, frozen=True, kw_only=True):
    """parameters.json of a scene. Metres, OpenCV cameras, pixel centres at integers.

    `K`, `width` and `height` are those of the label maps' camera, so that `std-curate import
    --intrinsics` reads the file unchanged.

    Attributes:
        version_of_tool: of the toolkit that made the scene.
        parameters: everything that the scene was generated from.
        outputs: digest of the content by path of the file, relative to the set (DREDS layouts) or
            to the scene; empty in records of 0.1.0.
        baseline_m: from the left infrared camera to the right one; None with one camera, and in
            records of earlier versions.
    """

    format: Literal["std-sim-scene"] = "std-sim-scene"
    version: Literal[1] = 1
    version_of_tool: str
    name: str
    seed: model.Count
    sensor: str
    width: int
    height: int
    K: list[list[float]]
    color_camera: model.CameraModel
    infrared_camera: model.CameraModel
    depth_camera: model.CameraModel
    objects: list[ObjectRecord]
    frames: list[ViewRecord]
    parameters: dict[str, Any]
    outputs: dict[str, str] = msgspec.field(default_factory=dict)

    def verify(self, root: Path) -> None:
        """Check that the files below `root` are those that were written.

        Raises:
            ToolkitError: a file is missing, or was changed or damaged.
        """
        found = changed_files(root, self.outputs)
        if found:
            more = f", and {len(found) - 1} more files" if len(found) > 1 else ""
            raise ToolkitError(
                f"{found[0]} since the scene was made{more}",
                path=root,
                field=f"scene {self.name}",
                hint="remove the folder of the scene: the same command makes it again",
            )

    baseline_m: float | None = None


def scene_record(received: ReceivedFrames, outputs: Mapping[str, str] | None = None) -> SceneRecord:
    """The record of a scene after all its frames were accepted."""
    scene, cameras = received.scene, received.cameras
    return SceneRecord(
        version_of_tool=__version__,
        name=scene.name,
        seed=scene.seed,
        sensor=scene.sensor,
        width=cameras.label.width,
        height=cameras.label.height,
        K=cameras.label.K.tolist(),
        color_camera=model.CameraModel.of(cameras.color),
        infrared_camera=model.CameraModel.of(cameras.infrared),
        depth_camera=model.CameraModel.of(cameras.depth),
        objects=[
            ObjectRecord(
                instance_id=item.instance_id,
                asset_id=item.asset_id,
                category=item.category,
                class_id=item.class_id,
                material_class=item.material_class,
                scale_m=item.scale_m,
                T_world_obj=item.T_world_obj.flat(),
            )
            for item in scene.objects
        ],
        frames=[
            ViewRecord(index=i, T_world_cam=poses[0].flat(), T_world_ir=poses[1].flat())
            for i, poses in sorted(received.poses.items())
        ],
        parameters=dict(scene.parameters),
        outputs=dict(outputs or {}),
        baseline_m=scene.baseline_m,
    )


class FrameCameras(NamedTuple):
    """Cameras that all frames of a scene share; see `SimulatedFrame`."""

    color: Camera
    label: Camera
    infrared: Camera
    depth: Camera


class ReceivedFrames:
    """State of the frames that a writer has received, in any order.

    Attributes:
        poses: T_world_cam and T_world_ir by frame index.
    """

    def __init__(self, scene: SimulatedScene) -> None:
        self.scene = scene
        self.poses: dict[int, tuple[SE3, SE3]] = {}
        self._cameras: FrameCameras | None = None

    @property
    def cameras(self) -> FrameCameras:
        """The cameras of all frames; raises ToolkitError before the first one."""
        if self._cameras is None:
            raise ToolkitError("no frame was written yet", field=self.scene.name)
        return self._cameras

    def accept(self, frame: SimulatedFrame) -> None:
        """Check a frame against the scene and the frames before it.

        Raises:
            ToolkitError: not of this scene, received before, or with another camera.
        """
        where = f"frame {frame.index}"
        if frame.index not in self.scene.frame_indices:
            raise ToolkitError(f"the scene has {self.scene.frames} frames", field=where)
        if frame.index in self.poses:
            raise ToolkitError("the frame was written before", field=where)
        unknown = set(frame.instances) - {o.instance_id for o in self.scene.objects}
        if unknown:
            raise ToolkitError(
                "the scene has no such object", field=f"{where}: mask", value=sorted(unknown)
            )
        cameras = FrameCameras(
            frame.color_camera, frame.label_camera, frame.infrared_camera, frame.depth_camera
        )
        if self._cameras not in (None, cameras):
            raise ToolkitError("the frames of a scene have the same cameras", field=where)
        self._cameras = cameras
        self.poses[frame.index] = (frame.T_world_cam, frame.T_world_ir)

    def require_all(self) -> None:
        """Raise if frames are missing.

        Raises:
            ToolkitError: some frames were not accepted.
        """
        lost = sorted(set(self.scene.frame_indices) - set(self.poses))
        if lost:
            raise ToolkitError(
                f"{len(lost)} of {self.scene.frames} frames were not written",
                field=self.scene.name,
                value=lost,
            )
