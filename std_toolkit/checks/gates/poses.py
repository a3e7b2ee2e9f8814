"""Gates on the camera poses and their metric scale."""

from __future__ import annotations

from collections.abc import Iterable

from std_toolkit.checks.gates.frames import frame_ranges
from std_toolkit.checks.gates.gate import Measured, Reading, SceneGate
from std_toolkit.checks.result import CheckWarning
from std_toolkit.options import CheckOptions
from std_toolkit.scene.scale_model import differences


def _registered(measured: Measured) -> Reading:
    s = measured.summary
    share = 100 * s.registered / s.frames if s.frames else None
    return Reading(share, detail=f"{s.registered} of {s.frames} frames")


def _scale(measured: Measured) -> Reading:
    """Largest difference in joint deviations; small relative differences count as 0."""
    scale, options = measured.summary.scale, measured.options
    if scale is None:
        return Reading(None, detail="no scale source")
    pairs = differences(scale.estimates)
    if not pairs:
        return Reading(None, detail=f"only one source ({scale.chosen})")
    beyond = [p.sigma for p in pairs if p.relative > options.max_scale_disagreement]
    used = ", ".join(scale.fused) or scale.chosen
    return Reading(max(beyond, default=0.0), detail=f"used: {used}; {pairs[0]}")


def _metres(measured: Measured) -> Reading | None:
    scale = measured.summary.scale
    return Reading(1.0) if scale is not None and scale.unit == "unknown" else None


def _poses(measured: Measured) -> Reading | None:
    if measured.poses is None or not measured.poses.gates:
        return None
    failed = [g for g in measured.poses.gates if not g.passed]
    return Reading(
        float(len(failed)),
        detail="; ".join(f"{g.name}: {g.value:.4g}, limit {g.limit:.4g}" for g in failed),
        advice="; ".join(g.advice for g in failed if g.advice),
    )


def _lost_frames(measured: Measured) -> Iterable[CheckWarning]:
    lost = [f for f in measured.frames if f.status == "unregistered"]
    if lost:
        yield CheckWarning(
            severity="medium" if len(lost) > 0.05 * len(measured.frames) else "low",
            about=f"{len(lost)} frames",
            problem=f"have no camera pose: {frame_ranges([f.frame for f in lost])}",
            advice="they get no labels; record this part again if you need it",
        )


def _scale_warnings(measured: Measured) -> Iterable[CheckWarning]:
    scale = measured.summary.scale
    # Labels refined with biased depth agree with it: no residual reveals a wrong scale.
    if scale is not None and {e.source for e in scale.estimates} == {"depth"}:
        yield CheckWarning(
            severity="medium",
            about="scale",
            problem="the metric scale comes from sensor depth alone, which is 1 to 2 % off: labels "
            "may be off by 10 mm at 0.7 m although they fit the images and the depth",
            advice="run `std-curate propagate --refine --refine-scale` (it uses the known sizes of "
            "the objects), or add a board or an object annotated in several frames",
        )
    yield from _size_warnings(measured)


def _size_warnings(measured: Measured) -> Iterable[CheckWarning]:
    """Camera poses and labels of one wrong scale agree; only the sizes of the objects tell it."""
    summary, options = measured.summary, measured.options
    sizes = summary.sizes
    if sizes is None:
        return
    change = sizes.factor - 1
    if abs(change) <= max(options.max_scale_disagreement, options.max_scale_sigma * sizes.sigma):
        return
    known = summary.scale is not None and summary.scale.applied_sigma < sizes.sigma
    yield CheckWarning(
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


def _scale_title(options: CheckOptions) -> str:
    return (
        "difference of the scale sources in joint standard deviations, "
        f"where above {100 * options.max_scale_disagreement:g} %"
    )


GATES = (
    SceneGate(
        key="registered",
        title="frames with a camera pose",
        measure=_registered,
        limit=lambda options: 100 * options.min_registered,
        rule="at least",
        unit="%",
        advice="run `std-curate poses`; if that is not enough, record again with slower motion "
        "and more texture in view",
        warn=_lost_frames,
    ),
    SceneGate(
        key="reprojection",
        title="mean reprojection error of the camera poses",
        measure=lambda measured: Reading(measured.summary.reprojection_px),
        limit=lambda options: options.max_reprojection_px,
        unit="px",
        advice="check the intrinsics, or let `std-curate poses` refine them with distortion",
    ),
    SceneGate(
        key="scale",
        title=_scale_title,
        measure=_scale,
        limit=lambda options: options.max_scale_sigma,
        advice="select the most reliable source (`std-curate poses --scale ...`), or correct "
        "the depth factor of the sensor in scene.json",
        warn=_scale_warnings,
    ),
    SceneGate(
        key="metres",
        title="poses without a metric scale",
        measure=_metres,
        optional=True,
        advice="give a scale source: sensor depth, a CAD model in two keyframes or a board",
    ),
    SceneGate(
        key="poses",
        title="quality gates of the camera poses that failed",
        measure=_poses,
        optional=True,
        advice="see `std-curate poses`",
    ),
)
