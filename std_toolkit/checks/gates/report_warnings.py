"""Warnings of the report, ranked by severity, each with advice."""

from __future__ import annotations

from collections.abc import Sequence

from std_toolkit.checks import result
from std_toolkit.checks.gates.gates import has_edges, is_confirmed
from std_toolkit.checks.gates.motion_checks import motion_warnings
from std_toolkit.checks.measure.coverage import NARROW_DEG
from std_toolkit.checks.measure.textures import texture_warnings
from std_toolkit.options import CheckOptions
from std_toolkit.scene.model import DIFFUSE_MATERIALS

_ORDER: dict[result.Severity, int] = {"high": 0, "medium": 1, "low": 2}
# Gates whose detail lists the objects or frames concerned.
_NAMING = (
    "labelled", "edges", "shift", "depth", "drift", "covariance", "evidence", "frames", "meshes",
    "texture", "motion", "rotation", "size", "confirmed",
)  # fmt: skip
_LARGE_OFFSET_MM = 3.0
_LOW_VISIBILITY = 0.5
_LARGE_BIAS = 0.004
_LARGE_STEP_DEG = 30.0
_GOOD_COMPLETENESS = 0.8


def find_warnings(
    summary: result.SceneSummary,
    gates: Sequence[result.CheckGate],
    objects: Sequence[result.ObjectCheck],
    frames: Sequence[result.FrameCheck],
    materials: Sequence[result.MaterialDepth],
    options: CheckOptions,
) -> list[result.CheckWarning]:
    """All warnings, the most severe first; failed gates precede all others."""
    found = [
        result.CheckWarning(
            severity="high",
            gate=gate.key,
            about=gate.detail.split(";")[0] if gate.key in _NAMING and gate.detail else gate.key,
            problem=f"{gate.title}: {gate.value:.4g} {gate.unit}".rstrip()
            + f", must be {gate.rule} {gate.limit:g} {gate.unit}".rstrip(),
            advice=gate.advice,
        )
        for gate in gates
        if gate.status == "fail"
    ]
    rest = [
        *_frame_warnings(frames),
        *(w for item in objects for w in _object_warnings(item, options)),
        *motion_warnings(objects, options),
        *texture_warnings(objects),
        *_scale_warnings(summary),
        *_size_warnings(summary, options),
        *_depth_warnings(summary, materials),
    ]
    return found + sorted(rest, key=lambda w: _ORDER[w.severity])


def _frame_warnings(frames: Sequence[result.FrameCheck]) -> list[result.CheckWarning]:
    found = [
        result.CheckWarning(
            severity="high",
            about=f"frame {f.name}",
            problem=f"could not be checked: {f.problem}",
            advice="restore the file or import the recording again",
        )
        for f in frames
        if f.problem
    ]
    lost = [f for f in frames if f.status == "unregistered"]
    if lost:
        found.append(
            result.CheckWarning(
                severity="medium" if len(lost) > 0.05 * len(frames) else "low",
                about=f"{len(lost)} frames",
                problem=f"have no camera pose: {_ranges([f.frame for f in lost])}",
                advice="they get no labels; record this part again if you need it",
            )
        )
    stale = [f for f in frames if f.truth == "stale"]
    if stale:
        found.append(
            result.CheckWarning(
                severity="high",
                about=f"{len(stale)} frames",
                problem="ground truth was rendered from other labels or camera poses: "
                f"{_ranges([f.frame for f in stale])}",
                advice="run `std-curate render`",
            )
        )
    return found


