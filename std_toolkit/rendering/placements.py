"""Object poses in a frame, and detection of ground truth that no longer matches its inputs.

The inputs are object and camera poses, camera intrinsics, meshes and the depth scale.
"""

import os
from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, rotation_angle
from std_toolkit.io.documents import digest_of
from std_toolkit.rendering.ground_truth import FrameTruth, info_name, read_frame_truth
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


class _Row(msgspec.Struct):
    object: int
    T_cam_obj: Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]


class _Truth(msgspec.Struct):
    """The part of a `FrameTruth` that tells whether it is current; the rest is not checked."""

    inputs: dict[str, str]
    objects: list[_Row]


# That a record of a frame is read of in one go; one that is longer is read as a document.
_MOST_BYTES = 2**15

_decoder = msgspec.json.Decoder(_Truth)


def current_truths(scene: Scene, frames: Sequence[int]) -> int:
    """Return how many of some rendered frames pass `truth_is_current`, in a tenth of its time.

    Raises:
        ToolkitError: the record of a frame is damaged.
    """
    labels = {label.object: label.T_world_obj for label in scene.labels.labels}
    placed = {i: np.reshape(T, (4, 4)) for i, T in labels.items() if T is not None}
    cameras = {p.frame: p.T_world_cam for p in scene.poses.frames} if scene.poses else {}
    inputs: dict[str, dict[str, str]] = {}
    found, then, now, folder = 0, [], [], str(scene.root)
    for frame_id in frames:
        T_world_cam = cameras.get(frame_id)
        truth = _read(folder, frame_id)
        if T_world_cam is None or len(placed) < len(labels) or truth is None:
            # A pose of this frame alone may count.
            found += truth_is_current(scene, read_frame_truth(scene, frame_id))
            continue
        camera = scene.frame(frame_id).camera
        if camera not in inputs:
            inputs[camera] = frame_inputs(scene, frame_id)
        rows = {row.object: row.T_cam_obj for row in truth.objects}
        if rows.keys() == placed.keys() and inputs[camera].items() <= truth.inputs.items():
            then.append([rows[i] for i in placed])
            now.append(T_world_cam)
    if now and placed:
        T_cam_obj = _in_cameras(np.reshape(now, (-1, 1, 4, 4)), np.stack([*placed.values()]))
        apart = np.abs(T_cam_obj - np.reshape(then, T_cam_obj.shape))
        # A turn by a small angle changes the entries of a rotation by its square root of two.
        turned = np.sqrt((apart[..., :3, :3] ** 2).sum((-1, -2)) / 2)
        same = (apart[..., :3, 3].max(-1) <= _SAME_M) & (turned <= _SAME_RAD)
        found += int(same.all(1).sum())
    return found + (len(now) if not placed else 0)


def _read(folder: str, frame_id: int) -> _Truth | None:
    try:
        file = os.open(info_name(folder, frame_id), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            return _decoder.decode(os.read(file, _MOST_BYTES))
        finally:
            os.close(file)
    except (OSError, ValueError, RecursionError):  # also errors of msgspec, of one that is longer
        return None


def _in_cameras(T_world_cam: NDArray[np.float64], T_world_obj: NDArray[np.float64]) -> NDArray:
    """Return (N, K, 4, 4) T_cam_obj of (N, 1, 4, 4) camera and (K, 4, 4) object poses."""
    R = np.swapaxes(T_world_cam[..., :3, :3], -1, -2)
    T = np.zeros((len(T_world_cam), len(T_world_obj), 4, 4))
    T[..., :3, :3] = R @ T_world_obj[:, :3, :3]
    T[..., :3, 3:] = R @ (T_world_obj[:, :3, 3:] - T_world_cam[..., :3, 3:])
    T[..., 3, 3] = 1
    return T
