"""Quality gates of the camera poses, and the summary of poses in lines."""

from collections.abc import Sequence

import numpy as np

from std_toolkit.errors import listed
from std_toolkit.options import PoseOptions
from std_toolkit.scene import CameraPoses, Frame, FramePose
from std_toolkit.scene.model import Gate, ScaleReport
from std_toolkit.scene.scale_model import differences


def failed_gates(poses: CameraPoses) -> list[str]:
    """Return one line per failed gate with its value, its limit and advice."""
    return [
        f"{g.name} is {g.value:.4g}, limit {g.limit:.4g}: {g.advice}"
        for g in poses.gates
        if not g.passed
    ]


def pose_lines(poses: CameraPoses, names: list[str]) -> list[str]:
    """Summary lines of the camera poses."""
    lost = [name for p, name in zip(poses.frames, names, strict=True) if p.status != "registered"]
    lines = [f"registered {len(names) - len(lost)} of {len(names)} frames"]
    if lost:
        lines.append(f"  unregistered: {', '.join(lost[:8])}{' ...' if len(lost) > 8 else ''}")
    lines += [f"  note: {note}" for note in poses.notes]
    for gate in poses.gates:
        mark = "ok    " if gate.passed else "FAILED"
        lines.append(f"  {mark} {gate.name}: {gate.value:.4g} (limit {gate.limit:.4g})")
    if poses.scale is not None:
        lines.append(_scale_line(poses.scale))
        lines += [
            f"  {e.source}: {e.factor:.6g} m per unit, spread {100 * e.spread:.2f} %, "
            f"standard error {100 * e.standard_error:.3f} %, deviation {100 * e.sigma:.2f} %, "
            f"n = {e.count} ({e.note})"
            for e in poses.scale.estimates
        ]
    for key, camera in poses.cameras.items():
        values = " ".join(f"{v:.2f}" for v in (camera.fx, camera.fy, camera.cx, camera.cy))
        extra = " ".join(f"{v:.4f}" for v in camera.distortion)
        lines.append(f"camera {key}: {values}" + (f" distortion {extra}" if extra else ""))
    return lines


def _scale_line(scale: ScaleReport) -> str:
    line = f"scale: {scale.chosen}, unit {scale.unit}"
    if scale.factor is not None:
        line += f", {scale.factor:.6g} m per unit +- {100 * scale.applied_sigma:.2f} %"
    if len(scale.fused) > 1:
        line += f", weighted mean of {', '.join(scale.fused)}"
    return line


def pose_gates(
    poses: Sequence[FramePose],
    frames: Sequence[Frame],
    *,
    keyframes: Sequence[int],
    median_distance: float,
    scale: ScaleReport,
    options: PoseOptions,
) -> list[Gate]:
    """Compute the quality gates of the poses of a scene.

    Args:
        poses: one per frame.
        frames: the frames in recording order.
        keyframes: frame ids of the keyframes.
        median_distance: median z-depth of the observed points, in the unit of the poses.
        scale: scale report.
        options: limits.

    Returns:
        Gates in a fixed order; failed ones carry advice.
    """
    by_id = {p.frame: p for p in poses}
    registered = [p for p in poses if p.status == "registered"]
    lost = [f.name for f in frames if by_id[f.id].status != "registered"]
    keys = [by_id[k] for k in keyframes]
    key_share = sum(p.status == "registered" for p in keys) / max(1, len(keys))
    all_share = len(registered) / max(1, len(poses))
    errors = [p.reprojection_px for p in registered if p.reprojection_px is not None]
    weights = [p.points for p in registered if p.reprojection_px is not None]
    reprojection = float(np.average(errors, weights=weights)) if errors else float("inf")
    sigma = _position_sigma(registered, median_distance)
    stretches = _stretches(frames, lost)
    again = f"record again around {stretches}: slower, with more overlap and static texture in view"
    return [
        _at_least("keyframes_registered", key_share, options.min_registered, again),
        _at_least("frames_registered", all_share, options.min_registered, again),
        _at_most(
            "mean_reprojection_px",
            reprojection,
            options.max_reprojection_px,
            "check the intrinsics (try --refine distortion), the focus and the exposure time; "
            "record with less motion blur and fewer moving objects in view",
        ),
        _at_most(
            "position_sigma_share",
            sigma,
            options.max_position_sigma,
            "too little static texture or too small an arc: record a wider path, nearer, "
            "with textured objects in view",
        ),
        _at_most(
            "scale_disagreement",
            _disagreement_sigma(scale, options),
            options.max_disagreement_sigma,
            "the scale sources contradict each other: check the sensor's depth correction, the "
            "printed size of the board and the size of the mesh",
        ),
    ]


def _disagreement_sigma(scale: ScaleReport, options: PoseOptions) -> float:
    """Largest difference of two sources in joint deviations; relatively small ones count as 0."""
    found = differences(scale.estimates)
    return max((d.sigma for d in found if d.relative > options.max_disagreement), default=0.0)


def matches_gate(explained: float) -> Gate:
    """Gate of a small set whose pairs were all matched; a ring may close on the wrong side."""
    from std_toolkit.poses.small_sets import SmallSetSettings

    return _at_least(
        "matches_explained",
        explained,
        SmallSetSettings.current().explained,
        "matches of neighbouring images contradict the poses: sides that look alike were taken for "
        "one; put texture around the object, or give known poses with --cameras",
    )


def _position_sigma(registered: Sequence[FramePose], distance: float) -> float:
    sigmas = []
    for pose in registered:
        if pose.covariance is not None:
            C = np.asarray(pose.covariance).reshape(6, 6)
            sigmas.append(float(np.sqrt(max(0.0, np.trace(C[:3, :3])))))
    if not sigmas or distance <= 0:
        return float("inf")
    return float(np.median(sigmas)) / distance


def _stretches(frames: Sequence[Frame], lost: Sequence[str]) -> str:
    """Names of the unregistered frames, with runs as first..last."""
    if not lost:
        return "the unregistered frames"
    missing = set(lost)
    runs: list[list[str]] = []
    previous_missing = False
    for frame in frames:
        if frame.name in missing:
            if previous_missing:
                runs[-1].append(frame.name)
            else:
                runs.append([frame.name])
        previous_missing = frame.name in missing
    shown = [run[0] if len(run) == 1 else f"{run[0]}..{run[-1]}" for run in runs]
    return f"frame {listed(shown, 4)}"


def _at_least(name: str, value: float, limit: float, advice: str) -> Gate:
    passed = value >= limit
    return Gate(name=name, value=value, limit=limit, passed=passed, advice="" if passed else advice)


def _at_most(name: str, value: float, limit: float, advice: str) -> Gate:
    # JSON has no infinity: a value that could not be measured gets a large number.
    value = value if np.isfinite(value) else 1e9
    passed = value <= limit
    return Gate(name=name, value=value, limit=limit, passed=passed, advice="" if passed else advice)
