"""Which entries of a BOP scene's ground truth are the same physical object.

BOP numbers kinds of objects, not objects: two cans have one obj_id, and the order in a frame need
not be that of another frame. Where the camera poses are known, entries whose poses agree in the
world are one object. Elsewhere entries count as one object when they are the k-th of their kind.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.sidecar import Sidecar
from std_toolkit.geometry.se3 import SE3
from std_toolkit.importers.bop_documents import BopScene
from std_toolkit.scene.model import Label, Labels, Material, Object

# Label noise of BOP's own sets is a few millimetres; two objects are farther apart.
_SAME_PLACE_M = 0.02
_MOST_OBJECTS = 254


@dataclass(frozen=True)
class Instances:
    """Objects and labels of a scene."""

    objects: tuple[Object, ...] = ()
    labels: Labels | None = None
    notes: tuple[str, ...] = ()


@dataclass
class _Track:
    """One object over the frames in which it was seen."""

    obj_id: int
    T_cam_obj: dict[int, SE3] = field(default_factory=dict)
    T_world_obj: dict[int, SE3] = field(default_factory=dict)

    def typical(self) -> SE3:
        """The world pose nearest to the median place: one that was really annotated."""
        frames = sorted(self.T_world_obj)
        places = np.array([self.T_world_obj[f].t for f in frames])
        off = np.linalg.norm(places - np.median(places, axis=0), axis=1)
        return self.T_world_obj[frames[int(np.argmin(off))]]


def find_instances(
    scene: BopScene,
    T_world_cam: dict[int, SE3],
    model_ids: dict[int, str],
    material: Material,
) -> Instances:
    """Objects of a data set that is not the toolkit's own.

    Args:
        T_world_cam: camera poses by image id; images without one are missing.
        model_ids: by obj_id.
        material: of all objects.

    Raises:
        ToolkitError: more objects than a mask can hold.
    """
    if not scene.gt:
        return Instances()
    tracks: list[_Track] = []
    for im_id in sorted(scene.gt):
        seen_of_kind: dict[int, int] = {}
        taken: set[int] = set()
        for row in scene.gt[im_id]:
            order = seen_of_kind.get(row.obj_id, 0)
            seen_of_kind[row.obj_id] = order + 1
            T_cam_obj = row.T_cam_obj
            camera = T_world_cam.get(im_id)
            T_world_obj = None if camera is None else camera @ T_cam_obj
            index = _match(tracks, row.obj_id, order, T_world_obj, taken)
            if index is None:
                tracks.append(_Track(row.obj_id))
                index = len(tracks) - 1
            taken.add(index)
            tracks[index].T_cam_obj[im_id] = T_cam_obj
            if T_world_obj is not None:
                tracks[index].T_world_obj[im_id] = T_world_obj
    if len(tracks) > _MOST_OBJECTS:
        raise ToolkitError(
            "more objects than a mask can hold; do they move?",
            path=scene.folder / "scene_gt.json",
            value=len(tracks),
        )
    objects, labels, notes = [], [], []
    order_of: dict[int, int] = {}
    for i, track in enumerate(tracks):
        order_of[track.obj_id] = order_of.get(track.obj_id, 0) + 1
        thing = Object(
            id=i + 1,
            name=f"{model_ids[track.obj_id]}_{order_of[track.obj_id]}",
            model=model_ids[track.obj_id],
            material=material,
        )
        objects.append(thing)
        labels.append(_label(track, thing.id))
    if not T_world_cam:
        notes.append("no camera poses (cam_R_w2c): labels stay in their frames, as views")
    return Instances(tuple(objects), Labels(labels=labels), tuple(notes))


def instances_from_sidecar(
    scene: BopScene,
    sidecar: Sidecar,
    T_world_cam: dict[int, SE3],
    centres: dict[int, NDArray[np.float64]],
) -> Instances:
    """Objects of the toolkit's own export: identity from the sidecar, poses from BOP's files.

    Raises:
        ToolkitError: the sidecar and scene_gt.json do not fit each other.
    """
    seen: dict[int, dict[int, SE3]] = {}
    for frame in sidecar.frames:
        rows = scene.gt.get(frame.id, [])
        for entry in frame.objects:
            if not 0 <= entry.mask_id < len(rows):
                raise ToolkitError(
                    "scene_gt.json has fewer entries than std_toolkit.json tells",
                    path=scene.folder / "scene_gt.json",
                    field=str(frame.id),
                    value=len(rows),
                )
            row = rows[entry.mask_id]
            pose = row.T_cam_obj
            moved = SE3(pose.R, pose.t - pose.R @ centres[row.obj_id])
            seen.setdefault(entry.object, {})[frame.id] = moved
    labels = []
    for label in sidecar.labels.labels:
        poses = seen.get(label.object, {})
        registered = [f for f in sorted(poses) if f in T_world_cam]
        T_world_obj = label.T_world_obj
        if label.T_world_obj is not None and registered:
            T_world_obj = (T_world_cam[registered[0]] @ poses[registered[0]]).flat()
        annotated = label.T_cam_obj
        # A label was carried to its own frame only when it was propagated; the annotated pose
        # and the refined one differ there, and the sidecar holds the former.
        if label.T_world_obj is None and label.frame in poses:
            annotated = poses[label.frame].flat()
        labels.append(msgspec.structs.replace(label, T_cam_obj=annotated, T_world_obj=T_world_obj))
    return Instances(tuple(sidecar.objects.objects), Labels(labels=labels))


def _match(
    tracks: list[_Track], obj_id: int, order: int, T_world_obj: SE3 | None, taken: set[int]
) -> int | None:
    """The track that an entry belongs to, or None for a new object."""
    same_kind = [i for i, t in enumerate(tracks) if t.obj_id == obj_id]
    if T_world_obj is None:
        return same_kind[order] if order < len(same_kind) else None
    free = [i for i in same_kind if i not in taken and tracks[i].T_world_obj]
    distance = {i: float(np.linalg.norm(tracks[i].typical().t - T_world_obj.t)) for i in free}
    near = min(distance, key=lambda i: distance[i], default=None)
    return near if near is not None and distance[near] < _SAME_PLACE_M else None


def _label(track: _Track, object_id: int) -> Label:
    first = min(track.T_cam_obj)
    if track.T_world_obj:
        return Label(
            object=object_id,
            frame=first,
            T_cam_obj=track.T_cam_obj[first].flat(),
            T_world_obj=track.typical().flat(),
            method="import:bop",
        )
    return Label(
        object=object_id,
        frame=first,
        T_cam_obj=track.T_cam_obj[first].flat(),
        method="import:bop",
        views={str(f): T.flat() for f, T in sorted(track.T_cam_obj.items()) if f != first},
    )
