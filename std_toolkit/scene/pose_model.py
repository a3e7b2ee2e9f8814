"""poses.json: camera poses, where their metres come from, and the gates they passed."""

from __future__ import annotations

from typing import Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.scene.camera_model import CameraModel
from std_toolkit.scene.document import (
    Count,
    Covariance36,
    Document,
    NonNegative,
    Pose16,
    Positive,
    check_pose,
    check_unique,
)


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

    def check(self) -> None:
        if (self.T_world_cam is not None) != (self.status == "registered"):
            raise ToolkitError(
                "a registered frame has a pose, an unregistered one has none",
                field="T_world_cam",
                value=self.status,
            )
        check_pose(self.T_world_cam, "T_world_cam")


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
    estimates: list[ScaleEstimate] = msgspec.field(default_factory=list)
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
    cameras: dict[str, CameraModel] = msgspec.field(default_factory=dict)
    scale: ScaleReport | None = None
    gates: list[Gate] = msgspec.field(default_factory=list)
    source: str = "sfm"
    notes: list[str] = msgspec.field(default_factory=list)

    def check(self) -> None:
        check_unique([str(f.frame) for f in self.frames], "frames", "frame")