def _object_warnings(item: result.ObjectCheck, options: CheckOptions) -> list[result.CheckWarning]:
    found: list[result.CheckWarning] = []

    def warn(severity: result.Severity, problem: str, advice: str) -> None:
        found.append(
            result.CheckWarning(severity=severity, about=item.name, problem=problem, advice=advice)
        )

    if item.label == "annotated":
        warn("medium", "is annotated but not propagated", "run `std-curate propagate`")
    if item.label not in ("propagated", "refined"):
        return found
    if item.frames_seen == 0:
        warn("high", "is not visible in any measured frame", "check its label and mesh")
        return found
    if not has_edges(item, options):
        share = 100 * (item.edge_support or 0)
        warn(
            "medium",
            f"only {share:.0f} % of its contour is near an image edge: the image weakly supports "
            "the label",
            "inspect its close-ups; annotate it in a frame with more contrast",
        )
    elif not is_confirmed(item, options):
        warn(
            "medium",
            f"its edge distance, {item.edge_px:.1f} px, is no better than chance "
            f"({item.edge_chance_px:.1f} px): the images do not support the label",
            "inspect its close-ups",
        )
    pooled = item.motion_mm is None and has_edges(item, options)
    if pooled and (item.offset_norm_mm or 0) > _LARGE_OFFSET_MM:
        warn(
            "medium",
            f"all frames together place it {item.offset_norm_mm:.1f} mm from its label",
            "run `std-curate propagate --refine`",
        )
    if item.parallax_deg is not None and item.parallax_deg < NARROW_DEG:
        warn(
            "medium",
            f"was seen over only {item.parallax_deg:.0f} degrees: its depth is weakly determined",
            "record a wider sweep around it",
        )
    if (item.largest_step_deg or 0) > _LARGE_STEP_DEG:
        warn(
            "low",
            f"its views have a gap of {item.largest_step_deg:.0f} degrees",
            "record the missing directions if you need them",
        )
    if item.visible_fraction is not None and item.visible_fraction < _LOW_VISIBILITY:
        warn(
            "low",
            f"is half occluded in most frames (visible {100 * item.visible_fraction:.0f} %)",
            "rearrange the objects if it must be visible in this scene",
        )
    if item.weak_direction:
        warn("low", item.weak_direction, "annotate it in a view perpendicular to that direction")
    return found


def _size_warnings(
    summary: result.SceneSummary, options: CheckOptions
) -> list[result.CheckWarning]:
    """Camera poses and labels of one wrong scale agree; only the sizes of the objects tell it."""
    sizes = summary.sizes
    if sizes is None:
        return []
    change = sizes.factor - 1
    limit = max(options.max_scale_disagreement, options.max_scale_sigma * sizes.sigma)
    if abs(change) <= limit:
        return []
    known = summary.scale is not None and summary.scale.applied_sigma < sizes.sigma
    return [
        result.CheckWarning(
            severity="medium",
            about="scale",
            problem="the sizes of the objects ask for camera poses that are "
            f"{100 * abs(change):.1f} % +- {100 * sizes.sigma:.1f} % "
            f"{'larger' if change > 0 else 'smaller'} ({sizes.note})",
            advice="check the sizes of the meshes, and the source of the scale"
            if known
            else "run `std-curate propagate --refine --refine-scale`, or correct the sizes of the "
            "meshes",
        )
    ]


def _scale_warnings(summary: result.SceneSummary) -> list[result.CheckWarning]:
    """Labels refined with biased depth agree with it: no residual reveals a wrong scale."""
    scale = summary.scale
    if scale is None or {e.source for e in scale.estimates} != {"depth"}:
        return []
    return [
        result.CheckWarning(
            severity="medium",
            about="scale",
            problem="the metric scale comes from sensor depth alone, which is 1 to 2 % off: labels "
            "may be off by 10 mm at 0.7 m although they fit the images and the depth",
            advice="run `std-curate propagate --refine --refine-scale` (it uses the known sizes of "
            "the objects), or add a board or an object annotated in several frames",
        )
    ]


def _depth_warnings(
    summary: result.SceneSummary, materials: Sequence[result.MaterialDepth]
) -> list[result.CheckWarning]:
    found = []
    if summary.depth_bias is not None and abs(summary.depth_bias) > _LARGE_BIAS:
        word = "smaller" if summary.depth_bias > 0 else "larger"
        found.append(
            result.CheckWarning(
                severity="low",
                about="sensor depth",
                problem=f"is {100 * abs(summary.depth_bias):.2f} % {word} than the labels on all "
                "diffuse objects: a bias of the sensor or of the scale",
                advice="if the scale comes from a CAD model or a board, multiply depth_correction "
                f"in scene.json by {1 + summary.depth_bias:.4f}",
            )
        )
    holey = {
        m.material: 100 * (1 - m.completeness)
        for m in materials
        if m.material in DIFFUSE_MATERIALS
        and m.completeness is not None
        and m.completeness < _GOOD_COMPLETENESS
    }
    return found + [
        result.CheckWarning(
            severity="low",
            about="sensor depth",
            problem=f"is missing on {share:.0f} % of the {material} surfaces, which the sensor "
            "should measure",
            advice="check the distance, the exposure and the projector",
        )
        for material, share in holey.items()
    ]


def _ranges(ids: Sequence[int], limit: int = 8) -> str:
    """Ids as ranges, such as "3-7, 12"."""
    runs: list[list[int]] = []
    for i in ids:
        if runs and i == runs[-1][1] + 1:
            runs[-1][1] = i
        else:
            runs.append([i, i])
    text = ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in runs[:limit])
    return text + (f" and {len(runs) - limit} more" if len(runs) > limit else "")
