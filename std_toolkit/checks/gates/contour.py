"""Gates on the contour of a label, and on how well images and annotation determine it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from std_toolkit.checks.gates.gate import (
    Measured,
    ObjectGate,
    Reading,
    no_exemption,
    unlabelled,
    unseen,
)
from std_toolkit.checks.gates.motion import is_judged
from std_toolkit.checks.measure.coverage import CoverageSettings
from std_toolkit.checks.result import CheckWarning, Number, ObjectCheck, Severity
from std_toolkit.options import CheckOptions
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class ContourSettings(Settings):
    """When a contour, a shift or a drift says something of a label."""

    fewest_drift_frames: int = limit(
        5,
        source="with fewer, drift cannot be distinguished from a mismatch",
    )
    """frames with a shift that drift needs"""
    chance_part: float = limit(0.6, source=NOT_RECORDED)
    """edge distances above this fraction of the distance by chance are not significant"""
    enough_shifts: float = limit(0.5, source=NOT_RECORDED)
    """a best shift in this fraction of the frames is sufficient evidence despite texture"""
    large_offset_mm: float = limit(3.0, unit="mm", source=NOT_RECORDED)
    """a larger translation that all frames share brings a warning"""
    reflected: Mapping[str, float] = limit(
        {"specular": 4.0, "transparent": 2.0},
        source="world seeds 600 to 613 of setting kinds, right labels: 3.5 on a ball of steel, "
        "beside which reflections lie in every second frame; 1.3 on glass",
    )
    """distances in pixels up to so many limits say nothing of objects of these materials whose
    contour does not determine their pose; nor does a drift of steel"""
    low_visibility: float = limit(0.5, source=NOT_RECORDED)
    """a smaller visible fraction brings a warning"""
    large_step_deg: float = limit(30.0, unit="deg", source=NOT_RECORDED)
    """a larger gap between views brings a warning"""


def has_edges(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the object's outline has enough image edges."""
    enough = (item.value("edge_support") or 0) >= options.min_edge_support
    return enough and item.value("edge_px") is not None


def is_uninformative(item: ObjectCheck) -> bool:
    """Whether random contours nearby are as close to image edges as the label."""
    limits = ContourSettings.current()
    edge, chance = item.value("edge_px"), item.value("edge_chance_px")
    return edge is not None and chance is not None and edge > limits.chance_part * chance


def shift_px(item: ObjectCheck, options: CheckOptions) -> Number:
    """The shift of the label against the image, if enough frames have a clear one."""
    limits = ContourSettings.current()
    reliable = has_edges(item, options) and (item.value("shift_share") or 0) >= limits.enough_shifts
    return item.value("shift_px") if reliable else None


