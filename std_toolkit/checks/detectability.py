"""Structure of the section `detectability` of check/report.json."""

from __future__ import annotations

from typing import Literal

import msgspec

from std_toolkit.scene.model import Count, Document, ObjectId

FaultName = Literal["sideways", "along", "tilt", "turn", "scale", "moved", "camera", "alignment"]


class FaultTrial(Document, frozen=True, kw_only=True):
    """The result of the gates with one fault.

    Attributes:
        size: of the fault, in the unit of its row.
        caught: whether it was caught in both directions.
        gates: keys of the gates that caught it; "verdict" if a fault of the scene made a label bad.
        ratio: largest gate value divided by its limit, over the gates that the fault changes;
            null if it changes none that has a limit above 0.
    """

    size: float
    caught: bool
    gates: list[str] = msgspec.field(default_factory=list)
    ratio: float | None = None


class FaultRow(Document, frozen=True, kw_only=True):
    """One kind of fault in one object, or in the whole scene.

    Attributes:
        object: object id; null for a fault of the whole scene.
        name: name of the object, or "(scene)".
        fault: kind of the fault.
        unit: "mm", "deg", "%" or "px".
        caught_from: smallest size tried that was caught; null if none was.
        caught_to: largest size below another that was missed, as a label far off meets nothing;
            null if all larger sizes tried were caught.
        missed_to: largest size tried below it that was not caught; 0 if the smallest was caught.
        gates: keys of the gates that caught the fault of size `caught_from`.
        note: why nothing was tried, or "".
        trials: the sizes tried, ascending; the first has size 0, the scene as it is.
    """

    object: ObjectId | None = None
    name: str
    fault: FaultName
    unit: Literal["mm", "deg", "%", "px"]
    caught_from: float | None = None
    caught_to: float | None = None
    missed_to: float = 0.0
    gates: list[str] = msgspec.field(default_factory=list)
    note: str = ""
    trials: list[FaultTrial] = msgspec.field(default_factory=list)


class Detectability(Document, frozen=True, kw_only=True):
    """Smallest faults that the judge catches in this scene.

    Attributes:
        frames: ids of the frames with which it was measured.
        confirmed_in: number of frames with which each `caught_from` was tried.
        camera_frame: id of the frame whose camera pose was displaced.
        left_out: names of labelled objects without injected faults.
        passed: whether these frames pass all gates without a fault.
        rows: one for each object and kind of fault, then those of the scene.
    """

    frames: list[Count]
    confirmed_in: Count = 0
    camera_frame: Count | None = None
    left_out: list[str] = msgspec.field(default_factory=list)
    passed: bool
    rows: list[FaultRow]
