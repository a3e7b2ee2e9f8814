"""The documents of a scene, as typed structures. data_spec.md tells their meaning.

Every structure is strict: an unknown field, a wrong type or a number out of range is an error
that names the field. Poses are 16 numbers, row-major.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.scene.names import check_name, check_relative

Positive = Annotated[float, msgspec.Meta(gt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]
Count = Annotated[int, msgspec.Meta(ge=0)]
Pose16 = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]
Covariance36 = Annotated[list[float], msgspec.Meta(min_length=36, max_length=36)]
Vector3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
ObjectId = Annotated[int, msgspec.Meta(ge=1, le=254)]
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
# Materials that an active stereo sensor measures rightly.
DIFFUSE_MATERIALS = ("raw", "diffuse")


class Document(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=False
):
    """Base of all documents."""


class CameraModel(Document, frozen=True, kw_only=True):
    """Intrinsics of one image stream; see `geometry.Camera`."""

    width: Annotated[int, msgspec.Meta(gt=0)]
    height: Annotated[int, msgspec.Meta(gt=0)]
    fx: Positive
    fy: Positive
    cx: float
    cy: float
    distortion: list[float] = []

    def __post_init__(self) -> None:
        self.camera()

    def camera(self) -> Camera:
        return Camera(
            self.width, self.height, self.fx, self.fy, self.cx, self.cy, tuple(self.distortion)
        )

    @staticmethod
    def of(camera: Camera) -> CameraModel:
        return CameraModel(
            width=camera.width,
            height=camera.height,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            distortion=list(camera.distortion),
        )


class SceneInfo(Document, frozen=True, kw_only=True):
    """scene.json: the recording as a whole.

    Attributes:
        cameras: camera id to intrinsics. Depth is aligned to the colour image of its frame.
        depth_scale: metres per unit of 16-bit depth images; null if all depth is EXR or absent.
        depth_correction: factor on all sensor depth, known from a calibration of the sensor.
        source: how the recording came here, such as "import:folder".
    """

    format: Literal["std-toolkit-scene"] = "std-toolkit-scene"
    version: Literal[1] = 1
    name: str
    cameras: dict[str, CameraModel]
    depth_scale: Positive | None = None
    depth_correction: Annotated[float, msgspec.Meta(gt=0.8, lt=1.25)] = 1.0
    source: str = ""

    def __post_init__(self) -> None:
        check_name(self.name)
        if not self.cameras:
            raise ToolkitError("a scene needs at least one camera", field="cameras")
        for key in self.cameras:
            check_name(key, field="cameras")


class Frame(Document, frozen=True, kw_only=True):
    """One image of a recording.

    Attributes:
        id: unique, in recording order.
        name: stem of the frame's files.
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

    def __post_init__(self) -> None:
        check_name(self.name)
        check_relative(self.color, field="color")
        if self.depth is not None:
            check_relative(self.depth, field="depth")


class Frames(Document, frozen=True, kw_only=True):
    """frames.json: the frames in recording order, ids rising."""

    frames: list[Frame]

    def __post_init__(self) -> None:
        ids = [f.id for f in self.frames]
        if any(b <= a for a, b in pairwise(ids)):
            raise ToolkitError("frame ids must be unique and rising", field="frames")
        _unique([f.name for f in self.frames], "frames", "name")


class ContinuousSymmetry(Document, frozen=True, kw_only=True):
    """Any rotation about `axis` (unit vector) through `offset` (metres), mesh frame."""

    axis: Vector3
    offset: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class SymmetryModel(Document, frozen=True, kw_only=True):
    """Symmetries of a model in its mesh frame; see `geometry.Symmetry`."""

    discrete: list[Pose16] = []
    continuous: list[ContinuousSymmetry] = []

    def __post_init__(self) -> None:
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
        id: safe name, also the folder below `models/`.
        mesh: path relative to the scene folder; vertices in metres.
        category: such as "mug"; `class_id` is its number in the STD and DREDS layouts (0 other).
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

    def __post_init__(self) -> None:
        check_name(self.id, field="id")
        check_name(self.category, field="category")
        check_relative(self.mesh, field="mesh")


class Object(Document, frozen=True, kw_only=True):
    """One physical object in the scene: an instance of a model.

    Attributes:
        id: 1..254, stable over the scene; its value in masks (0 is the background).
        material: decides which evidence may be trusted ("raw" is the original, diffuse surface).
    """

    id: ObjectId
    name: str
    model: str
    material: Material

    def __post_init__(self) -> None:
        check_name(self.name)


class ObjectTable(Document, frozen=True, kw_only=True):
    """objects.json: models and their instances in this scene."""

    models: list[Model] = []
    objects: list[Object] = []

    def __post_init__(self) -> None:
        _unique([m.id for m in self.models], "models", "id")
        _unique([str(o.id) for o in self.objects], "objects", "id")
        _unique([o.name for o in self.objects], "objects", "name")
        known = {m.id for m in self.models}
        for i, o in enumerate(self.objects):
            if o.model not in known:
                raise ToolkitError(
                    "no model of this id", field=f"objects[{i}].model", value=o.model
                )

    def model(self, model_id: str) -> Model:
        return _find(self.models, "id", model_id, "model")

    def object(self, object_id: int) -> Object:
        return _find(self.objects, "id", object_id, "object")

    def object_named(self, name: str) -> Object:
        return _find(self.objects, "name", name, "object")

    def model_of(self, object_id: int) -> Model:
        return self.model(self.object(object_id).model)


