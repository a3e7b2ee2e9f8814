"""Protocols of category-level pose evaluation, and the symmetries of classes."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.pose.box_iou import BoxIoU
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry

DREDS_CLASSES = ("other", "bottle", "bowl", "camera", "can", "car", "mug", "aeroplane")

DEFAULT_POSE_PROTOCOL = "strict"


@dataclass(frozen=True, kw_only=True)
class PoseClasses:
    """Names and symmetries of classes.

    Attributes:
        names: by number; 0 is what belongs to no class and is never scored.
        round_about_y: look the same after any turn about y.
        upside_down: of those, the ones that also look the same with top and bottom exchanged.
        round_without_handle: look the same after any turn about y while the handle is hidden.

    Raises:
        ToolkitError: names given twice, or symmetries of classes that are not there.
    """

    names: tuple[str, ...] = DREDS_CLASSES
    round_about_y: frozenset[str] = frozenset({"bottle", "bowl", "can"})
    upside_down: frozenset[str] = frozenset()
    round_without_handle: frozenset[str] = frozenset({"mug"})

    def __post_init__(self) -> None:
        if len(self.names) < 2 or len(set(self.names)) < len(self.names):
            raise ToolkitError("needs distinct names, number 0 being none", value=self.names)
        for name in ("round_about_y", "upside_down", "round_without_handle"):
            unknown = getattr(self, name) - set(self.names)
            if unknown:
                raise ToolkitError("no such class", field=name, value=sorted(unknown))
        if not self.upside_down <= self.round_about_y:
            value = sorted(self.upside_down - self.round_about_y)
            raise ToolkitError("must be round about y too", field="upside_down", value=value)

    def are(self, class_ids: NDArray[np.int64], names: Iterable[str]) -> NDArray[np.bool_]:
        """Which numbers are of classes with these names.

        >>> PoseClasses().are(np.array([1, 3]), {"bottle", "can"}).tolist()
        [True, False]
        """
        wanted = set(names)
        return np.array([name in wanted for name in self.names])[class_ids]


class PoseScoring(Enum):
    """What a figure means.

    Attributes:
        AP: average precision: the area under precision over recall, precision made to fall with
            recall (VOC, all points). Missed objects and false predictions cost.
        ACCURACY: matched predictions / predictions. Missed objects cost nothing.
    """

    AP = "ap"
    ACCURACY = "accuracy"


@dataclass(frozen=True)
class PoseGate:
    """A pose counts as right within an angle and a distance, both included."""

    degrees: float
    centimetres: float

    @property
    def name(self) -> str:
        """As tables have it.

        >>> PoseGate(5, 2).name
        '5deg2cm'
        """
        return f"{self.degrees:g}deg{self.centimetres:g}cm"


GATES = (PoseGate(5, 2), PoseGate(5, 5), PoseGate(10, 2), PoseGate(10, 5), PoseGate(10, 10))


@dataclass(frozen=True, kw_only=True)
class PoseProtocol:
    """How predicted poses are compared with true ones.

    Attributes:
        name: as the command line has it.
        about: one line on what it is good for.
        iou: which overlap of boxes.
        score: what a figure means.
        classes: names and symmetries.
        pose_needs_iou: if given, only predictions that overlap a true box by more than this, and
            the true objects they were matched with, enter the figures of angle and distance: what
            was missed or was found in the wrong place does not count there. None counts all.
        both_sides_only: whether frames without any true object, or without any prediction, are
            left out.
        iou_thresholds: of the columns of overlap; it must be larger.
        gates: of the columns of angle and distance.
        turns: parts of a full turn of which the best overlap of round classes is taken.

    Raises:
        ToolkitError: thresholds outside [0, 1), or no turns.
    """

    name: str
    about: str
    iou: BoxIoU = BoxIoU.ORIENTED
    score: PoseScoring = PoseScoring.AP
    classes: PoseClasses = field(default_factory=PoseClasses)
    pose_needs_iou: float | None = None
    both_sides_only: bool = False
    iou_thresholds: tuple[float, ...] = (0.25, 0.5, 0.75)
    gates: tuple[PoseGate, ...] = GATES
    turns: int = 20

    def __post_init__(self) -> None:
        needed = () if self.pose_needs_iou is None else (self.pose_needs_iou,)
        thresholds = (*self.iou_thresholds, *needed)
        if not all(0 <= t < 1 for t in thresholds) or self.turns < 1:
            value = (thresholds, self.turns)
            raise ToolkitError("needs thresholds in [0, 1) and turns", path=self.name, value=value)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the figures.

        >>> STRICT.columns[:4]
        ('iou25', 'iou50', 'iou75', '5deg2cm')
        """
        overlaps = (f"iou{100 * t:g}" for t in self.iou_thresholds)
        return (*overlaps, *(gate.name for gate in self.gates))


STRICT = PoseProtocol(
    name="strict",
    about="exact overlap of oriented boxes, average precision in which every miss counts",
)

PAPER = PoseProtocol(
    name="paper",
    about="the paper's released evaluation: boxes along the camera's axes, share of predictions",
    iou=BoxIoU.AABB,
    score=PoseScoring.ACCURACY,
    classes=PoseClasses(upside_down=frozenset({"can"}), round_without_handle=frozenset()),
    pose_needs_iou=0.1,
    both_sides_only=True,
)

NOCS2019 = PoseProtocol(
    name="nocs2019",
    about="NOCS' released evaluation: its overlap along the wrong axis, poses only of found boxes",
    iou=BoxIoU.NOCS2019,
    pose_needs_iou=0.1,
)

pose_protocols: Registry[PoseProtocol] = Registry(
    "std_toolkit.pose_protocols",
    {
        "strict": "benchmark.metrics.pose.pose_protocol:STRICT",
        "paper": "benchmark.metrics.pose.pose_protocol:PAPER",
        "nocs2019": "benchmark.metrics.pose.pose_protocol:NOCS2019",
    },
)


def get_pose_protocol(name: str = DEFAULT_POSE_PROTOCOL) -> PoseProtocol:
    """A protocol by its name, or by `package.module:ATTRIBUTE`.

    Args:
        name: one of `pose_protocols.names()`, of an installed plug-in, or a path to one.

    Returns:
        The protocol.

    Raises:
        ToolkitError: no such protocol, or what stands there is none.

    >>> get_pose_protocol("paper").iou.value
    'aabb'
    """
    found = pose_protocols.get(name)
    if not isinstance(found, PoseProtocol):
        raise ToolkitError("is not a PoseProtocol", field=name, value=type(found).__name__)
    return found
