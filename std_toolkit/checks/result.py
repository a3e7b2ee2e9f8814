"""Structure of check/report.json."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import msgspec

from std_toolkit.checks.detectability import Detectability
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.judgement import Grade
from std_toolkit.scene.model import Count, Document, ObjectId, ScaleEstimate, ScaleReport

Severity = Literal["high", "medium", "low"]
Verdict = Grade
Number = float | None
Source = Literal["contour", "depth", "texture", "support", "label", "views", "judge"]


class CheckGate(Document, frozen=True, kw_only=True):
    """One gate of the check.

    Attributes:
        key: stable name, such as "edges".
        title: what is measured, in words.
        value: null if it could not be measured; `status` is then "open".
        deviation: standard deviation of the value, if known.
        limit: limit in the same unit.
        rule: "at least" or "at most" the limit.
        unit: "", "px", "mm", "%" (value and limit are then in percent).
        status: "pass", "fail", or "open" (not measured; does not fail the check).
        detail: source of the value.
        advice: how to fix a failure.
        scope: "scene" if a failure fails the scene, "label" if it counts by the verdict of an
            object.
    """

    key: str
    title: str
    scope: Literal["scene", "label"] = "scene"
    value: Number
    deviation: Number = None
    limit: float
    rule: Literal["at least", "at most"]
    unit: str = ""
    status: Literal["pass", "fail", "open"]
    detail: str = ""
    advice: str = ""


class GateFinding(Document, frozen=True, kw_only=True):
    """What one gate says of one object.

    Attributes:
        gate: its key.
        value: of the object, in the unit of the gate; null if it was not measured.
        verdict: "unknown" if what was not measured leaves it open.
        exempt: why it cannot fail the gate, or counts less than what was measured, or "".
        detail: what was found in words, or "".
    """

    gate: str
    value: Number = None
    verdict: Verdict
    exempt: str = ""
    detail: str = ""


class CheckWarning(Document, frozen=True, kw_only=True):
    """A problem that needs inspection.

    Attributes:
        severity: "high" makes labels wrong, "medium" may do so, "low" is for information.
        about: object name, frame name or part of the scene.
        problem: what is wrong.
        advice: how to fix it.
        gate: key of the gate that failed, or "".
    """

    severity: Severity
    gate: str = ""
    about: str
    problem: str
    advice: str


class ObjectFrameCheck(Document, frozen=True, kw_only=True):
    """One object in one frame; null if the frame does not determine a value.

    Attributes:
        frame: frame id.
        visible_fraction: 0..1.
        edge_px: median distance of the contour to the nearest image edge.
        edge_support: fraction of the contour near an edge.
        edge_chance_px: edge distance of displaced contours in this frame.
        shift_px: [x, y] from the label to the image.
        depth_mm: median of rendered minus sensor depth.
        depth_unscaled_mm: the same without the bias common to all diffuse objects.
        on_edges: share of the contour within 1.25 px of an image edge.
        on_edges_chance: the same for displaced contours.
        motion_mm, motion_deg: significant translation and rotation between the label and the
            image of this frame alone, which determines the distance weakly.
        motion_std_mm, motion_std_deg: their standard deviations in the direction of the motion,
            or the largest ones without a significant motion.
        fault: why the label does not fit in this frame, or "".
    """

    frame: Count
    visible_fraction: float
    edge_px: Number = None
    edge_support: Number = None
    edge_chance_px: Number = None
    shift_px: list[float] | None = None
    depth_mm: Number = None
    depth_unscaled_mm: Number = None
    on_edges: Number = None
    on_edges_chance: Number = None
    motion_mm: Number = None
    motion_deg: Number = None
    motion_std_mm: Number = None
    motion_std_deg: Number = None
    fault: str = ""


class Value(Document, frozen=True, kw_only=True, omit_defaults=True):
    """One number measured on an object over all frames.

    Attributes:
        key: stable name, such as "edge_px"; see `ObjectCheck`.
        value: null if only its finding in words is known.
        std: its standard deviation, if known.
        unit: "", "px", "mm", "m" or "deg"; "" for fractions.
        source: what was measured.
        frames: number of frames that were used, if it was counted.
        text: the finding in words, or "".
        motion: [x, y, z] translation in mm, [x, y, z] rotation vector in degrees, from the label to
            what was measured, along the axes of the world.
        covariance: of `motion`, 6x6 by rows.
    """

    key: str
    value: Number = None
    std: Number = None
    unit: Literal["", "px", "mm", "m", "deg"] = ""
    source: Source
    frames: Count = 0
    text: str = ""
    motion: list[float] | None = None
    covariance: list[float] | None = None


class ObjectCheck(Document, frozen=True, kw_only=True):
    """One object over all measured frames.

    Attributes:
        object, name, model, category, material: from objects.json.
        label: "none", "annotated" (not propagated), "propagated" or "refined".
        annotated_frame: frame id of the annotation.
        frames_seen: frames in which it is visible.
        values: what was measured; a value that was not is absent. By key:
            visible_fraction: median over the frames that see it.
            edge_px, edge_p90_px: median and 90th percentile over frames of the frame's median edge
            distance; edge_tail_px: median of the frame's 90th percentile along the contour.
            edge_support: median fraction of the contour near an edge.
            edge_chance_px: edge distance of contours at random places nearby.
            depth_mm, depth_mad_mm: rendered minus sensor depth, diffuse objects only: median over
            frames of the frame's median, and of its median absolute deviation.
            depth_unscaled_mm: `depth_mm` without the bias common to all diffuse objects.
            distance_m: median distance of the surface from the camera.
            shift_px, shift_spread_px: median length of the frames' best shifts of the contour, and
            median distance from their median; shift_share: fraction of the frames that have one.
            offset_mm: length of the correction in the world that explains the shifts best.
            drift_px, drift_mm: part of the shifts that no correction explains, median over frames.
            motion_mm, motion_deg: significant translation between the label and the images of all
            frames, and rotation about the object's centre; 0 if none is significant. `motion` has
            also the parts that are not significant.
            size_error: size of the object relative to its mesh, minus 1; with at least four frames.
            confirmed: fraction of the frames with a visible contour in which it beats chance; its
            text says whether the images show the object where the label puts it: "yes" or "no".
            label_std_mm, label_std_deg: standard deviation along the weakest direction, from the
            label's covariance; the text is the label's own sentence on it.
            azimuth_span_deg, elevation_min_deg, elevation_max_deg, parallax_deg,
            largest_step_deg: view directions.
            completeness: fraction of the ground-truth pixels with sensor depth.
            raw_median_mm, raw_mae_mm, raw_rmse_mm: raw minus ground-truth depth.
            support, label_support: part of the contour on edges, of what chance leaves, at the
            motion and at the label; the text is "seen", "loose" (other poses are as likely),
            "aside" (edges nearby fit another pose better), "faint" or "absent".
            texture_mm: translation and rotation from the label to where the texture agrees with the
            images.
            surface_mm: the same to where the sensor depth on the object puts it.
            aligned_mm: translation and rotation from the label to where the edges and the depth of
            a lone frame put the object; the text is how.
            standing_mm: height of the label above the plane on which other objects stand; `motion`
            puts it there.
            pose_mm, pose_deg: motion by all evidence; the text is the cause: "label", "shape",
            "texture", "blind", "misled", "contradicted" or "".
            within: probability that the label lies within the limits; its text is the reason of the
            verdict on the pose.
            size_m: diagonal of the bounding box of the mesh.
            overlap_mm: how far the mesh reaches into that of the object in its text.
            symmetry_mm: how far a declared turn moves the surface of the mesh.
            shape_mm: largest difference in shape from the mesh; the text says where.
            smallest_fault_mm, smallest_fault_deg: error from which a label would be refused.
            texture: agreement of the texture at the label, -1..1; its text is "fits", "turned" (a
            turn fits better), "undecided", "ambiguous" (no texture, and a turn has the same
            silhouette) or "other" (the images do not show this texture). texture_says: the same
            as a sentence.
            texture_rival: the same at the best turn; its text is that turn, such as "turned by
            180 deg about z".
        verdict: the worst of its gates: "fits", "doubtful", "wrong" or "unknown" (no evidence).
        gates: what each gate says of it.
        frames: values of single frames.
    """

    object: ObjectId
    name: str
    model: str
    category: str
    material: str
    label: Literal["none", "annotated", "propagated", "refined"]
    annotated_frame: Count | None = None
    frames_seen: Count = 0
    values: list[Value] = msgspec.field(default_factory=list)
    verdict: Verdict = "unknown"
    gates: list[GateFinding] = msgspec.field(default_factory=list)
    frames: list[ObjectFrameCheck] = msgspec.field(default_factory=list)

    @property
    def is_labelled(self) -> bool:
        """Whether it has a label in the world."""
        return self.label in ("propagated", "refined")

    def entry(self, key: str) -> Value | None:
        """The value with a key; None if it was not measured."""
        return next((v for v in self.values if v.key == key), None)

    def value(self, key: str) -> Number:
        """The number of a value; None if it was not measured."""
        entry = self.entry(key)
        return None if entry is None else entry.value

    def std(self, key: str) -> Number:
        """The standard deviation of a value; None if it is unknown."""
        entry = self.entry(key)
        return None if entry is None else entry.std

    def text(self, key: str) -> str:
        """The words of a value; "" if it was not measured."""
        entry = self.entry(key)
        return "" if entry is None else entry.text

    def with_values(self, values: Iterable[Value]) -> ObjectCheck:
        """The object with further values."""
        return msgspec.structs.replace(self, values=[*self.values, *values])


class FrameCheck(Document, frozen=True, kw_only=True):
    """One frame.

    Attributes:
        frame, name, status, reprojection_px, points: from the poses.
        pose_std_mm: standard deviation of the camera position along its weakest direction.
        looked_at: whether the labels were measured in it.
        objects_visible: number of visible objects.
        edge_px: median over the objects.
        depth_valid: fraction of pixels with sensor depth.
        truth: "current", "stale" or "none".
        depth_shift_px: [x, y] shift of sensor depth against colour, median over the objects.
        problem: why the frame could not be checked, or "".
        fault: what is wrong with the frame, such as "camera pose" or "unreadable", or "".
    """

    frame: Count
    name: str
    status: Literal["registered", "unregistered", "no pose"]
    reprojection_px: Number = None
    points: Count = 0
    pose_std_mm: Number = None
    looked_at: bool = False
    objects_visible: Count = 0
    edge_px: Number = None
    depth_valid: Number = None
    truth: Literal["current", "stale", "none"] = "none"
    depth_shift_px: list[float] | None = None
    problem: str = ""
    fault: str = ""


class MaterialDepth(Document, frozen=True, kw_only=True):
    """Raw sensor depth against ground truth on one material.

    Attributes:
        material: from objects.json.
        objects: number of objects.
        pixels: ground-truth pixels over the measured frames.
        completeness: fraction of them with sensor depth.
        median_mm, p05_mm, p95_mm, mae_mm, rmse_mm: of raw minus ground truth, over the pixels with
            sensor depth.
        within_10mm: fraction of the ground-truth pixels whose sensor depth is within 10 mm.
        histogram_mm, histogram_share: centres of 2 mm bins and the fraction of the pixels with
            sensor depth in each; the outermost bins include everything beyond.
    """

    material: str
    objects: Count
    pixels: Count
    completeness: Number = None
    median_mm: Number = None
    p05_mm: Number = None
    p95_mm: Number = None
    mae_mm: Number = None
    rmse_mm: Number = None
    within_10mm: Number = None
    histogram_mm: list[float] = msgspec.field(default_factory=list)
    histogram_share: list[float] = msgspec.field(default_factory=list)


class SceneSummary(Document, frozen=True, kw_only=True):
    """The scene as a whole.

    Attributes:
        frames, registered, looked_at: numbers of frames.
        reprojection_px: mean over the registered frames.
        objects, labelled: numbers of objects; labelled ones have a pose in the world.
        depth_frames: frames with sensor depth.
        truth_frames: measured frames with current ground truth.
        truth_source: source of ground-truth depth: "rendered maps", "labels cast here" (from the
            labels by the check itself) or "none".
        depth_shift_px: [x, y] shift of sensor depth against colour, median over outlines.
        depth_shift_std_px: its standard deviation.
        depth_shifts: number of outlines.
        depth_bias: rendered over sensor depth minus 1, common to all diffuse objects.
        scale: from the poses.
        sizes: scale from the sizes of the labelled objects; its factor is relative to the present
            scale of the poses, 1 if they agree.
        poses_source: from the poses.
    """

    frames: Count
    registered: Count
    looked_at: Count
    reprojection_px: Number = None
    objects: Count
    labelled: Count
    depth_frames: Count
    truth_frames: Count
    truth_source: Literal["rendered maps", "labels cast here", "none"] = "none"
    depth_bias: Number = None
    depth_shift_px: list[float] | None = None
    depth_shift_std_px: Number = None
    depth_shifts: Count = 0
    scale: ScaleReport | None = None
    sizes: ScaleEstimate | None = None
    poses_source: str = ""


class CheckReport(Document, frozen=True, kw_only=True):
    """check/report.json.

    Attributes:
        passed: whether no gate of the scene failed and no label is wrong or doubtful; see
            `gates.outcome`.
        verdict: one line.
        missing: what the scene lacks, one sentence each.
        limits: the options of the check, and the limits of `--settings` that differ from the
            defaults.
        detectability: smallest faults that the check catches; null without `--inject`.
    """

    format: Literal["std-toolkit-check"] = "std-toolkit-check"
    version: Literal[1] = 1
    scene: str
    passed: bool
    verdict: str
    summary: SceneSummary
    gates: list[CheckGate]
    warnings: list[CheckWarning]
    missing: list[str]
    objects: list[ObjectCheck]
    frames: list[FrameCheck]
    materials: list[MaterialDepth]
    limits: dict[str, float]
    detectability: Detectability | None = None

    def gate(self, key: str) -> CheckGate:
        """The row of a gate.

        Raises:
            ToolkitError: the report has no such gate.
        """
        for row in self.gates:
            if row.key == key:
                return row
        raise ToolkitError("no such gate", field="gate", value=key)

    def failed_gates(self) -> list[CheckGate]:
        """The gates that failed, in order."""
        return [g for g in self.gates if g.status == "fail"]