class FramePose(Document, frozen=True, kw_only=True):
    """Camera pose of one frame.

    Attributes:
        status: "registered", or "unregistered" (then there is no pose: poses are never guessed).
        T_world_cam: camera to world, metres.
        reprojection_px: mean reprojection error of the frame's inliers.
        points: number of inliers.
        covariance: 6x6 row-major of a right perturbation `T @ SE3.exp(xi)`,
            xi = (rho, phi) in metres and radians.
    """

    frame: Count
    status: Literal["registered", "unregistered"]
    T_world_cam: Pose16 | None = None
    reprojection_px: NonNegative | None = None
    points: Count = 0
    covariance: Covariance36 | None = None

    def __post_init__(self) -> None:
        if (self.T_world_cam is not None) != (self.status == "registered"):
            raise ToolkitError(
                "a registered frame has a pose, an unregistered one has none",
                field="T_world_cam",
                value=self.status,
            )
        if self.T_world_cam is not None:
            SE3.from_matrix(self.T_world_cam)


class ScaleEstimate(Document, frozen=True, kw_only=True):
    """What one source says about the metres of a reconstruction.

    Attributes:
        source: plug-in name: "depth", "cad", "board".
        factor: metres per unit of the reconstruction before scaling.
        spread: interquartile range of the single estimates, relative to the factor.
        standard_error: of the factor, relative to it.
        count: number of single estimates.
        note: what it was measured on.
    """

    source: str
    factor: Positive
    spread: NonNegative
    standard_error: NonNegative
    count: Count
    note: str = ""


class ScaleReport(Document, frozen=True, kw_only=True):
    """Where the metres come from.

    Attributes:
        unit: "metre", or "unknown" when poses were asked for without any scale source.
        chosen: the source that was used; "given" for poses imported in metres.
        disagreement: largest relative difference between two sources.
    """

    unit: Literal["metre", "unknown"]
    chosen: str
    estimates: list[ScaleEstimate] = []
    disagreement: NonNegative = 0.0


class Gate(Document, frozen=True, kw_only=True):
    """One quality gate: a measured value against its limit."""

    name: str
    value: float
    limit: float
    passed: bool
    advice: str = ""


class CameraPoses(Document, frozen=True, kw_only=True):
    """poses.json: camera poses of all frames.

    Attributes:
        cameras: intrinsics that were refined together with the poses; they replace those of
            scene.json for everything that uses these poses. Empty if fixed.
        scale: null only for imported poses that were metric from the start.
        gates: the quality gates and their outcome.
        source: "sfm" or how the poses were imported.
    """

    frames: list[FramePose]
    cameras: dict[str, CameraModel] = {}
    scale: ScaleReport | None = None
    gates: list[Gate] = []
    source: str = "sfm"
    notes: list[str] = []

    def __post_init__(self) -> None:
        _unique([str(f.frame) for f in self.frames], "frames", "frame")


class Label(Document, frozen=True, kw_only=True):
    """6D pose of one object.

    Attributes:
        object: object id.
        frame: the frame in which it was annotated.
        T_cam_obj: mesh frame to the camera of that frame, as annotated, metres.
        T_world_obj: mesh frame to the world, after propagation and refinement; null before.
        refined: `T_world_obj` was adjusted over several frames.
        covariance: 6x6 row-major of a right perturbation `T_world_obj @ SE3.exp(xi)`.
        weak_direction: sentence on the least determined direction, or "".
        method: how it was annotated, such as "file", "pnp", "import:bop".
        annotator: who did it.
        views: poses of the same object annotated in further frames, by frame id.
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
    views: dict[str, Pose16] = {}

    def __post_init__(self) -> None:
        SE3.from_matrix(self.T_cam_obj)
        if self.T_world_obj is not None:
            SE3.from_matrix(self.T_world_obj)
        for key, T in self.views.items():
            if not key.isdigit():
                raise ToolkitError("views are keyed by frame id", field="views", value=key)
            SE3.from_matrix(T)


class Labels(Document, frozen=True, kw_only=True):
    """labels.json: at most one label per object."""

    labels: list[Label] = []

    def __post_init__(self) -> None:
        _unique([str(x.object) for x in self.labels], "labels", "object")

    def of(self, object_id: int) -> Label | None:
        return next((x for x in self.labels if x.object == object_id), None)

    def with_label(self, label: Label) -> Labels:
        """A copy in which `label` replaces or joins the others, sorted by object id."""
        others = [x for x in self.labels if x.object != label.object]
        return Labels(labels=sorted([*others, label], key=lambda x: x.object))


def pose_from_list(numbers: list[float]) -> SE3:
    """SE3 of 16 numbers already validated by a document."""
    M = np.asarray(numbers, dtype=np.float64).reshape(4, 4)
    return SE3(M[:3, :3].copy(), M[:3, 3].copy())


def _unique(values: list[str], table: str, field: str) -> None:
    seen: set[str] = set()
    for i, value in enumerate(values):
        if value in seen:
            raise ToolkitError("appears twice", field=f"{table}[{i}].{field}", value=value)
        seen.add(value)


def _find(table: list[Any], key: str, value: object, kind: str) -> Any:
    for row in table:
        if getattr(row, key) == value:
            return row
    raise ToolkitError(
        f"no such {kind}",
        value=value,
        hint=f"known: {', '.join(str(getattr(r, key)) for r in table) or 'none'}",
    )
