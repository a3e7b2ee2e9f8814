"""Gates of the check, each with a value, a limit and advice, and the verdict of each object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import msgspec

from std_toolkit.checks.gates.motion_checks import counted_motion, has_wrong_size, is_small
from std_toolkit.checks.result import CheckGate, FrameCheck, Number, ObjectCheck, SceneSummary
from std_toolkit.options import CheckOptions
from std_toolkit.scene import CameraPoses
from std_toolkit.scene.model import ScaleReport
from std_toolkit.scene.scale_model import ScaleDifference, differences

# Sensors of this class are biased by 1 to 2 percent; a larger common residual has another cause.
LARGEST_DEPTH_BIAS = 0.025
# With fewer frames that have a shift, drift cannot be distinguished from a mismatch.
FEWEST_DRIFT_FRAMES = 5
# Edge distances above this fraction of the distance by chance are not significant.
CHANCE_PART = 0.6
# A best shift in this fraction of the frames is sufficient evidence despite texture.
ENOUGH_SHIFTS = 0.5


def scale_share(summary: SceneSummary) -> float:
    """Relative depth uncertainty from the scale: errors of its sources and of the sensor.

    The largest of: the standard error of the scale, the disagreement of its sources, and the bias
    that all diffuse objects share (if it is plausible for a sensor).
    """
    share = 0.0
    if summary.scale is not None:
        share = max(share, summary.scale.consistent().disagreement)
        chosen = [e for e in summary.scale.estimates if e.source == summary.scale.chosen]
        share = max([share, *(e.standard_error for e in chosen)])
    bias = abs(summary.depth_bias or 0.0)
    return max(share, bias if bias <= LARGEST_DEPTH_BIAS else 0.0)


def depth_excess_mm(item: ObjectCheck, share: float) -> Number:
    """Part of an object's depth residual that the scale does not explain, in mm."""
    if item.depth_mm is None or item.distance_m is None:
        return None
    return round(max(0.0, abs(item.depth_mm) - 1000 * share * item.distance_m), 2)


