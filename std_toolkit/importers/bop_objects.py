"""Objects of a BOP data set: models in millimetres, and the poses that belong to each object.

BOP ids are ids of models, not of instances: two cans have one obj_id, and the order can differ
between frames. With camera poses, entries whose world poses agree are one object. Without them,
the k-th entries of a model are one object.

The models are PLY in millimetres, with symmetries from models_info.json.
"""

from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.se3 import SE3
from std_toolkit.importers import bop_documents, foreign_files, importer
from std_toolkit.io.documents import read_document
from std_toolkit.scene.model import (
    ContinuousSymmetry,
    Label,
    Labels,
    Material,
    Object,
    SymmetryModel,
)
from std_toolkit.scene.sidecar import Sidecar

# Label noise of the BOP data sets is a few millimetres; two objects are farther apart.
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
    """One object over the frames that show it."""

    obj_id: int
    T_cam_obj: dict[int, SE3] = field(default_factory=dict)
    T_world_obj: dict[int, SE3] = field(default_factory=dict)

    def typical(self) -> SE3:
        """The annotated world pose nearest to the median position."""
        frames = sorted(self.T_world_obj)
        places = np.array([self.T_world_obj[f].t for f in frames])
        off = np.linalg.norm(places - np.median(places, axis=0), axis=1)
        return self.T_world_obj[frames[int(np.argmin(off))]]


def find_instances(
    scene: bop_documents.BopScene,
    T_world_cam: dict[int, SE3],
    model_ids: dict[int, str],
    material: Material,
) -> Instances:
    """Objects of a data set that the toolkit did not export.

    Args:
        T_world_cam: camera poses by image id; images without one are missing.
        model_ids: by obj_id.
        material: material of all objects.

    Raises:
        ToolkitError: more objects than a mask can represent.
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
            "more objects than a mask can represent; do they move?",
            path=scene.folder / "scene_gt.json",
            value=len(tracks),
        )
    objects, labels, notes = [], [], []
    order_of: dict[int, int] = {}
    for i, track in enumerate(tracks):
        order_of[track.obj_id] = order_of.get(track.obj_id, 0) + 1
        obj = Object(
            id=i + 1,
            name=f"{model_ids[track.obj_id]}_{order_of[track.obj_id]}",
            model=model_ids[track.obj_id],
            material=material,
        )
        objects.append(obj)
        labels.append(_label(track, obj.id))
    if not T_world_cam:
        notes.append("no camera poses (cam_R_w2c): labels are imported as views of single frames")
    return Instances(tuple(objects), Labels(labels=labels), tuple(notes))


def instances_from_sidecar(
    scene: bop_documents.BopScene,
    sidecar: Sidecar,
    T_world_cam: dict[int, SE3],
    centres: dict[int, NDArray[np.float64]],
) -> Instances:
    """Objects of a toolkit export: identity from the sidecar, poses from BOP's files.

    Raises:
        ToolkitError: the sidecar and scene_gt.json are inconsistent.
    """
    seen: dict[int, dict[int, SE3]] = {}
    for frame in sidecar.frames:
        rows = scene.gt.get(frame.id, [])
        for entry in frame.objects:
            if not 0 <= entry.mask_id < len(rows):
                raise ToolkitError(
                    "scene_gt.json has fewer entries than std_toolkit.json lists",
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
        # A label has a pose in its own frame only if it was propagated; the annotated pose
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


def read_models(
    top: Path, folder: Path, numbers: list[int], sidecar: Sidecar | None
) -> tuple[dict[int, importer.SourceModel], dict[int, NDArray[np.float64]]]:
    """Models by obj_id, and the scene's mesh origin before BOP's recentring.

    Args:
        top: folder of the data set, for error messages.
        folder: folder of the models.
        numbers: obj_ids that the scene needs.
        sidecar: of a toolkit export: model ids, categories and mesh origins.

    Returns:
        Models in metres, and per obj_id the (3,) offset in metres such that
        `p_scene = p_bop + offset`.

    Raises:
        ToolkitError: models are missing or damaged.
    """
    if not numbers:
        return {}, {}
    info_path = folder / "models_info.json"
    if not folder.is_dir():
        raise ToolkitError(
            "the models of the data set are missing", path=folder, hint="give --models DIR"
        )
    infos = (
        read_document(info_path, dict[str, bop_documents.ModelInfo]) if info_path.is_file() else {}
    )
    models, centres = {}, {}
    for number in numbers:
        exported = None
        if sidecar is not None:
            exported = next((m for m in sidecar.models if m.layout_id == str(number)), None)
            if exported is None:
                raise ToolkitError("std_toolkit.json lacks a model", path=top, value=number)
        centre = np.zeros(3) if exported is None else np.asarray(exported.centre_m)
        mesh = load_mesh(folder / f"obj_{number:06d}.ply", unit="mm")
        mesh.vertices = np.asarray(mesh.vertices) + centre
        known = None
        if sidecar is not None and exported is not None:
            known = sidecar.objects.model(exported.model)
        with located(info_path, str(number)):
            symmetry = symmetry_of(infos.get(str(number)), centre)
        model = foreign_files.model_of_mesh(
            mesh,
            model_id=known.id if known else f"obj_{number:06d}",
            category=known.category if known else "other",
            class_id=known.class_id if known else 0,
            symmetry=symmetry,
            suffix=foreign_files.mesh_suffix(mesh),
        )
        models[number] = importer.SourceModel(model=model, mesh=mesh)
        centres[number] = centre
    return models, centres


def symmetry_of(info: bop_documents.ModelInfo | None, centre: NDArray[np.float64]) -> SymmetryModel:
    """Symmetries in the scene's mesh frame, metres."""
    if info is None:
        return SymmetryModel()
    discrete = []
    for T in info.symmetries_discrete:
        M = np.asarray(T, dtype=np.float64).reshape(4, 4).copy()
        M[:3, 3] *= bop_documents.MM
        S = SE3.from_matrix(M)
        discrete.append(SE3(S.R, S.t + centre - S.R @ centre).flat())
    continuous = []
    for c in info.symmetries_continuous:
        axis = np.asarray(c.axis, dtype=np.float64)
        length = float(np.linalg.norm(axis))
        if not np.isfinite(length) or length == 0:
            raise ToolkitError("a symmetry axis has no direction", value=c.axis)
        offset = np.asarray(c.offset, dtype=np.float64) * bop_documents.MM + centre
        continuous.append(
            ContinuousSymmetry(
                axis=[float(x) for x in axis / length], offset=[float(x) for x in offset]
            )
        )
    return SymmetryModel(discrete=discrete, continuous=continuous)
