"""The documents of a scene as typed structures; see data_spec.md for their meaning.

Every structure is strict: an unknown field, a wrong type or a number out of range is an error
that names the field. Poses are 16 numbers, row-major.
"""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Symmetry
from std_toolkit.scene.document import (
    Count,
    Covariance36,
    Document,
    NonNegative,
    ObjectId,
    Pose16,
    Positive,
    Vector3,
    check_name,
    check_pose,
    check_relative,
    check_unique,
    find_row,
    pose_from_list,
)
from std_toolkit.scene.judgement import Judgement
from std_toolkit.scene.pose_model import (
    Annotation,
    CameraModel,
    CameraPoses,
    ClickedPoint,
    FramePose,
    Gate,
    LabelProvenance,
    ObjectAnnotation,
    RecordedLens,
    ScaleEstimate,
    ScaleReport,
)

__all__ = [
    "CATEGORY_CLASS_IDS",
    "DIFFUSE_MATERIALS",
    "MATERIAL_IDS",
    "Annotation",
    "CameraModel",
    "CameraPoses",
    "ClickedPoint",
    "ContinuousSymmetry",
    "Count",
    "Covariance36",
    "Document",
    "Frame",
    "FramePose",
    "Frames",
    "Gate",
    "Label",
    "LabelProvenance",
    "Labels",
    "Material",
    "Model",
    "NonNegative",
    "Object",
    "ObjectAnnotation",
    "ObjectId",
    "ObjectTable",
    "Pose16",
    "Positive",
    "RecordedLens",
    "ScaleEstimate",
    "ScaleReport",
    "SceneInfo",
    "SymmetryModel",
    "Vector3",
    "pose_from_list",
]

Material = Literal["raw", "diffuse", "transparent", "specular"]

# Class ids of the STD and DREDS meta files; 0 is any other category.
CATEGORY_CLASS_IDS = {
    "other": 0,
    "bottle": 1,
    "bowl": 2,
    "camera": 3,
    "can": 4,
    "car": 5,
    "mug": 6,
    "aeroplane": 7,
}

# Material ids of the STD and DREDS meta files.
MATERIAL_IDS: dict[str, int] = {"raw": 0, "diffuse": 1, "transparent": 2, "specular": 3}

# A frame id without leading zeros, so that no frame has two keys.
_FRAME_KEY = re.compile(r"0|[1-9][0-9]{0,17}")

# Materials that an active stereo sensor measures correctly.
DIFFUSE_MATERIALS = ("raw", "diffuse")


class SceneInfo(Document, frozen=True, kw_only=True):
    """scene.json: properties of the whole recording.

    Attributes:
        cameras: intrinsics by camera id. Depth is aligned to the colour image of its frame.
        depth_scale: metres per unit of 16-bit depth images; null if all depth is EXR or absent.
        depth_correction: factor on all sensor depth, from a calibration of the sensor.
        source: origin of the recording, such as "import:folder".
        recorded_lenses: lens of the recorded images by camera id, where the images of the scene
            are undistorted; absent for others.
    """

    format: Literal["std-toolkit-scene"] = "std-toolkit-scene"
    version: Literal[1] = 1
    name: str
    cameras: dict[str, CameraModel]
    depth_scale: Positive | None = None
    depth_correction: Annotated[float, msgspec.Meta(gt=0.8, lt=1.25)] = 1.0
    source: str = ""
    recorded_lenses: dict[str, RecordedLens] | msgspec.UnsetType = msgspec.UNSET

    def check(self) -> None:
        check_name(self.name)
        if not self.cameras:
            raise ToolkitError("a scene needs at least one camera", field="cameras")
        for key in self.cameras:
            check_name(key, field="cameras")


class Frame(Document, frozen=True, kw_only=True):
    """One image of a recording.

    Attributes:
        id: unique id, ascending in recording order.
        name: stem of the file names.
        color: path of the colour image, relative to the scene folder.
        depth: path of the sensor depth, aligned to colour, or null.
        camera: key into `SceneInfo.cameras`.
        timestamp: seconds, or null.
    """

    id: Count
    name: str
    color: str
    depth: str | None = None
    camera: str = "color"
    timestamp: float | None = None

    def check(self) -> None:
        check_name(self.name)
        check_relative(self.color, field="color")
        if self.depth is not None:
            check_relative(self.depth, field="depth")


class Frames(Document, frozen=True, kw_only=True):
    """frames.json: the frames in recording order, with ascending ids."""

    frames: list[Frame]

    def check(self) -> None:
        ids = [f.id for f in self.frames]
        if any(b <= a for a, b in pairwise(ids)):
            raise ToolkitError("frame ids must be unique and ascending", field="frames")
        check_unique([f.name for f in self.frames], "frames", "name")


class ContinuousSymmetry(Document, frozen=True, kw_only=True):
    """Any rotation about `axis` (unit vector) through `offset` (metres), mesh frame."""

    axis: Vector3
    offset: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class SymmetryModel(Document, frozen=True, kw_only=True):
    """Symmetries of a model in its mesh frame; see `geometry.Symmetry`."""

    discrete: list[Pose16] = msgspec.field(default_factory=list)
    continuous: list[ContinuousSymmetry] = msgspec.field(default_factory=list)

    def check(self) -> None:
        self.symmetry()

    def symmetry(self) -> Symmetry:
        return Symmetry(
            tuple(tuple(T) for T in self.discrete),
            tuple(
                ((c.axis[0], c.axis[1], c.axis[2]), (c.offset[0], c.offset[1], c.offset[2]))
                for c in self.continuous
            ),
        )