def is_confirmed(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the image supports the label: it is better than chance, or a shift is clear.

    A wrong label is close to edges of other surfaces, especially in a textured scene. A small
    edge distance alone is therefore no evidence.
    """
    if item.text("confirmed") == "yes" and item.value("motion_mm") is not None:
        return True
    if not has_edges(item, options):
        return False
    return not is_uninformative(item) or shift_px(item, options) is not None


def _labelled(item: ObjectCheck, measured: Measured) -> Reading:
    del measured
    return Reading(0.0 if item.is_labelled else 1.0)


def _edges(item: ObjectCheck, measured: Measured) -> Reading | None:
    if not has_edges(item, measured.options):
        return None
    return _pixels(item, item.value("edge_px"), measured.options.max_edge_px, measured)


def _shift(item: ObjectCheck, measured: Measured) -> Reading | None:
    shift = shift_px(item, measured.options)
    return _pixels(item, shift, measured.options.max_shift_px, measured)


def _pixels(
    item: ObjectCheck, value: Number, limit_px: float, measured: Measured
) -> Reading | None:
    """Pixels depend on resolution and distance: they decide where the motion is not measured."""
    if value is None:
        return None
    if is_judged(item, measured):
        return Reading(value, excuse="its motion counts instead", verdict="fits")
    limits = ContourSettings.current()
    reflected = limits.reflected.get(item.material, 0.0)
    pose = measured.weighed.get(item.object)
    open_ = item.text("support") in ("loose", "faint", "aside") or (
        pose and pose.verdict == "unknown"
    )
    if open_ and value <= reflected * limit_px:
        return Reading(value, excuse="reflections give edges beside it, too", verdict="unknown")
    return Reading(value)


def _drift(item: ObjectCheck, measured: Measured) -> Reading | None:
    limits = ContourSettings.current()
    drift = item.entry("drift_px")
    if drift is None or item.material == "transparent":
        return None
    if drift.frames < limits.fewest_drift_frames or not has_edges(item, measured.options):
        return None
    most = limits.reflected.get(item.material, 0.0) * measured.options.max_drift_px
    if drift.value is not None and measured.options.max_drift_px < drift.value <= most:
        return Reading(drift.value, excuse="its reflections move, too", verdict="unknown")
    return Reading(drift.value)


def _evidence(item: ObjectCheck, measured: Measured) -> Reading | None:
    if unseen(item, measured):
        return None
    if is_judged(item, measured) or item.entry("support") is not None:
        return Reading(0.0, verdict="fits")  # the gate `seen` judges it
    return Reading(0.0 if is_confirmed(item, measured.options) else 1.0)


def _clear_glass(item: ObjectCheck, measured: Measured) -> str:
    del measured
    glass = item.material == "transparent"
    return "clear glass may have no visible edge" if glass else ""


def _unpropagated(measured: Measured) -> Iterable[CheckWarning]:
    for item in measured.objects:
        if item.label == "annotated":
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem="is annotated but not propagated",
                advice="run `std-curate propagate`",
            )


def _weak_evidence(measured: Measured) -> Iterable[CheckWarning]:
    """What the images lack to determine the labels."""
    for item in measured.labelled:
        for severity, problem, advice in _lacks(item, measured.options):
            yield CheckWarning(severity=severity, about=item.name, problem=problem, advice=advice)


def _lacks(item: ObjectCheck, options: CheckOptions) -> Iterable[tuple[Severity, str, str]]:
    """Severity, problem and advice for each thing that the images of an object lack."""
    limits = ContourSettings.current()
    if item.frames_seen == 0:
        yield "high", "is not visible in any measured frame", "check its label and mesh"
        return
    if not has_edges(item, options):
        yield (
            "medium",
            f"only {100 * (item.value('edge_support') or 0):.0f} % of its contour is near an image "
            "edge: the image weakly supports the label",
            "inspect its close-ups; annotate it in a frame with more contrast",
        )
    elif not is_confirmed(item, options):
        yield (
            "medium",
            f"its edge distance, {item.value('edge_px'):.1f} px, is no better than chance "
            f"({item.value('edge_chance_px'):.1f} px): the images do not support the label",
            "inspect its close-ups",
        )
    offset = item.value("offset_mm") or 0
    pooled = item.value("motion_mm") is None and has_edges(item, options)
    if pooled and offset > limits.large_offset_mm:
        yield (
            "medium",
            f"all frames together place it {offset:.1f} mm from its label",
            "run `std-curate propagate --refine`",
        )
    parallax, step = item.value("parallax_deg"), item.value("largest_step_deg") or 0
    if parallax is not None and parallax < CoverageSettings.current().narrow_deg:
        yield (
            "medium",
            f"was seen over only {parallax:.0f} degrees: its depth is weakly determined",
            "record a wider sweep around it",
        )
    if step > limits.large_step_deg:
        yield (
            "low",
            f"its views have a gap of {step:.0f} degrees",
            "record the missing directions if you need them",
        )
    visible = item.value("visible_fraction")
    if visible is not None and visible < limits.low_visibility:
        yield (
            "low",
            f"is half occluded in most frames (visible {100 * visible:.0f} %)",
            "rearrange the objects if it must be visible in this scene",
        )
    direction = item.text("label_std_mm")
    if direction:
        yield "low", direction, "annotate it in a view perpendicular to that direction"


GATES = (
    ObjectGate(
        key="labelled",
        title="objects without a propagated label",
        measure=_labelled,
        counts=True,
        exempt=no_exemption,
        verdict="unknown",
        advice="annotate them (`std-curate label`), then run `std-curate propagate`",
        warn=_unpropagated,
    ),
    ObjectGate(
        key="edges",
        title="distance from label contour to image edge, worst object",
        measure=_edges,
        limit=lambda options: options.max_edge_px,
        unit="px",
        advice="inspect the overlays; run `std-curate propagate --refine` or annotate the "
        "object again",
    ),
    ObjectGate(
        key="shift",
        title="shift of the image against the label, worst object",
        measure=_shift,
        limit=lambda options: options.max_shift_px,
        unit="px",
        advice="run `std-curate propagate --refine`; if only frames far from the annotated one "
        "are off, check the scale and the camera poses",
    ),
    ObjectGate(
        key="drift",
        title="image motion relative to the label that no pose explains, worst object",
        measure=_drift,
        limit=lambda options: options.max_drift_px,
        unit="px",
        advice="the label fits only some frames: check the scale sources, the camera poses, "
        "and whether the object was moved",
    ),
    ObjectGate(
        key="covariance",
        title="standard deviation of a label, weakest direction, worst object",
        measure=lambda item, _: Reading(item.value("label_std_mm")),
        exempt=unlabelled,
        limit=lambda options: options.max_label_std_mm,
        unit="mm",
        advice="annotate it in another frame from a different side, or record a wider sweep",
    ),
    ObjectGate(
        key="evidence",
        title="labels without support in the images",
        measure=_evidence,
        counts=True,
        exempt=_clear_glass,
        verdict="doubtful",
        unmeasured="unknown",
        advice="inspect their overlays: a wrong label matches no edges, or those of other surfaces",
        warn=_weak_evidence,
    ),
)
