"""What every layout's frame row has in common."""

from __future__ import annotations

from std_toolkit.exporters.protocol import Target
from std_toolkit.exporters.sidecar import ExportedFrame, ExportedObject
from std_toolkit.rendering.ground_truth import FrameTruth
from std_toolkit.scene.model import Frame


def exported_frame(
    target: Target, frame: Frame, truth: FrameTruth, *, stem: str, mask_ids: dict[int, int]
) -> ExportedFrame:
    """The sidecar's entry of a frame.

    Args:
        stem: what the layout's file names start with.
        mask_ids: object id to its value (or index) in the layout.
    """
    T_world_cam = target.scene.T_world_cam(frame.id)
    return ExportedFrame(
        id=frame.id,
        name=frame.name,
        stem=stem,
        camera=frame.camera,
        timestamp=frame.timestamp,
        T_world_cam=None if T_world_cam is None else T_world_cam.flat(),
        sensor_depth=frame.depth is not None,
        objects=[
            ExportedObject(
                object=row.object,
                mask_id=mask_ids[row.object],
                T_cam_obj=row.T_cam_obj,
                visible_fraction=row.visible_fraction,
            )
            for row in truth.objects
        ],
    )
