"""What an annotator leaves beside the labels: how each came about, and the work on each object."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from std_toolkit.scene.document import (
    Count,
    Document,
    NonNegative,
    ObjectId,
    Vector3,
    check_unique,
)

# UTC, ISO 8601, to the second or finer.
Time = Annotated[str, msgspec.Meta(pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(Z|\+00:00)$")]


class LabelProvenance(Document, frozen=True, kw_only=True):
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
    hands_on_s: NonNegative | None = None


class ClickedPoint(Document, frozen=True, kw_only=True):
    """One clicked 2D-3D correspondence.

    Attributes:
        frame: frame id.
        u, v: pixel in the recorded image (lens distortion included), centres at integers.
        point: the same point on the mesh, metres, mesh frame.
    """

    frame: Count
    u: float
    v: float
    point: Vector3


class ObjectAnnotation(Document, frozen=True, kw_only=True):
    """State of the work on one object.

    Attributes:
        object: object id.
        status: "done" when the annotator was content with the pose.
        note: free text, such as what to look at again.
        clicks: in the order in which they were made, frame by frame.
    """

    object: ObjectId
    status: Literal["open", "done"] = "open"
    note: str = ""
    clicks: list[ClickedPoint] = msgspec.field(default_factory=list)


class Annotation(Document, frozen=True, kw_only=True):
    """annotation.json: state of the annotation; an object without a row is open."""

    objects: list[ObjectAnnotation] = msgspec.field(default_factory=list)

    def check(self) -> None:
        check_unique([str(x.object) for x in self.objects], "objects", "object")

    def of(self, object_id: int) -> ObjectAnnotation:
        """The row of an object; an empty one if it has none."""
        found = next((x for x in self.objects if x.object == object_id), None)
        return found or ObjectAnnotation(object=object_id)
