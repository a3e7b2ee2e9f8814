"""Object poses in a frame, and detection of ground truth that no longer matches its inputs.

The inputs are object and camera poses, camera intrinsics, meshes and the depth scale.
"""

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, rotation_angle
from std_toolkit.io.documents import digest_of
from std_toolkit.rendering.ground_truth import FrameTruth
from std_toolkit.rendering.renderer import PlacedMesh
from std_toolkit.scene.model import pose_from_list
from std_toolkit.scene.scene import Scene

# Far below the accuracy of a label, far above the rounding of decimal numbers.
_SAME_M, _SAME_RAD = 1e-6, 1e-6


def frame_placements(scene: Scene, frame_id: int) -> dict[int, SE3]:
    """Return `T_cam_obj` of every object whose pose is known in a frame, in order of object id.

    The propagated pose takes precedence. If there is none (the frame has no camera pose, or the
    label was not propagated), the pose annotated in this frame is used.
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
    """Return the ids of the frames in which the pose of at least one object is known.

    Raises:
        ToolkitError: there is no such frame.
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
    """Return the meshes of the scene at the given poses."""
    return [
        PlacedMesh(object_id, scene.mesh(scene.objects.object(object_id).model), pose)
        for object_id, pose in placements.items()
    ]


def frame_inputs(scene: Scene, frame_id: int) -> dict[str, str]:
    """Return the digests of the inputs but for the poses, independent of the toolkit's version."""
    camera = scene.camera(scene.frame(frame_id))
    values = {
        "camera": [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy,
                   *camera.distortion],
        "depth scale": [scene.info.depth_scale, scene.info.depth_correction],
    }  # fmt: skip
    meshes = {
        f"mesh of object {i}": scene.mesh_digest(scene.objects.object(i).model)
        for i in frame_placements(scene, frame_id)
    }
    return {name: digest_of(v, versioned=False) for name, v in values.items()} | meshes


def truth_is_current(scene: Scene, truth: FrameTruth) -> bool:
    """Return whether a frame was rendered with its current poses, camera and meshes."""
    now = frame_placements(scene, truth.frame)
    then = {row.object: row.pose for row in truth.objects}
    inputs = frame_inputs(scene, truth.frame).items()
    if set(now) != set(then) or any(truth.inputs.get(k) != v for k, v in inputs):
        return False
    return all(
        np.abs(now[i].t - then[i].t).max() <= _SAME_M
        and rotation_angle(now[i].R.T @ then[i].R) <= _SAME_RAD
        for i in now
    )
