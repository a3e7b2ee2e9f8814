"""The full record of a simulated scene: what it was made from, and what the layouts cannot hold."""

from __future__ import annotations

from typing import Any, Literal

from sensors.output.intake import Intake
from std_toolkit import __version__
from std_toolkit.scene.model import (
    CameraModel,
    Count,
    Document,
    Material,
    ObjectId,
    Pose16,
    Positive,
)


class ObjectRecord(Document, frozen=True, kw_only=True):
    """An object; `instance_id` is its value in masks, `scale_m` its diagonal in metres."""

    instance_id: ObjectId
    asset_id: str
    category: str
    class_id: Count
    material_class: Material
    scale_m: Positive
    T_world_obj: Pose16


class ViewRecord(Document, frozen=True, kw_only=True):
    """A frame: poses of the colour and the left infrared camera, and the objects left out."""

    index: Count
    T_world_cam: Pose16
    T_world_ir: Pose16
    hidden: list[ObjectId]


class SceneRecord(Document, frozen=True, kw_only=True):
    """parameters.json of a scene. Metres, OpenCV cameras, pixel centres at integers.

    `K`, `width` and `height` are the label maps' camera, so that `std-curate import --intrinsics`
    takes the file as it is.

    Attributes:
        version_of_tool: of the toolkit that made the scene.
        parameters: everything that the scene was drawn from.
    """

    format: Literal["std-sim-scene"] = "std-sim-scene"
    version: Literal[1] = 1
    version_of_tool: str
    name: str
    seed: Count
    sensor: str
    width: int
    height: int
    K: list[list[float]]
    color_camera: CameraModel
    infrared_camera: CameraModel
    depth_camera: CameraModel
    objects: list[ObjectRecord]
    frames: list[ViewRecord]
    parameters: dict[str, Any]


def scene_record(intake: Intake) -> SceneRecord:
    """The record of a scene of which all frames were taken in."""
    scene, label = intake.scene, intake.label_camera
    return SceneRecord(
        version_of_tool=__version__,
        name=scene.name,
        seed=scene.seed,
        sensor=scene.sensor,
        width=label.width,
        height=label.height,
        K=label.K.tolist(),
        color_camera=CameraModel.of(intake.color_camera),
        infrared_camera=CameraModel.of(intake.infrared_camera),
        depth_camera=CameraModel.of(intake.depth_camera),
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
            ViewRecord(
                index=i,
                T_world_cam=poses[0].flat(),
                T_world_ir=poses[1].flat(),
                hidden=list(intake.hidden[i]),
            )
            for i, poses in sorted(intake.poses.items())
        ],
        parameters=dict(scene.parameters),
    )
