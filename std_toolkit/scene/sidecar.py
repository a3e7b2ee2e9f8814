"""std_toolkit.json: what the foreign layouts have no place for.

STD, DREDS and NOCS ship neither intrinsics nor camera poses; no layout tells where its metres
come from or what may hide an object. Loaders of those layouts ignore this file; the importers
read it, so that an export can become a scene again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from std_toolkit.io.documents import read_document
from std_toolkit.scene.document import check_relative
from std_toolkit.scene.model import (
    CameraModel,
    CameraPoses,
    Document,
    Labels,
    NonNegative,
    ObjectId,
    ObjectTable,
    Pose16,
    Positive,
    SceneInfo,
    Vector3,
)

SIDECAR_NAME = "std_toolkit.json"


class ExportedObject(Document, frozen=True, kw_only=True):
    """One object in one frame.

    Attributes:
        object: object id.
        mask_id: its value in the layout's mask (BOP: its index in scene_gt).
        T_cam_obj: mesh frame (of the scene, not recentred) to camera, metres.
        visible_fraction: visible pixels over all pixels of its silhouette on a 3x3 canvas.
    """

    object: ObjectId
    mask_id: int
    T_cam_obj: Pose16
    visible_fraction: NonNegative


class ExportedFrame(Document, frozen=True, kw_only=True):
    """One frame of the export.

    Attributes:
        id, name, camera, timestamp: as in the scene.
        stem: what the layout's file names start with.
        T_world_cam: camera pose, metres; null where the frame was not registered.
        sensor_depth: false where the layout's depth file is a placeholder of zeros.
    """

    id: int
    name: str
    stem: str
    camera: str
    timestamp: float | None
    T_world_cam: Pose16 | None
    sensor_depth: bool
    objects: list[ExportedObject]


class LeftOut(Document, frozen=True, kw_only=True):
    """A frame of the scene that was not exported, and why."""

    id: int
    name: str
    reason: str


class ExportedModel(Document, frozen=True, kw_only=True):
    """How a mesh of the scene became a mesh of the layout.

    `p_scene = metres_per_unit * p_layout + centre_m`, both in their mesh frames.

    Attributes:
        model: model id.
        layout_id: the layout's own name or number of it.
        path: of the layout's mesh, relative to the export.
        diagonal_m: bounding-box diagonal: the NOCS scale.
    """

    model: str
    layout_id: str
    path: str
    metres_per_unit: Positive
    centre_m: Vector3
    diagonal_m: Positive


class Visibility(Document, frozen=True, kw_only=True):
    """What decided about visible pixels.

    Attributes:
        policy: "models", "sensor" or "fused"; see data_spec.md.
        delta_m: tolerance in metres of distance (not z); null for "models".
        renderer: that drew the ground truth.
        pixel_centres: of masks, depth and K alike.
    """

    policy: str
    delta_m: float | None
    renderer: str
    pixel_centres: Literal["integer"] = "integer"


class Sidecar(Document, frozen=True, kw_only=True):
    """std_toolkit.json at the top of an export; written last.

    Attributes:
        layout: exporter's name.
        folder: of the scene's frames, relative to the export.
        version: of the toolkit.
        digest: of everything that determines the export.
        scene: with the cameras of the exported colour images (pinholes: images were undistorted).
        label_cameras: camera of the exported labels, where their size differs from colour.
        poses: of the exported frames, with their scale report and gates.
        quaternion: convention of quaternions in the layout's own files, if it has any.
        files: every file of the export relative to it, to digest of its content.
    """

    format: Literal["std-toolkit-export"] = "std-toolkit-export"
    format_version: Literal[1] = 1
    layout: str
    folder: str
    version: str
    digest: str
    scene: SceneInfo
    label_cameras: dict[str, CameraModel]
    frames: list[ExportedFrame]
    left_out: list[LeftOut]
    models: list[ExportedModel]
    objects: ObjectTable
    labels: Labels
    poses: CameraPoses | None
    visibility: list[Visibility]
    quaternion: str | None = None
    files: dict[str, str]

    def model(self, model_id: str) -> ExportedModel | None:
        return next((m for m in self.models if m.model == model_id), None)


def find_sidecar(source: Path, layout: str) -> tuple[Sidecar, Path] | None:
    """The sidecar that tells of `source`, and the export's top folder.

    Args:
        source: an export, or the folder of its frames.
        layout: a sidecar of another layout counts as none.

    Raises:
        ToolkitError: there is one, but it is damaged.
    """
    start = source.resolve()
    for top in (start, *list(start.parents)[:3]):
        path = top / SIDECAR_NAME
        if path.is_file():
            sidecar = read_document(path, Sidecar)
            folder = check_relative(sidecar.folder, path=path, field="folder")
            # Something else may have been put below an export.
            told = start in (top, top / folder)
            return (sidecar, top) if told and sidecar.layout == layout else None
    return None
