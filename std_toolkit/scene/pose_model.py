"""Documents of intrinsics, camera poses and annotations; `scene.model` has the others.

`scene.scale_model` has those of the metric scale.

Annotations are the provenance of labels and the state of the work on each object.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.camera_models import lens_of
from std_toolkit.scene import document
from std_toolkit.scene.judgement import Judgement
from std_toolkit.scene.scale_model import ScaleEstimate, ScaleReport

__all__ = [
    "Annotation",
    "CameraModel",
    "CameraPoses",
    "ClickedPoint",
    "FramePose",
    "Gate",
    "LabelProvenance",
    "ObjectAnnotation",
    "RecordedLens",
    "ScaleEstimate",
    "ScaleReport",
    "Time",
]

# UTC, ISO 8601, to the second or finer.
Time = Annotated[str, msgspec.Meta(pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(Z|\+00:00)$")]


class FramePose(document.Document, frozen=True, kw_only=True):
    """Camera pose of one frame.

    Attributes:
        frame: frame id.
        status: "registered", or "unregistered" (without a pose; poses are never guessed).
        T_world_cam: camera to world, metres.
        reprojection_px: mean reprojection error of the inliers.
        points: number of inliers.
        covariance: 6x6, row-major, of a right perturbation `T @ SE3.exp(xi)`,
            xi = (rho, phi) in metres and radians.
    """

    frame: document.Count
    status: Literal["registered", "unregistered"]
    T_world_cam: document.Pose16 | None = None
    reprojection_px: document.NonNegative | None = None
    points: document.Count = 0
    covariance: document.Covariance36 | None = None

    def check(self) -> None:
        if (self.T_world_cam is not None) != (self.status == "registered"):
            raise ToolkitError(
                "a registered frame has a pose, an unregistered one has none",
                field="T_world_cam",
                value=self.status,
            )
        document.check_pose(self.T_world_cam, "T_world_cam")


class Gate(document.Document, frozen=True, kw_only=True):
    """A quality gate: a measured value and its limit."""

    name: str
    value: float
    limit: float
    passed: bool
    advice: str = ""


class CameraPoses(document.Document, frozen=True, kw_only=True):
    """poses.json: camera poses of all frames.

    Attributes:
        frames: poses of the frames.
        cameras: intrinsics refined together with the poses, by camera id; they replace those of
            scene.json wherever these poses are used. Empty if the intrinsics were fixed.
        scale: scale report; null only for poses imported in metres.
        gates: quality gates with their results.
        source: "sfm", or the importer of the poses.
        notes: sentences on the reconstruction.
    """

    frames: list[FramePose]
    cameras: dict[str, CameraModel] = msgspec.field(default_factory=dict)
    scale: ScaleReport | None = None
    gates: list[Gate] = msgspec.field(default_factory=list)
    source: str = "sfm"
    notes: list[str] = msgspec.field(default_factory=list)

    def check(self) -> None:
        document.check_unique([str(f.frame) for f in self.frames], "frames", "frame")


class CameraModel(document.Document, frozen=True, kw_only=True):
    """Intrinsics of one image stream; see `geometry.Camera`."""

    width: Annotated[int, msgspec.Meta(gt=0)]
    height: Annotated[int, msgspec.Meta(gt=0)]
    fx: document.Positive
    fy: document.Positive
    cx: float
    cy: float
    distortion: list[float] = msgspec.field(default_factory=list)

    def check(self) -> None:
        self.camera()

    def camera(self) -> Camera:
        k = tuple(self.distortion)
        return _camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy, k)

    @staticmethod
    def of(camera: Camera) -> CameraModel:
        """The document of a camera.

        Raises:
            ToolkitError: a lens that documents cannot state, such as a fisheye.
        """
        _ = camera.opencv_distortion
        return CameraModel(
            width=camera.width,
            height=camera.height,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            distortion=list(camera.distortion),
        )


class RecordedLens(document.Document, frozen=True, kw_only=True):
    """The lens that images had before they were undistorted; see `geometry.Camera`."""

    model: str
    fx: document.Positive
    fy: document.Positive
    cx: float
    cy: float
    distortion: list[float] = msgspec.field(default_factory=list)

    def check(self) -> None:
        lens_of(self.model, tuple(self.distortion))

    @staticmethod
    def of(camera: Camera) -> RecordedLens:
        c = camera
        return RecordedLens(
            model=c.model, fx=c.fx, fy=c.fy, cx=c.cx, cy=c.cy, distortion=list(c.distortion)
        )


# Needed for every frame; its checks take longer than a look-up.
_camera = lru_cache(maxsize=32)(Camera)


class LabelProvenance(document.Document, frozen=True, kw_only=True):
    """Provenance of a label, in addition to its `method` and `annotator`.

    Attributes:
        time: time of the last edit of the pose, UTC, ISO 8601.
        tool: name of the tool, such as "std-annotate".
        version: version of the tool.
        refinement: sentence on the refinement that gave the pose, or on the scene that it was
            carried over from; "" if it was edited manually since.
        hands_on_s: seconds that the annotator worked on this object, a lower bound, because each
            pause counts 30 s at most. Null without manual work, as in a script.
    """

    time: Time
    tool: str
    version: str
    refinement: str = ""
    hands_on_s: document.NonNegative | None = None


class ClickedPoint(document.Document, frozen=True, kw_only=True):
    """One clicked 2D-3D correspondence.

    Attributes:
        frame: frame id.
        u, v: pixel in the recorded (distorted) image, pixel centres at integers.
        point: corresponding point on the mesh, mesh frame, metres.
    """

    frame: document.Count
    u: float
    v: float
    point: document.Vector3


class ObjectAnnotation(document.Document, frozen=True, kw_only=True):
    """State of the work on one object.

    Attributes:
        object: object id.
        status: "done" if the annotator accepted the pose.
        note: free text, such as what to check again.
        locked: whether its pose must not be changed.
        clicks: clicked points per frame in the order in which they were made.
        judgement: what the annotation tool says of the pose in the annotated frame; absent if it
            was not measured.
    """

    object: document.ObjectId
    status: Literal["open", "done"] = "open"
    note: str = ""
    locked: bool = False
    clicks: list[ClickedPoint] = msgspec.field(default_factory=list)
    judgement: Judgement | msgspec.UnsetType = msgspec.UNSET


class Annotation(document.Document, frozen=True, kw_only=True):
    """annotation.json: state of the annotation; an object without a row is open."""

    objects: list[ObjectAnnotation] = msgspec.field(default_factory=list)

    def check(self) -> None:
        document.check_unique([str(x.object) for x in self.objects], "objects", "object")

    def of(self, object_id: int) -> ObjectAnnotation:
        """Return the row of an object, or an empty one."""
        found = next((x for x in self.objects if x.object == object_id), None)
        return found or ObjectAnnotation(object=object_id)
