"""Gates on sensor depth: against the labels, and against the colour image."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import hypot

from std_toolkit.checks.gates.gate import Measured, ObjectGate, Reading, Readings, SceneGate
from std_toolkit.checks.result import CheckWarning, Number, ObjectCheck, SceneSummary
from std_toolkit.scene.model import DIFFUSE_MATERIALS
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# The shift must exceed its limit by this many standard deviations to fail.
_SIGMAS = 2.0


@dataclass(frozen=True, kw_only=True)
class DepthSettings(Settings):
    """When sensor depth says something of a label."""

    largest_bias: float = limit(
        0.025,
        source="sensors of this class are biased by 1 to 2 %; a larger common residual has "
        "another cause",
    )
    """largest common residual that is taken for a bias of the sensor"""
    fewest_outlines: int = limit(3, source=NOT_RECORDED)
    """outlines that determine the shift of depth"""
    large_bias: float = limit(0.004, source=NOT_RECORDED)
    """a larger bias brings a warning"""
    good_completeness: float = limit(0.8, source=NOT_RECORDED)
    """a smaller fraction of measured pixels on diffuse surfaces brings a warning"""


def scale_share(summary: SceneSummary) -> float:
    """Relative depth uncertainty from the scale: errors of its sources and of the sensor.

    The largest of: the standard error of the scale, the disagreement of its sources, and the bias
    that all diffuse objects share (if it is plausible for a sensor). One object alone does not tell
    its own error from a bias, which may be as large as is plausible.
    """
    share = 0.0
    if summary.scale is not None:
        share = max(share, summary.scale.consistent().disagreement)
        chosen = [e for e in summary.scale.estimates if e.source == summary.scale.chosen]
        share = max([share, *(e.standard_error for e in chosen)])
    largest = DepthSettings.current().largest_bias
    bias = largest if summary.depth_bias is None else abs(summary.depth_bias)
    return max(share, bias if bias <= largest else 0.0)


def depth_excess_mm(item: ObjectCheck, share: float) -> Number:
    """Part of an object's depth residual that the scale does not explain, in mm."""
    residual, distance = item.value("depth_mm"), item.value("distance_m")
    if residual is None or distance is None:
        return None
    return round(max(0.0, abs(residual) - 1000 * share * distance), 2)


def _depth_detail(found: Readings, measured: Measured) -> str:
    share = scale_share(measured.summary)
    due = f"; part due to scale: {100 * share:.2f} % of depth" if share else ""
    return found[0][0].name + due


def depth_shift_words(shift_px: Sequence[float]) -> str:
    """A shift of depth in words, such as "5.0 px right, 0.1 px up"."""
    x, y = shift_px
    return (
        f"{abs(x):.1f} px {'right' if x >= 0 else 'left'}, "
        f"{abs(y):.1f} px {'down' if y >= 0 else 'up'}"
    )


def _alignment(measured: Measured) -> Reading | None:
    from scipy.special import ndtr, stdtrit

    limits = DepthSettings.current()
    summary = measured.summary
    if summary.depth_shift_px is None or summary.depth_shifts < limits.fewest_outlines:
        return None
    # The deviation of a few outlines is itself uncertain: Student's t instead of the normal.
    wider = float(stdtrit(summary.depth_shifts - 1, ndtr(_SIGMAS))) / _SIGMAS
    return Reading(
        hypot(*summary.depth_shift_px),
        wider * (summary.depth_shift_std_px or 0.0),
        f"depth lies {depth_shift_words(summary.depth_shift_px)} of colour, "
        f"± {summary.depth_shift_std_px:.1f} px, {summary.depth_shifts} outlines",
    )


def _bias_and_holes(measured: Measured) -> Iterable[CheckWarning]:
    limits = DepthSettings.current()
    bias = measured.summary.depth_bias
    if bias is not None and abs(bias) > limits.large_bias:
        yield CheckWarning(
            severity="low",
            about="sensor depth",
            problem=f"is {100 * abs(bias):.2f} % {'smaller' if bias > 0 else 'larger'} than the "
            "labels on all diffuse objects: a bias of the sensor or of the scale",
            advice="if the scale comes from a CAD model or a board, multiply depth_correction "
            f"in scene.json by {1 + bias:.4f}",
        )
    for m in measured.materials:
        if m.material not in DIFFUSE_MATERIALS or m.completeness is None:
            continue
        if m.completeness < limits.good_completeness:
            yield CheckWarning(
                severity="low",
                about="sensor depth",
                problem=f"is missing on {100 * (1 - m.completeness):.0f} % of the {m.material} "
                "surfaces, which the sensor should measure",
                advice="check the distance, the exposure and the projector",
            )


GATES = (
    ObjectGate(
        key="depth",
        title="depth residual without the part due to scale, worst diffuse object",
        measure=lambda item, m: Reading(depth_excess_mm(item, scale_share(m.summary))),
        limit=lambda options: options.max_depth_mm,
        unit="mm",
        detail=_depth_detail,
        advice="the label is displaced along the viewing direction: refine it with depth, or "
        "annotate it in a second frame from the side; check the size of the mesh",
        warn=_bias_and_holes,
        after="shift",
    ),
    SceneGate(
        key="alignment",
        title="shift of sensor depth against colour",
        measure=_alignment,
        limit=lambda options: options.max_alignment_px,
        sigmas=_SIGMAS,
        unit="px",
        advice="align depth to colour with the extrinsics of the sensor, and record both at the "
        "same time",
        after="moved",
    ),
)
