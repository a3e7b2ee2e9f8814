"""Documents of cameras, camera poses and annotations; `scene.model` holds the others.

Intrinsics as they are written to documents.

What an annotator leaves beside the labels: how each came about, and the work on each object.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.scene import document

# UTC, ISO 8601, to the second or finer.
Time = Annotated[str, msgspec.Meta(pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(Z|\+00:00)$")]


class FramePose(document.Document, frozen=True, kw_only=True):
    """Camera pose of one frame.

    Attributes:
        status: "registered", or "unregistered" (then there is no pose: poses are never guessed).
        T_world_cam: camera to world, metres.
        reprojection_px: mean reprojection error of the frame's inliers.
        points: number of inliers.
        covariance: 6x6 row-major of a right perturbation `T @ SE3.exp(xi)`,
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


class ScaleEstimate(document.Document, frozen=True, kw_only=True):
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
    factor: document.Positive
    spread: document.NonNegative
    standard_error: document.NonNegative
    count: document.Count
    note: str = ""


class ScaleReport(document.Document, frozen=True, kw_only=True):
    """Where the metres come from.

    Attributes:
        unit: "metre", or "unknown" when poses were asked for without any scale source.
        chosen: the source that was used; "given" for poses imported in metres.
        disagreement: largest relative difference between two sources.
    """

    unit: Literal["metre", "unknown"]
    chosen: str
    estimates: list[ScaleEstimate] = msgspec.field(default_factory=list)
    disagreement: document.NonNegative = 0.0


class Gate(document.Document, frozen=True, kw_only=True):
    """One quality gate: a measured value against its limit."""

    name: str
    value: float
    limit: float
    passed: bool
    advice: str = ""


class CameraPoses(document.Document, frozen=True, kw_only=True):
    """poses.json: camera poses of all frames.

    Attributes:
        cameras: intrinsics that were refined together with the poses; they replace those of
            scene.json for everything that uses these poses. Empty if fixed.
        scale: null only for imported poses that were metric from the start.
        gates: the quality gates and their outcome.
        source: "sfm" or how the poses were imported.
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
        return CameraModel(
            width=camera.width,
            height=camera.height,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            distortion=list(camera.distortion),
        )


# Asked for with every frame; its checks take longer than looking it up.
_camera = lru_cache(maxsize=32)(Camera)


class LabelProvenance(document.Document, frozen=True, kw_only=True):
    """How a label came about, beside its `method` and `annotator`.

    Attributes:
        time: of the last edit of the pose, UTC, ISO 8601.
        tool: such as "std-annotate".
        version: of the tool.
        refinement: sentence on the refinement whose result the pose is, or "" if a hand moved it
            since.
        hands_on_s: seconds that the annotator worked on this object, a lower bound: pauses count
            with 30 s at most. Null if no hand was at work, as in a script.
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
        u, v: pixel in the recorded image (lens distortion included), centres at integers.
        point: the same point on the mesh, metres, mesh frame.
    """

    frame: document.Count
    u: float
    v: float
    point: document.Vector3


class ObjectAnnotation(document.Document, frozen=True, kw_only=True):
    """State of the work on one object.

    Attributes:
        object: object id.
        status: "done" when the annotator was content with the pose.
        note: free text, such as what to look at again.
        clicks: in the order in which they were made, frame by frame.
    """

    object: document.ObjectId
    status: Literal["open", "done"] = "open"
    note: str = ""
    clicks: list[ClickedPoint] = msgspec.field(default_factory=list)


class Annotation(document.Document, frozen=True, kw_only=True):
    """annotation.json: state of the annotation; an object without a row is open."""

    objects: list[ObjectAnnotation] = msgspec.field(default_factory=list)

    def check(self) -> None:
        document.check_unique([str(x.object) for x in self.objects], "objects", "object")

    def of(self, object_id: int) -> ObjectAnnotation:
        """The row of an object; an empty one if it has none."""
        found = next((x for x in self.objects if x.object == object_id), None)
        return found or ObjectAnnotation(object=object_id)
