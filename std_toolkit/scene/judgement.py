"""What the judge says of a label, and the evidence for it, as stored with the label."""

from typing import Annotated, Literal, get_args

import msgspec
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_error
from std_toolkit.scene.document import (
    Count,
    Covariance36,
    Document,
    Pose16,
    Vector3,
    check_pose,
    pose_from_list,
)

# From the best word to the worst.
Grade = Literal["fits", "unknown", "doubtful", "wrong"]
GRADES: tuple[Grade, ...] = get_args(Grade)
Source = Literal["contour", "texture", "depth", "support"]

# A label may move by this part of the deviation before its judgement is out of date.
_SAME = 0.1


class Evidence(Document, frozen=True, kw_only=True):
    """Where one source puts an object, relative to its label.

    Attributes:
        source: what was measured.
        motion_mm, turn_deg: translation of the object's centre and rotation vector about it, along
            the axes of the world; null where the source says nothing.
        covariance: of both, 6x6 by rows, mm and degrees; null likewise.
        frames: number of frames that were used.
        text: the finding in words.
    """

    source: Source
    motion_mm: Vector3 | None = None
    turn_deg: Vector3 | None = None
    covariance: Covariance36 | None = None
    frames: Count = 0
    text: str = ""


class Judgement(Document, frozen=True, kw_only=True):
    """The verdict on one label.

    Attributes:
        grade: "fits", "doubtful", "wrong", or "unknown" without evidence that could show a fault.
        probability: that the pose lies within the limits; null if nothing was measured.
        cause: best explanation: "label", "turn", "shape", "texture", "size", "moved", "hidden" or
            "" for none.
        reason: the verdict in one sentence.
        T_obj: the pose that was measured, `T_world_obj` in labels.json and `T_cam_obj` of the
            annotated frame in annotation.json.
        T_rival: pose of the same kind that fits better; null without one.
        deviation_mm, deviation_deg: standard deviation of the measured pose along its weakest
            direction; null if nothing was measured.
        inputs: digest of mesh, frames and limits.
        limits: those that differed from the defaults, by name.
        time: when it was measured, UTC, ISO 8601.
        evidence: from each source.
    """

    grade: Grade
    probability: Annotated[float, msgspec.Meta(ge=0, le=1)] | None = None
    cause: str = ""
    reason: str
    T_obj: Pose16
    T_rival: Pose16 | None = None
    deviation_mm: float | None = None
    deviation_deg: float | None = None
    inputs: str
    limits: dict[str, float] = msgspec.field(default_factory=dict)
    time: str
    evidence: list[Evidence] = msgspec.field(default_factory=list)

    def check(self) -> None:
        check_pose(self.T_obj, "T_obj")
        check_pose(self.T_rival, "T_rival")
        if self.probability is None and self.grade in ("fits", "doubtful"):
            raise ToolkitError(
                "a verdict needs a measurement", field="probability", value=self.grade
            )

    def is_current(self, T_obj: SE3, inputs: str) -> bool:
        """Whether it still holds for a pose, and for a digest of mesh, frames and limits.

        The pose may lie within a tenth of the deviation from the measured one.
        """
        if inputs != self.inputs:
            return False
        measured = pose_from_list(self.T_obj)
        mm = 1000 * float(np.linalg.norm(T_obj.t - measured.t))
        deg = float(np.rad2deg(rotation_error(T_obj, measured)))
        # Documents hold rounded numbers.
        return (
            mm <= _SAME * (self.deviation_mm or 0.0) + 1e-4
            and deg <= _SAME * (self.deviation_deg or 0.0) + 1e-4
        )


def kept_judgement(
    judgement: Judgement | msgspec.UnsetType, T_obj: SE3 | None
) -> Judgement | msgspec.UnsetType:
    """The judgement of a label that now has the pose `T_obj`; UNSET if the pose left it behind.

    Moves add up, because each pose is compared with the one that was measured.
    """
    if isinstance(judgement, msgspec.UnsetType) or T_obj is None:
        return msgspec.UNSET
    return judgement if judgement.is_current(T_obj, judgement.inputs) else msgspec.UNSET
