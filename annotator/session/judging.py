"""The verdicts on placed objects, by the judge of `std-curate check`, and those that are stored."""

from __future__ import annotations

import msgspec
import numpy as np

from annotator.session.state import Judged, Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene import CameraPoses, FramePose, Label, Labels, Scene
from std_toolkit.scene.label_verdicts import judgement_inputs
from std_toolkit.scene.memory_scene import MemoryScene


def judged_scene(snapshot: Snapshot, frame: int, stored: Labels | None = None) -> Scene:
    """The scene with its objects at their present poses, as the check reads it.

    Without metric camera poses it has one frame, whose camera is the world.

    Args:
        snapshot: the annotations.
        frame: frame that counts without metric camera poses.
        stored: labels on disk, with what refinement found; used where the pose is the same.
    """
    scene, poses = snapshot.scene, None
    if not snapshot.posed:
        rows = [
            FramePose(
                frame=f.id,
                status="registered" if f.id == frame else "unregistered",
                T_world_cam=SE3.identity().flat() if f.id == frame else None,
            )
            for f in scene.frames
        ]
        cameras = scene.poses.cameras if scene.poses is not None else {}
        poses = CameraPoses(frames=rows, cameras=cameras, source="one image")
    labels, meshes = [], {}
    for obj in snapshot.state.objects:
        T = snapshot.T_world_obj(obj.name) if snapshot.posed else snapshot.pose(obj.name, frame)
        if T is None:
            continue
        try:
            meshes[obj.model] = snapshot.mesh(obj.model)
        except ToolkitError:  # the check says so, too
            continue
        known = None if stored is None else stored.of(obj.id)
        if known is not None and snapshot.posed and _is_at(known, T):
            labels.append(known)
            continue
        first = next(iter(obj.placements)) if snapshot.posed else frame
        in_camera = snapshot.pose(obj.name, first)
        assert in_camera is not None
        labels.append(
            Label(object=obj.id, frame=first, T_cam_obj=in_camera.flat(), T_world_obj=T.flat())
        )
    return MemoryScene(scene, labels=Labels(labels=labels), poses=poses, meshes=meshes)


def _is_at(label: Label, T_world_obj: SE3) -> bool:
    if label.T_world_obj is None:
        return False
    # Poses go through the camera of a frame and back.
    return bool(np.abs(np.subtract(label.T_world_obj, T_world_obj.flat())).max() < 1e-9)


def frame_of(snapshot: Snapshot, name: str, frame: int) -> int:
    """The frame in which an object is judged without metric camera poses: this one if placed."""
    placements = snapshot.object(name).placements
    return frame if frame in placements else next(iter(placements), frame)


def stored_judgements(snapshot: Snapshot, labels: Labels) -> dict[str, Judged]:
    """The judgements in labels.json and annotation.json that hold for the present poses.

    Reads no image. Of two, the newer one counts.

    Args:
        snapshot: the annotations, with the judgements of annotation.json.
        labels: of the scene on disk.

    Returns:
        By name of the object.
    """
    found: dict[str, Judged] = {}
    inputs: dict[tuple[tuple[str, float], ...], dict[int, str]] = {}
    for obj in snapshot.state.objects:
        known: list[Judged] = []
        label, mine = labels.of(obj.id), snapshot.judgement(obj.name)
        if label is not None and not isinstance(label.judgement, msgspec.UnsetType):
            known.append(Judged(label.judgement))
        if mine is not None:
            known.append(Judged(mine, next(iter(obj.placements))))
        for judged in sorted(known, key=lambda j: j.judgement.time):
            frame = judged.frame
            T = snapshot.T_world_obj(obj.name) if frame is None else snapshot.pose(obj.name, frame)
            if T is None:
                continue
            limits = judged.judgement.limits  # of its check, which holds here, too
            if snapshot.posed:
                key = tuple(sorted(limits.items()))
                inputs[key] = inputs.get(key) or judgement_inputs(snapshot.scene, limits)
                now = inputs[key][obj.id]
            else:
                now = judgement_inputs(judged_scene(snapshot, frame or 0), limits)[obj.id]
            if judged.judgement.is_current(T, now):
                found[obj.name] = judged
    return found