class Model(Document, frozen=True, kw_only=True):
    """A CAD model.

    Attributes:
        id: safe name; also the name of the folder below `models/`.
        mesh: path relative to the scene folder; vertices in metres.
        category: category, such as "mug".
        class_id: number of the category in the STD and DREDS layouts; 0 is any other.
        size_m: extents of the bounding box in the mesh frame, metres.
        diameter_m: largest distance between two vertices, metres.
    """

    id: str
    mesh: str
    category: str = "other"
    class_id: Annotated[int, msgspec.Meta(ge=0, le=7)] = 0
    size_m: Annotated[list[Positive], msgspec.Meta(min_length=3, max_length=3)]
    diameter_m: Positive
    symmetry: SymmetryModel = SymmetryModel()

    def check(self) -> None:
        check_name(self.id, field="id")
        check_name(self.category, field="category")
        check_relative(self.mesh, field="mesh")


class Object(Document, frozen=True, kw_only=True):
    """One physical object in the scene: an instance of a model.

    Attributes:
        id: 1..254, the same in all frames; its value in masks (0 is the background).
        material: determines which data are used, such as sensor depth ("raw" is the original,
            diffuse surface).
    """

    id: ObjectId
    name: str
    model: str
    material: Material

    def check(self) -> None:
        check_name(self.name)


class ObjectTable(Document, frozen=True, kw_only=True):
    """objects.json: models and their instances in this scene."""

    models: list[Model] = msgspec.field(default_factory=list)
    objects: list[Object] = msgspec.field(default_factory=list)

    def check(self) -> None:
        check_unique([m.id for m in self.models], "models", "id")
        check_unique([str(o.id) for o in self.objects], "objects", "id")
        check_unique([o.name for o in self.objects], "objects", "name")
        known = {m.id for m in self.models}
        for i, o in enumerate(self.objects):
            if o.model not in known:
                raise ToolkitError(
                    "no model has this id", field=f"objects[{i}].model", value=o.model
                )

    def model(self, model_id: str) -> Model:
        return find_row(self.models, "id", model_id, "model")

    def object(self, object_id: int) -> Object:
        return find_row(self.objects, "id", object_id, "object")

    def object_named(self, name: str) -> Object:
        return find_row(self.objects, "name", name, "object")

    def model_of(self, object_id: int) -> Model:
        return self.model(self.object(object_id).model)


class Label(Document, frozen=True, kw_only=True):
    """6D pose of one object.

    Attributes:
        object: object id.
        frame: id of the frame in which it was annotated.
        T_cam_obj: mesh frame to the camera of that frame, as annotated, metres.
        T_world_obj: mesh frame to the world, metres; null before propagation.
        refined: whether `T_world_obj` was refined over several frames.
        covariance: 6x6, row-major, of a right perturbation `T_world_obj @ SE3.exp(xi)`.
        weak_direction: sentence on the least determined direction, or "".
        method: method of annotation, such as "file", "pnp", "import:bop".
        annotator: name of the annotator.
        views: poses of the same object annotated in further frames, by frame id.
        provenance: time, tool and refinement of the pose; absent if not recorded.
        judgement: what the check says of `T_world_obj`; absent if it was not measured.
    """

    object: ObjectId
    frame: Count
    T_cam_obj: Pose16
    T_world_obj: Pose16 | None = None
    refined: bool = False
    covariance: Covariance36 | None = None
    weak_direction: str = ""
    method: str = "file"
    annotator: str = ""
    views: dict[str, Pose16] = msgspec.field(default_factory=dict)
    provenance: LabelProvenance | msgspec.UnsetType = msgspec.UNSET
    judgement: Judgement | msgspec.UnsetType = msgspec.UNSET

    def check(self) -> None:
        check_pose(self.T_cam_obj, "T_cam_obj")
        check_pose(self.T_world_obj, "T_world_obj")
        for key, T in self.views.items():
            if not _FRAME_KEY.fullmatch(key):
                raise ToolkitError("views are keyed by frame id", field="views", value=key)
            check_pose(T, f"views.{key}")


class Labels(Document, frozen=True, kw_only=True):
    """labels.json: at most one label per object."""

    labels: list[Label] = msgspec.field(default_factory=list)

    def check(self) -> None:
        check_unique([str(x.object) for x in self.labels], "labels", "object")

    def of(self, object_id: int) -> Label | None:
        return next((x for x in self.labels if x.object == object_id), None)

    def with_label(self, label: Label) -> Labels:
        """Return a copy with `label` added or replaced, sorted by object id."""
        others = [x for x in self.labels if x.object != label.object]
        return Labels(labels=sorted([*others, label], key=lambda x: x.object))

    def without_judgements(self) -> Labels:
        """Return a copy for digests: what was measured of a label does not change the label."""
        bare = [msgspec.structs.replace(x, judgement=msgspec.UNSET) for x in self.labels]
        return Labels(labels=bare)


def annotated_views(label: Label) -> dict[int, SE3]:
    """Return T_cam_obj by frame id of all annotated frames, beginning with `label.frame`."""
    views = {label.frame: SE3.from_matrix(label.T_cam_obj)}
    for key, T in label.views.items():
        views.setdefault(int(key), SE3.from_matrix(T))
    return views


def without_derived(label: Label) -> Label:
    """Return the label as annotated, without the results of propagation, refinement and check."""
    return msgspec.structs.replace(
        label,
        T_world_obj=None,
        refined=False,
        covariance=None,
        weak_direction="",
        judgement=msgspec.UNSET,
    )
