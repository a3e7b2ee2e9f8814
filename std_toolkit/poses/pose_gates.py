"""Quality gates of camera poses: numbers against limits, and what to do about a failure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from std_toolkit.options import PoseOptions
from std_toolkit.scene.model import Frame, FramePose, Gate, ScaleReport


def pose_gates(
    poses: Sequence[FramePose],
    frames: Sequence[Frame],
    *,
    keyframes: Sequence[int],
    median_distance: float,
    scale: ScaleReport,
    options: PoseOptions,
) -> list[Gate]:
    """Judge the poses of a scene.

    Args:
        poses: one per frame.
        frames: the frames in recording order.
        keyframes: frame ids of the keyframes.
        median_distance: median z-depth of what the cameras see, same unit as the poses.
        scale: where the metres come from.
        options: limits.

    Returns:
        Gates in a fixed order; those that failed say what to do.
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
    again = (
        f"record again around {stretches}: slower, with more overlap and more still texture in view"
    )
    return [
        _at_least("keyframes_registered", key_share, options.min_registered, again),
        _at_least("frames_registered", all_share, options.min_registered, again),
        _at_most(
            "mean_reprojection_px",
            reprojection,
            options.max_reprojection_px,
            "check the intrinsics (try --refine distortion), the focus and the exposure time; "
            "record with less motion blur and fewer moving things in view",
        ),
        _at_most(
            "position_sigma_share",
            sigma,
            options.max_position_sigma,
            "too little still texture or too small an arc: record a wider path, nearer, "
            "with textured things in view",
        ),
        _at_most(
            "scale_disagreement",
            scale.disagreement,
            options.max_disagreement,
            "the scale sources contradict each other: check the sensor's depth correction, the "
            "printed size of the board and the size of the mesh",
        ),
    ]


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
    """Names of unregistered frames, runs written as first..last."""
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
    more = f" and {len(shown) - 4} more" if len(shown) > 4 else ""
    return f"frame {', '.join(shown[:4])}{more}"


def _at_least(name: str, value: float, limit: float, advice: str) -> Gate:
    passed = value >= limit
    return Gate(name=name, value=value, limit=limit, passed=passed, advice="" if passed else advice)


def _at_most(name: str, value: float, limit: float, advice: str) -> Gate:
    # JSON has no infinity; a value that could not be measured counts as very bad.
    value = value if np.isfinite(value) else 1e9
    passed = value <= limit
    return Gate(name=name, value=value, limit=limit, passed=passed, advice="" if passed else advice)
