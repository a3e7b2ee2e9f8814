"""Documents of `std-bench audit`: what was measured of the labels of a set."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Literal

import msgspec

from benchmark.evaluation.manifest import Count, Name

LABELS_CSV, OBJECTS_CSV = "audit_labels.csv", "audit_objects.csv"
FRAMES_CSV, PICTURES = "audit_frames.csv", "pictures"

Verdict = Literal["fits", "unknown", "doubtful", "wrong"]
Number = float | None


_UNSAFE = {ord(c): "_" for c in '<>"\x7f'} | dict.fromkeys(range(32), "_")


def plain(text: str) -> str:
    """A name of a data set without characters that documents refuse.

    >>> plain("a<b>")
    'a_b_'
    """
    return text.translate(_UNSAFE) or "_"


class Size(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A length in mm or an angle in degrees, with the smallest and largest that the 95 % region of
    the measured motion holds."""

    value: float
    low: float
    high: float


class AuditedLabel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One object in a group of frames that were judged together: all of a scene, or one.

    Attributes:
        scene, frame: `frame` is "" where all frames of a scene were judged together, and "A to B"
            where a run of them was.
        object, model, material: names.
        frames: in which it was measured.
        error_mm, error_deg: from the label to where the images put the object; null if nothing
            says where it is.
        across_mm: the part of `error_mm` across the mean view.
        along_mm, along_std_mm: the part along it, positive if the object is farther than its label,
            and its standard deviation.
        weakest_mm, weakest_deg: standard deviation along the weakest direction.
        depth_mm: median of label minus sensor depth on it; null on glass and metal.
        edge_px: median distance of its contour from image edges.
        overlap_mm, overlap_with: how deep its mesh reaches into that of another label.
        verdict, reason: of the judge.
        source: what said where it is: "several frames", "one frame" or "".
        picture: file of a picture of it, or "".
    """

    scene: Name
    frame: str
    object: Name
    model: Name
    material: str
    frames: Count
    error_mm: Size | None = None
    error_deg: Size | None = None
    across_mm: Size | None = None
    along_mm: Number = None
    along_std_mm: Number = None
    weakest_mm: Number = None
    weakest_deg: Number = None
    depth_mm: Number = None
    edge_px: Number = None
    overlap_mm: Number = None
    overlap_with: str = ""
    verdict: Verdict
    reason: str
    source: str
    picture: str = ""


class AuditedObject(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One object of a scene over all that was judged of it.

    Attributes:
        scene, object, model, material: names.
        labels, measured, refused: numbers of its labels that were judged, whose error is known,
            and that are doubtful or wrong.
        error_mm, error_deg: typical label: the medians of errors and of their bounds.
    """

    scene: Name
    object: Name
    model: Name
    material: str
    labels: Count
    measured: Count
    refused: Count
    error_mm: Size | None
    error_deg: Size | None


class Disagreement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A frame in which a label and the images disagree, or a label and its other frames.

    Attributes:
        frame: "" for all frames that were judged together.
        object: "" for the whole frame.
        what: in words.
    """

    scene: Name
    frame: str
    object: str
    what: str


class AuditedScene(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One scene.

    Attributes:
        frames, looked_at: frames of the set, and those that were read.
        cameras: where camera poses come from: "of the set", "from the labels" or "none".
        alone: frames that were judged alone.
        labels: number of labels in these frames.
        off_mm, off_deg: median over labels of the distance from their object's place, and of the
            angle; null where frames stand alone.
        off_most_mm, off_most_deg: the largest ones.
        rough: rotations that are off orthonormal by more than rounding.
        rough_most: largest entry of `R R^T - I`.
        without_mesh: objects whose mesh the set does not have.
        without_images, without_depth: frames that lack them.
        problems: frames that could not be read.
    """

    scene: Name
    frames: Count
    looked_at: Count
    cameras: str
    alone: Count
    labels: Count
    off_mm: Number = None
    off_deg: Number = None
    off_most_mm: Number = None
    off_most_deg: Number = None
    rough: Count = 0
    rough_most: float = 0.0
    without_mesh: list[str] = []
    without_images: Count = 0
    without_depth: Count = 0
    problems: list[str] = []


class Audit(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """audit.json.

    Attributes:
        set: name in tables.
        split: name of a split, or "bop".
        root: folder of the data.
        limits: of the judge, and the settings that differ from the defaults.
        scenes, labels, disagreements: what was measured.
        unseen: what the audit cannot see, a sentence each.
    """

    format: Literal["std-toolkit-audit"] = "std-toolkit-audit"
    version: Literal[1] = 1
    set: Name
    split: Name
    root: str
    limits: dict[str, float]
    version_of_tool: str
    packages: dict[str, str]
    hardware: dict[str, str]
    scenes: list[AuditedScene]
    labels: list[AuditedLabel]
    disagreements: list[Disagreement]
    unseen: list[str]

    def counts(self) -> dict[str, int]:
        """Number of labels by verdict."""
        found = dict.fromkeys(("fits", "unknown", "doubtful", "wrong"), 0)
        for label in self.labels:
            found[label.verdict] += 1
        return found

    def objects(self) -> list[AuditedObject]:
        """What is known of each object of each scene."""
        groups: dict[tuple[str, str], list[AuditedLabel]] = {}
        for label in self.labels:
            groups.setdefault((label.scene, label.object), []).append(label)
        return [
            AuditedObject(
                scene=scene,
                object=name,
                model=mine[0].model,
                material=mine[0].material,
                labels=len(mine),
                measured=sum(x.error_mm is not None for x in mine),
                refused=sum(x.verdict in ("doubtful", "wrong") for x in mine),
                error_mm=_typical([x.error_mm for x in mine]),
                error_deg=_typical([x.error_deg for x in mine]),
            )
            for (scene, name), mine in groups.items()
        ]


def _typical(sizes: Sequence[Size | None]) -> Size | None:
    known = [s for s in sizes if s is not None]
    if not known:
        return None
    value, low, high = (
        round(median(getattr(s, n) for s in known), 2) for n in ("value", "low", "high")
    )
    return Size(value=value, low=low, high=high)
