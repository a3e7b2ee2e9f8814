"""Comparison of the labels of two annotators of one recording, object by object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pandas as pd

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Symmetry
from std_toolkit.geometry.symmetry import common_symmetry
from std_toolkit.labels.agreement import annotated_scene
from std_toolkit.labels.agreement.options import CompareOptions
from std_toolkit.labels.agreement.pose_difference import (
    PoseDifference,
    pose_difference,
    surface_distance,
    what_differs,
)
from std_toolkit.labels.agreement.shared_recording import shared_recording
from std_toolkit.scene import Scene

Verdict = Literal["agree", "disagree", "not comparable"]

# Smaller differences of poses are due to rounding.
_ROUNDING_M = 1e-9


_DIGITS = 4


@dataclass(frozen=True, eq=False)
class ObjectAgreement:
    """Comparison of two labels of one object.

    Attributes:
        a, b: the labels of the two annotators.
        by: how the labels were matched: "name" or "place".
        verdict: "not comparable" if the poses cannot be compared; `mostly` has the reason.
        frame: frame of the first scene in which `difference` was computed: of the annotated frames,
            the one where the poses are farthest apart.
        difference: None if not comparable.
        mssd_by_frame: metres, by frame id of the first scene, in all common frames.
        mostly: text on the main difference.
    """

    a: annotated_scene.LabelledObject
    b: annotated_scene.LabelledObject
    by: str
    verdict: Verdict
    frame: int | None = None
    difference: PoseDifference | None = None
    mssd_by_frame: dict[int, float] = field(default_factory=dict)
    mostly: str = ""

    @property
    def name(self) -> str:
        return self.a.name

    @property
    def median_m(self) -> float:
        """Median MSSD over all common frames, metres; NaN if not comparable."""
        return float(np.median(list(self.mssd_by_frame.values()) or [np.nan]))

    @property
    def max_m(self) -> float:
        """Largest MSSD over all common frames, metres; NaN if not comparable."""
        return max(self.mssd_by_frame.values(), default=float("nan"))

    @property
    def worst_m(self) -> float:
        """Value compared with the threshold, metres; NaN if not comparable."""
        if self.difference is None:
            return float("nan")
        return max(self.difference.mssd_m, self.median_m)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of the labels of two annotators.

    Attributes:
        a, b: the scenes of the two annotators.
        options: options of the comparison.
        objects: objects labelled by both, in order of review: disagreements first, largest first.
        only_a, only_b: names of objects that only one of the two labelled.
        notes: sentences to report.
    """

    a: annotated_scene.AnnotatedScene
    b: annotated_scene.AnnotatedScene
    options: CompareOptions
    objects: tuple[ObjectAgreement, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def disagreements(self) -> tuple[ObjectAgreement, ...]:
        """Objects to review: above the threshold, or not comparable."""
        return tuple(x for x in self.objects if x.verdict != "agree")

    @property
    def median_mm(self) -> float:
        """Median MSSD over the objects, millimetres; NaN without any."""
        return float(np.median(self._compared() or [np.nan]))

    @property
    def max_mm(self) -> float:
        """Largest MSSD over the objects, millimetres; NaN without any."""
        return max(self._compared(), default=float("nan"))

    def _compared(self) -> list[float]:
        return [1000 * x.difference.mssd_m for x in self.objects if x.difference is not None]

    @property
    def table(self) -> pd.DataFrame:
        """Return one row per object labelled by both: lengths in mm, angles in degrees, px."""

        return object_table(self)

    @property
    def frame_table(self) -> pd.DataFrame:
        """Return one row per object and common frame with the MSSD in mm."""

        return frame_table(self)


def compare_labels(
    scene_a: Scene,
    scene_b: Scene,
    options: CompareOptions | None = None,
    *,
    notes_of: Callable[[annotated_scene.AnnotatedScene], list[str]] = annotated_scene.open_work,
) -> Comparison:
    """Compare the labels of two annotators of one recording.

    Poses are compared in the cameras of common frames, because each scene may have its own world
    frame and scale. Symmetric variants count as equal, for symmetries that both declare.

    Args:
        scene_a, scene_b: the scenes of the two annotators.
        options: options of the comparison.
        notes_of: sentences on the unfinished work of one annotator.

    Raises:
        ToolkitError: the recordings differ, or a scene has no labels.
    """
    options = options or CompareOptions()
    shared = shared_recording(scene_a, scene_b)
    a = annotated_scene.AnnotatedScene(
        "A", scene_a, {f: f for f in shared.frames}, options.as_annotated
    )
    b = annotated_scene.AnnotatedScene("B", scene_b, shared.frames, options.as_annotated)
    for one in (a, b):
        if not one.scene.labels.labels:
            raise ToolkitError(
                "this scene has no labels to compare",
                path=one.scene.root,
                hint="label it, or give another folder",
            )
    matching = annotated_scene.match_objects(a.objects, b.objects)
    rows = [agreement_of(m, options) for m in matching.matches]
    rows = [_with_swap(row, b.objects) for row in rows]
    rows.sort(key=lambda x: (x.verdict == "agree", -np.nan_to_num(x.worst_m, nan=np.inf), x.name))
    notes = [
        *shared.notes,
        *notes_of(a),
        *notes_of(b),
        *_object_notes(rows),
    ]
    return Comparison(
        a,
        b,
        options,
        tuple(rows),
        tuple(x.name for x in matching.only_a),
        tuple(x.name for x in matching.only_b),
        tuple(notes),
    )


def agreement_of(match: annotated_scene.Match, options: CompareOptions) -> ObjectAgreement:
    """Compare two labels of one object; the result contains the reason if not comparable."""
    a, b = match.a, match.b

    def problem(text: str) -> ObjectAgreement:
        return ObjectAgreement(a, b, match.by, "not comparable", mostly=text)

    try:
        if not annotated_scene.same_mesh(a, b):
            return problem("the meshes differ, so poses are not comparable")
        common = sorted(a.poses.keys() & b.poses.keys())
        outline = a.outline
        symmetry = common_symmetry(a.symmetry, b.symmetry, outline)
    except ToolkitError as error:
        return problem(str(error))
    if not common:
        return problem(
            "no frame in which both have a pose: labelled in different frames, and without "
            "metric camera poses they cannot be propagated"
        )
    by_frame = _distances(a, b, common, symmetry)
    annotated = sorted((a.views.keys() | b.views.keys()) & set(common)) or common
    # Independent of rounding, which would otherwise select among equal frames.
    frame = max(annotated, key=lambda f: (round(by_frame[f] / _ROUNDING_M), -f))
    names = (a.owner.name, b.owner.name)
    difference = pose_difference(
        a.poses[frame],
        b.poses[frame],
        outline,
        symmetry,
        cameras=(a.owner.camera(frame), b.owner.camera(frame)),
    )
    limit = options.threshold_mm / 1000 + _ROUNDING_M
    row = ObjectAgreement(a, b, match.by, "agree", frame, difference, by_frame)
    mostly = what_differs(difference, names)
    if row.worst_m <= limit:
        return _replaced(row, "agree", mostly)
    if difference.mssd_m <= limit:
        mostly = (
            f"{1000 * difference.mssd_m:.1f} mm where annotated, but {1000 * row.median_m:.1f} mm "
            "in the median frame: do the camera poses differ?"
        )
    return _replaced(row, "disagree", mostly)


def _distances(
    a: annotated_scene.LabelledObject,
    b: annotated_scene.LabelledObject,
    frames: Sequence[int],
    symmetry: Symmetry,
) -> dict[int, float]:
    """Return the MSSD in metres by frame; it is constant for two labels in one world."""
    known: dict[bytes, float] = {}
    found = {}
    for frame in frames:
        relative = a.poses[frame].inverse() @ b.poses[frame]
        key = np.round(relative.matrix(), 10).tobytes()
        if key not in known:
            known[key] = surface_distance(SE3.identity(), relative, a.outline, symmetry)
        found[frame] = known[key]
    return found


def _replaced(row: ObjectAgreement, verdict: Verdict, mostly: str) -> ObjectAgreement:
    return ObjectAgreement(
        row.a, row.b, row.by, verdict, row.frame, row.difference, row.mssd_by_frame, mostly
    )


def _with_swap(
    row: ObjectAgreement, others: Sequence[annotated_scene.LabelledObject]
) -> ObjectAgreement:
    """Detect objects of the same mesh whose names are swapped."""
    near = row.a.model.diameter_m / 2
    if row.difference is None or row.by != "name" or row.difference.translation_m < near:
        return row
    for other in others:
        if other.name == row.b.name or not annotated_scene.same_mesh(row.a, other):
            continue
        if annotated_scene.distance_between(row.a, other) < near:
            names = row.b.owner.name, other.name
            return _replaced(row, row.verdict, f"{names[0]} calls this one {names[1]}: swapped?")
    return row


def _object_notes(rows: Sequence[ObjectAgreement]) -> list[str]:
    notes = []
    for row in rows:
        if row.by == "place":
            notes.append(
                f"{row.a.name} of {row.a.owner.name} is matched with {row.b.name} of "
                f"{row.b.owner.name}: same mesh, nearest position"
            )
        if row.a.symmetry != row.b.symmetry and row.difference is not None:
            notes.append(
                f"{row.name}: the two declare different symmetries; only common ones are used"
            )
        if row.a.object.material != row.b.object.material:
            notes.append(
                f"{row.name}: {row.a.object.material} for {row.a.owner.name}, "
                f"{row.b.object.material} for {row.b.owner.name}"
            )
    return notes


def object_table(comparison: Comparison) -> pd.DataFrame:
    """Return one row per object labelled by both, in the order of review."""
    return pd.DataFrame([_row(comparison, x) for x in comparison.objects], columns=list(_COLUMNS))


def frame_table(comparison: Comparison) -> pd.DataFrame:
    """Return one row per object and common frame."""
    frames = {f.id: f.name for f in comparison.a.scene.frames}
    rows = [
        (x.name, frame, frames[frame], round(1000 * apart, _DIGITS))
        for x in comparison.objects
        for frame, apart in x.mssd_by_frame.items()
    ]
    return pd.DataFrame(rows, columns=["object", "frame", "frame_name", "mssd_mm"])


_COLUMNS = (
    "object",
    "object_b",
    "matched_by",
    "model",
    "verdict",
    "frame",
    "frame_name",
    "mssd_mm",
    "rotation_deg",
    "translation_mm",
    "along_ray_mm",
    "sideways_mm",
    "shift_px",
    "frames",
    "median_mm",
    "max_mm",
    "mostly",
    "judged_a",
    "judged_b",
)


def _row(comparison: Comparison, x: ObjectAgreement) -> dict[str, Any]:
    row: dict[str, Any] = {
        "object": x.a.name,
        "object_b": x.b.name,
        "matched_by": x.by,
        "model": x.a.model.id,
        "verdict": x.verdict,
        "frames": len(x.mssd_by_frame),
        "mostly": x.mostly,
        "judged_a": x.a.judged.grade,
        "judged_b": x.b.judged.grade,
    }
    d = x.difference
    if d is None or x.frame is None:
        return row
    numbers = {
        "mssd_mm": 1000 * d.mssd_m,
        "rotation_deg": float(np.rad2deg(d.rotation_rad)),
        "translation_mm": 1000 * d.translation_m,
        "along_ray_mm": 1000 * d.along_ray_m,
        "sideways_mm": 1000 * d.sideways_m,
        "shift_px": d.shift_px,
        "median_mm": 1000 * x.median_m,
        "max_mm": 1000 * x.max_m,
    }
    return {
        **row,
        "frame": x.frame,
        "frame_name": comparison.a.scene.frame(x.frame).name,
        **{key: round(value, _DIGITS) for key, value in numbers.items()},
    }
