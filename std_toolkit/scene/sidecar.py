"""std_toolkit.json: data of an export that the layouts of other data sets cannot represent.

It lies at the top of an export of one scene, and in the folder of each scene of a data set of many.

STD, DREDS and NOCS have neither intrinsics nor camera poses. No layout stores the source of the
metric scale or the occlusion policy. Loaders of those layouts ignore this file; the importers read
it, so that an export can be converted back to a scene.
"""

from pathlib import Path
from typing import Literal

import msgspec

from std_toolkit.io.documents import read_document
from std_toolkit.scene.check_flags import FailedGate
from std_toolkit.scene.document import check_relative
from std_toolkit.scene.judgement import Grade
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
        mask_id: value in the mask of the layout (BOP: index in scene_gt).
        T_cam_obj: mesh frame (of the scene, not recentred) to camera, metres.
        visible_fraction: visible pixels over all pixels of the silhouette on a 3x3 canvas.
        fault: why the label does not fit in this frame, "" if it does, null without a check.
    """

    object: ObjectId
    mask_id: int
    T_cam_obj: Pose16
    visible_fraction: NonNegative
    fault: str | None = None


class LeftOutObject(Document, frozen=True, kw_only=True):
    """An object that was not exported, in all frames or in one, and the reason.

    Its pixels are background; what it hides is hidden still.
    """

    object: ObjectId
    name: str
    reason: str


class ExportedFrame(Document, frozen=True, kw_only=True):
    """One frame of the export.

    Attributes:
        id, name, camera, timestamp: as in the scene.
        stem: prefix of the file names in the layout.
        T_world_cam: camera pose, metres; null if the frame was not registered.
        sensor_depth: false if the depth file of the layout is a placeholder of zeros.
        objects: the objects in the frame.
        fault: what is wrong with the frame, "" if nothing is, null without a current check.
        left_out: objects that are left out of this frame only.
    """

    id: int
    name: str
    stem: str
    camera: str
    timestamp: float | None
    T_world_cam: Pose16 | None
    sensor_depth: bool
    objects: list[ExportedObject]
    fault: str | None = None
    left_out: list[LeftOutObject] = msgspec.field(default_factory=list)


class LeftOut(Document, frozen=True, kw_only=True):
    """A frame of the scene that was not exported, and the reason."""

    id: int
    name: str
    reason: str


class ExportedModel(Document, frozen=True, kw_only=True):
    """Relation between a mesh of the scene and the mesh of the layout.

    `p_scene = metres_per_unit * p_layout + centre_m`, each in its mesh frame.

    Attributes:
        model: model id.
        layout_id: name or number of the model in the layout.
        path: path of the mesh of the layout, relative to the export.
        diagonal_m: bounding-box diagonal (the NOCS scale), metres.
    """

    model: str
    layout_id: str
    path: str
    metres_per_unit: Positive
    centre_m: Vector3
    diagonal_m: Positive


class Visibility(Document, frozen=True, kw_only=True):
    """How the visible pixels were determined.

    Attributes:
        policy: "models", "sensor" or "fused"; see data_spec.md.
        delta_m: tolerance in metres of distance (not z); null for "models".
        renderer: renderer of the ground truth.
        pixel_centres: pixel convention of masks, depth and K.
    """

    policy: str
    delta_m: float | None
    renderer: str
    pixel_centres: Literal["integer"] = "integer"


class LabelQuality(Document, frozen=True, kw_only=True):
    """The verdict of the check on one label of the scene.

    Attributes:
        object, name: as in objects.json.
        grade: "unknown" also for a label that was not checked, or changed since.
        probability: that the pose lies within the limits of the check; null if it is not known.
        deviation_mm, deviation_deg: standard deviation of the measured pose along its weakest
            direction; null if it is not known.
        reason: one sentence.
        failed_gates: keys of the gates that the label fails.
    """

    object: ObjectId
    name: str
    grade: Grade
    probability: float | None
    deviation_mm: float | None
    deviation_deg: float | None
    reason: str
    failed_gates: list[str]


class Quality(Document, frozen=True, kw_only=True):
    """What the check says of the scene at the time of the export.

    Attributes:
        checked: whether there was a report of the present labels, camera poses and meshes.
        failed_gates: gates of the scene that failed.
        labels: one row per labelled object of the scene, also of those that were left out.
    """

    checked: bool
    failed_gates: list[FailedGate]
    labels: list[LabelQuality]


class Sidecar(Document, frozen=True, kw_only=True):
    """std_toolkit.json at the top of an export; written last.

    Attributes:
        layout: name of the exporter.
        folder: folder of the frames, relative to the export.
        version: version of the toolkit.
        digest: digest of everything that determines the export.
        scene: scene.json with the cameras of the exported colour images (pinholes, because images
            are undistorted).
        label_cameras: cameras of the exported labels, if their size differs from colour.
        poses: poses of the exported frames, with scale report and gates.
        quaternion: convention of quaternions in the files of the layout, if it has any.
        left_out_objects: objects that are left out of all frames.
        quality: verdicts on the labels; absent in exports of earlier versions.
        files: digest of the content of every file by path relative to the export.
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
    left_out_objects: list[LeftOutObject] = msgspec.field(default_factory=list)
    quality: Quality | msgspec.UnsetType = msgspec.UNSET
    files: dict[str, str]

    def model(self, model_id: str) -> ExportedModel | None:
        return next((m for m in self.models if m.model == model_id), None)


def find_sidecar(source: Path, layout: str) -> tuple[Sidecar, Path] | None:
    """Return the sidecar that describes `source`, and the top folder of the export.

    Args:
        source: an export, or the folder of its frames.
        layout: name of the layout; sidecars of other layouts are ignored.

    Raises:
        ToolkitError: the sidecar is damaged.
    """
    start = source.resolve()
    for folder in (start, *list(start.parents)[:3]):
        path = folder / SIDECAR_NAME
        if path.is_file():
            sidecar = read_document(path, Sidecar)
            frames = Path(check_relative(sidecar.folder, path=path, field="folder"))
            depth = len(frames.parts)
            among_many = folder.parts[-depth:] == frames.parts and not (folder / frames).is_dir()
            top = folder.parents[depth - 1] if among_many else folder
            # A folder below an export need not belong to it.
            matches = start == folder or start == top / frames
            return (sidecar, top) if matches and sidecar.layout == layout else None
    return None