def has_edges(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the object's outline has enough image edges."""
    return item.edge_px is not None and (item.edge_support or 0) >= options.min_edge_support


def is_uninformative(item: ObjectCheck) -> bool:
    """Whether random contours nearby are as close to image edges as the label."""
    return (
        item.edge_px is not None
        and item.edge_chance_px is not None
        and item.edge_px > CHANCE_PART * item.edge_chance_px
    )


def shift_px(item: ObjectCheck, options: CheckOptions) -> Number:
    """The shift of the label against the image, if enough frames have a clear one."""
    reliable = has_edges(item, options) and (item.shift_share or 0) >= ENOUGH_SHIFTS
    return item.shift_px if reliable else None


def is_confirmed(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the image supports the label: it is better than chance, or a shift is clear.

    A wrong label is close to edges of other surfaces, especially in a textured scene. A small
    edge distance alone is therefore no evidence.
    """
    if item.confirmed and item.motion_mm is not None:
        return True
    if not has_edges(item, options):
        return False
    return not is_uninformative(item) or shift_px(item, options) is not None


def evaluate_gates(
    summary: SceneSummary,
    objects: Sequence[ObjectCheck],
    frames: Sequence[FrameCheck],
    poses: CameraPoses | None,
    options: CheckOptions,
) -> list[CheckGate]:
    """All gates; gates without a value are open."""
    return [
        *_pose_gates(summary, poses, options),
        *_label_gates(summary, objects, options),
        _gate(
            "frames",
            "frames that could not be checked",
            float(sum(bool(f.problem) for f in frames)) if summary.looked_at or frames else None,
            0.0,
            detail=_names([f.name for f in frames if f.problem]),
            advice="restore the files named in the warnings, or import the recording again",
        ),
    ]


def evaluate_object(item: ObjectCheck, share: float, options: CheckOptions) -> ObjectCheck:
    """The object with its verdict."""
    excess = depth_excess_mm(item, share)
    small, moved = is_small(item, options), counted_motion(item, options)
    bad = (
        (not small and has_edges(item, options) and (item.edge_px or 0) > options.max_edge_px)
        or (not small and (shift_px(item, options) or 0) > options.max_shift_px)
        or (moved[0] or 0) > options.max_motion_mm
        or (moved[1] or 0) > options.max_motion_deg
        or has_wrong_size(item, options)
        or (excess is not None and excess > options.max_depth_mm)
        or (_drift(item, options) or 0) > options.max_drift_px
        or (item.label_std_mm or 0) > options.max_label_std_mm
        or item.texture_verdict == "turned"
    )
    verdict: Literal["good", "doubtful", "bad", "open"]
    if bad:
        verdict = "bad"
    elif not item.frames_seen:
        verdict = "open"
    elif item.confirmed is False or not is_confirmed(item, options):
        verdict = "doubtful"
    else:
        verdict = "good"
    return msgspec.structs.replace(item, verdict=verdict)


def _pose_gates(
    summary: SceneSummary, poses: CameraPoses | None, options: CheckOptions
) -> list[CheckGate]:
    share = 100 * summary.registered / summary.frames if summary.frames else None
    scale = summary.scale
    scale_pairs = differences(scale.estimates) if scale is not None else []
    gates = [
        _gate(
            "registered",
            "frames with a camera pose",
            share,
            100 * options.min_registered,
            rule="at least",
            unit="%",
            detail=f"{summary.registered} of {summary.frames} frames",
            advice="run `std-curate poses`; if that is not enough, record again with slower motion "
            "and more texture in view",
        ),
        _gate(
            "reprojection",
            "mean reprojection error of the camera poses",
            summary.reprojection_px,
            options.max_reprojection_px,
            unit="px",
            advice="check the intrinsics, or let `std-curate poses` refine them with distortion",
        ),
        _gate(
            "scale",
            "difference of the scale sources in joint standard deviations, "
            f"where above {100 * options.max_scale_disagreement:g} %",
            _scale_sigma(scale_pairs, options),
            options.max_scale_sigma,
            detail=_scale_detail(scale, scale_pairs),
            advice="select the most reliable source (`std-curate poses --scale ...`), or correct "
            "the depth factor of the sensor in scene.json",
        ),
    ]
    if scale is not None and scale.unit == "unknown":
        gates.append(
            _gate(
                "metres",
                "poses without a metric scale",
                1.0,
                0.0,
                advice="give a scale source: sensor depth, a CAD model in two keyframes or a board",
            )
        )
    failed = [g for g in poses.gates if not g.passed] if poses else []
    if poses is not None and poses.gates:
        gates.append(
            _gate(
                "poses",
                "quality gates of the camera poses that failed",
                float(len(failed)),
                0.0,
                detail="; ".join(f"{g.name}: {g.value:.4g}, limit {g.limit:.4g}" for g in failed),
                advice="; ".join(g.advice for g in failed if g.advice) or "see `std-curate poses`",
            )
        )
    return gates


def _label_gates(
    summary: SceneSummary, objects: Sequence[ObjectCheck], options: CheckOptions
) -> list[CheckGate]:
    labelled = [o for o in objects if o.label in ("propagated", "refined")]
    unlabelled = [o.name for o in objects if o not in labelled]
    share = scale_share(summary)
    seen = [o for o in labelled if o.frames_seen]
    # Pixels depend on resolution and distance: they decide where the motion is not measured.
    small = {o.name for o in seen if is_small(o, options)}
    edges = {o.name: o.edge_px for o in seen if has_edges(o, options)}
    edges = _at_most(edges, small, options.max_edge_px)
    depth = {o.name: depth_excess_mm(o, share) for o in seen}
    drift = {o.name: _drift(o, options) for o in seen}
    spread = {o.name: o.label_std_mm for o in labelled}
    shift = {o.name: shift_px(o, options) for o in seen}
    shift = _at_most(shift, small, options.max_shift_px)
    # Clear glass may have no visible edge; that is a warning, not a failure.
    blind = [o.name for o in seen if o.material != "transparent" and not is_confirmed(o, options)]
    return [
        _gate(
            "labelled",
            "objects without a propagated label",
            float(len(unlabelled)) if objects else None,
            0.0,
            detail=_names(unlabelled),
            advice="annotate them (`std-curate label`), then run `std-curate propagate`",
        ),
        _gate(
            "edges",
            "distance from label contour to image edge, worst object",
            _worst(edges),
            options.max_edge_px,
            unit="px",
            detail=_worst_name(edges),
            advice="inspect the overlays; run `std-curate propagate --refine` or annotate the "
            "object again",
        ),
        _gate(
            "shift",
            "shift of the image against the label, worst object",
            _worst(shift),
            options.max_shift_px,
            unit="px",
            detail=_worst_name(shift),
            advice="run `std-curate propagate --refine`; if only frames far from the annotated one "
            "are off, check the scale and the camera poses",
        ),
        _gate(
            "depth",
            "depth residual without the part due to scale, worst diffuse object",
            _worst(depth),
            options.max_depth_mm,
            unit="mm",
            detail=_worst_name(depth)
            + (
                f"; part due to scale: {100 * share:.2f} % of depth"
                if share and _worst(depth) is not None
                else ""
            ),
            advice="the label is displaced along the viewing direction: refine it with depth, or "
            "annotate it in a second frame from the side; check the size of the mesh",
        ),
        _gate(
            "drift",
            "image motion relative to the label that no pose explains, worst object",
            _worst(drift),
            options.max_drift_px,
            unit="px",
            detail=_worst_name(drift),
            advice="the label fits only some frames: check the scale sources, the camera poses, "
            "and whether the object was moved",
        ),
        _gate(
            "covariance",
            "standard deviation of a label, weakest direction, worst object",
            _worst(spread),
            options.max_label_std_mm,
            unit="mm",
            detail=_worst_name(spread),
            advice="annotate it in another frame from a different side, or record a wider sweep",
        ),
        _gate(
            "evidence",
            "labels without support in the images",
            float(len(blind)) if seen else None,
            0.0,
            detail=_names(blind),
            advice="inspect their overlays: a wrong label matches no edges, or those of other "
            "surfaces",
        ),
    ]


def _gate(
    key: str,
    title: str,
    value: float | None,
    limit: float,
    *,
    rule: Literal["at least", "at most"] = "at most",
    unit: str = "",
    detail: str = "",
    advice: str = "",
) -> CheckGate:
    status: Literal["pass", "fail", "open"] = "open"
    if value is not None:
        # Compare the rounded value that is shown, so that "3.00 px, limit 3 px" never fails.
        value = round(value, 3)
        met = value >= limit - 1e-9 if rule == "at least" else value <= limit + 1e-9
        status = "pass" if met else "fail"
    return CheckGate(
        key=key,
        title=title,
        value=value,
        limit=round(limit, 4),
        rule=rule,
        unit=unit,
        status=status,
        detail=detail,
        advice=advice,
    )


def _drift(item: ObjectCheck, options: CheckOptions) -> Number:
    reliable = item.drift_frames >= FEWEST_DRIFT_FRAMES and has_edges(item, options)
    return item.drift_px if reliable and item.material != "transparent" else None


def _at_most(values: dict[str, Number], names: set[str], limit: float) -> dict[str, Number]:
    """The values, those of `names` not above the limit."""
    return {k: v if v is None or k not in names else min(v, limit) for k, v in values.items()}


def _worst(values: dict[str, Number]) -> Number:
    known = [v for v in values.values() if v is not None]
    return max(known) if known else None


def _worst_name(values: dict[str, Number]) -> str:
    worst = _worst(values)
    return "" if worst is None else next(k for k, v in values.items() if v == worst)


def _names(names: Sequence[str]) -> str:
    shown = ", ".join(names[:6])
    return shown + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def _scale_sigma(pairs: Sequence[ScaleDifference], options: CheckOptions) -> Number:
    """Largest difference in joint deviations; small relative differences count as 0."""
    beyond = [p.sigma for p in pairs if p.relative > options.max_scale_disagreement]
    return max(beyond, default=0.0) if pairs else None


def _scale_detail(scale: ScaleReport | None, pairs: Sequence[ScaleDifference]) -> str:
    if scale is None:
        return "no scale source"
    if not pairs:
        return f"only one source ({scale.chosen})"
    used = ", ".join(scale.fused) or scale.chosen
    return f"used: {used}; {pairs[0]}"
