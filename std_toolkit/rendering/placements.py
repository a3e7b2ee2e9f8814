"""Which objects are where in a frame: propagated labels, or the frame's own annotation."""

from __future__ import annotations

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.rendering.protocol import PlacedMesh
from std_toolkit.scene.model import pose_from_list
from std_toolkit.scene.scene import Scene


def frame_placements(scene: Scene, frame_id: int) -> dict[int, SE3]:
    """`T_cam_obj` of every object whose pose is known in a frame, by rising object id.

    A propagated pose comes first. Where there is none (the frame has no camera pose, or the label
    was not propagated) the pose annotated in this very frame counts.
    """
    placements: dict[int, SE3] = {}
    for label in sorted(scene.labels.labels, key=lambda x: x.object):
        pose = scene.T_cam_obj(frame_id, label.object)
        if pose is None and label.frame == frame_id:
            pose = pose_from_list(label.T_cam_obj)
        if pose is None and str(frame_id) in label.views:
            pose = pose_from_list(label.views[str(frame_id)])
        if pose is not None:
            placements[label.object] = pose
    return placements


def labelled_frames(scene: Scene) -> list[int]:
    """Ids of the frames in which at least one object's pose is known.

    Raises:
        ToolkitError: there is none.
    """
    frames = [f.id for f in scene.frames if frame_placements(scene, f.id)]
    if not frames:
        raise ToolkitError(
            "no frame has a labelled object",
            path=scene.root,
            hint="run `std-curate label` and `std-curate propagate` first",
        )
    return frames


def place_meshes(scene: Scene, placements: dict[int, SE3]) -> list[PlacedMesh]:
    """The scene's meshes at the given poses."""
    return [
        PlacedMesh(object_id, scene.mesh(scene.objects.object(object_id).model), pose)
        for object_id, pose in placements.items()
    ]
