"""Gates on the contour of a label, and on the certainty of the label."""

from __future__ import annotations

from collections.abc import Iterable

from std_toolkit.checks.gates.gate import (
    LABELLED,
    Measured,
    ObjectGate,
    Reading,
    no_exemption,
    unlabelled,
    unseen,
)
from std_toolkit.checks.gates.motion import is_small
from std_toolkit.checks.result import CheckWarning, Number, ObjectCheck
from std_toolkit.options import CheckOptions

# With fewer frames that have a shift, drift cannot be distinguished from a mismatch.
FEWEST_DRIFT_FRAMES = 5
# Edge distances above this fraction of the distance by chance are not significant.
CHANCE_PART = 0.6
# A best shift in this fraction of the frames is sufficient evidence despite texture.
ENOUGH_SHIFTS = 0.5
_LARGE_OFFSET_MM = 3.0


def has_edges(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the object's outline has enough image edges."""
    enough = (item.value("edge_support") or 0) >= options.min_edge_support
    return enough and item.value("edge_px") is not None


def is_uninformative(item: ObjectCheck) -> bool:
    """Whether random contours nearby are as close to image edges as the label."""
    edge, chance = item.value("edge_px"), item.value("edge_chance_px")
    return edge is not None and chance is not None and edge > CHANCE_PART * chance


def shift_px(item: ObjectCheck, options: CheckOptions) -> Number:
    """The shift of the label against the image, if enough frames have a clear one."""
    reliable = has_edges(item, options) and (item.value("shift_share") or 0) >= ENOUGH_SHIFTS
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
    return Reading(0.0 if item.label in LABELLED else 1.0)


def _edges(item: ObjectCheck, measured: Measured) -> Reading | None:
    if not has_edges(item, measured.options):
        return None
    return _pixels(item, item.value("edge_px"), measured.options.max_edge_px, measured)


def _shift(item: ObjectCheck, measured: Measured) -> Reading | None:
    shift = shift_px(item, measured.options)
    return _pixels(item, shift, measured.options.max_shift_px, measured)


def _pixels(item: ObjectCheck, value: Number, limit: float, measured: Measured) -> Reading | None:
    """Pixels depend on resolution and distance: they decide where the motion is not measured."""
    if value is not None and is_small(item, measured.options):
        value = min(value, limit)
    return Reading(value)


def _drift(item: ObjectCheck, measured: Measured) -> Reading | None:
    drift = item.entry("drift_px")
    if drift is None or item.material == "transparent":
        return None
    reliable = drift.frames >= FEWEST_DRIFT_FRAMES and has_edges(item, measured.options)
    return Reading(drift.value) if reliable else None


def _evidence(item: ObjectCheck, measured: Measured) -> Reading | None:
    if unseen(item, measured):
        return None
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


def _offsets(measured: Measured) -> Iterable[CheckWarning]:
    """The displacement by the shifts, where the motion was not measured."""
    for item in measured.seen:
        if item.value("motion_mm") is not None or not has_edges(item, measured.options):
            continue
        offset = item.value("offset_mm") or 0
        if offset > _LARGE_OFFSET_MM:
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem=f"all frames together place it {offset:.1f} mm from its label",
                advice="run `std-curate propagate --refine`",
            )


def _weak_directions(measured: Measured) -> Iterable[CheckWarning]:
    for item in measured.seen:
        direction = item.text("label_std_mm")
        if direction:
            yield CheckWarning(
                severity="low",
                about=item.name,
                problem=direction,
                advice="annotate it in a view perpendicular to that direction",
            )


def _weak_evidence(measured: Measured) -> Iterable[CheckWarning]:
    for item in measured.seen:
        if not has_edges(item, measured.options):
            share = 100 * (item.value("edge_support") or 0)
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem=f"only {share:.0f} % of its contour is near an "
                "image edge: the image weakly supports the label",
                advice="inspect its close-ups; annotate it in a frame with more contrast",
            )
        elif not is_confirmed(item, measured.options):
            edge, chance = item.value("edge_px"), item.value("edge_chance_px")
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem=f"its edge distance, {edge:.1f} px, is no better than chance "
                f"({chance:.1f} px): the images do not support the label",
                advice="inspect its close-ups",
            )


GATES = (
    ObjectGate(
        key="labelled",
        title="objects without a propagated label",
        measure=_labelled,
        counts=True,
        exempt=no_exemption,
        verdict="open",
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
        warn=_offsets,
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
        warn=_weak_directions,
    ),
    ObjectGate(
        key="evidence",
        title="labels without support in the images",
        measure=_evidence,
        counts=True,
        exempt=_clear_glass,
        verdict="doubtful",
        unmeasured="open",
        advice="inspect their overlays: a wrong label matches no edges, or those of other surfaces",
        warn=_weak_evidence,
    ),
)
