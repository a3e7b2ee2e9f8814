"""Aggregation of the measurements of single frames per object, frame and material."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks import result
from std_toolkit.checks.measure.coverage import (
    CoverageSettings,
    measure_coverage,
    view_directions,
)
from std_toolkit.checks.measure.residuals import FrameObservation, ObjectObservation
from std_toolkit.checks.measure.sensor_depth import (
    DepthResidual,
    DepthShift,
    ErrorTally,
    common_depth_shift,
)
from std_toolkit.scene import Label, Object, Scene
from std_toolkit.settings import NOT_RECORDED, Settings, limit

MATERIAL_ORDER = ("raw", "diffuse", "specular", "transparent")


@dataclass(frozen=True, kw_only=True)
class AggregateSettings(Settings):
    """Measurements of single frames that count."""

    judged_fraction: float = limit(
        0.2,
        source="frames that show less of an object constrain its pose too weakly",
    )
    """smallest visible fraction of an object whose contour counts"""
    close: float = limit(0.6, source=NOT_RECORDED)
    """edge distance over that by chance of a label that fits"""
    fewest_outlines: int = limit(2, source=NOT_RECORDED)
    """outlines that determine the shift of depth in one frame"""


def rounded(value: float | None, digits: int = 3) -> result.Number:
    """The number as the report shows it; null for a missing or infinite one."""
    return None if value is None or not np.isfinite(value) else round(float(value), digits)


def median(values: Sequence[float | None]) -> float | None:
    """Median of the values that are not None."""
    known = [v for v in values if v is not None]
    return float(np.median(known)) if known else None


def common_depth_bias(scene: Scene, observed: Sequence[FrameObservation]) -> float | None:
    """Rendered over sensor depth minus 1, shared by the diffuse objects.

    The median over objects of each object's median. None with fewer than two objects, because one
    displaced label cannot be distinguished from a bias of the sensor.
    """
    per_object = []
    for item in scene.objects.objects:
        found = [
            o.residual.relative for f in observed if (o := f.objects.get(item.id)) and o.residual
        ]
        if found:
            per_object.append(float(np.median(found)))
    return float(np.median(per_object)) if len(per_object) >= 2 else None


def check_objects(
    scene: Scene,
    observed: Sequence[FrameObservation],
    *,
    up: NDArray[np.float64],
    depth_bias: float | None,
) -> list[result.ObjectCheck]:
    """One row per object, in the order of their ids."""
    return [
        _check_object(scene, item, observed, up, depth_bias)
        for item in sorted(scene.objects.objects, key=lambda o: o.id)
    ]


def check_frames(
    scene: Scene, observed: Sequence[FrameObservation], problems: dict[int, str]
) -> list[result.FrameCheck]:
    """One row per frame of the recording.

    Args:
        scene: the scene.
        observed: the frames looked at.
        problems: error line by frame id, of frames that could not be checked.
    """
    limits = AggregateSettings.current()
    looks = {o.frame: o for o in observed}
    poses = {p.frame: p for p in scene.poses.frames} if scene.poses else {}
    rows = []
    for frame in scene.frames:
        pose, look = poses.get(frame.id), looks.get(frame.id)
        rows.append(
            result.FrameCheck(
                frame=frame.id,
                name=frame.name,
                status=pose.status if pose else "no pose",
                reprojection_px=rounded(pose.reprojection_px) if pose else None,
                points=pose.points if pose else 0,
                pose_std_mm=_weakest(pose.covariance, 0, 1000) if pose else None,
                looked_at=look is not None,
                objects_visible=(
                    sum(o.visible_fraction >= limits.judged_fraction for o in look.objects.values())
                    if look
                    else 0
                ),
                edge_px=rounded(median([_edge(o) for o in look.objects.values()]))
                if look
                else None,
                depth_valid=rounded(look.depth_valid, 4) if look else None,
                depth_shift_px=_frame_depth_shift(look) if look else None,
                truth=look.truth if look else "none",  # type: ignore[arg-type]
                problem=problems.get(frame.id, ""),
            )
        )
    return rows


def depth_shifts(observed: Sequence[FrameObservation]) -> list[DepthShift]:
    """Shifts of sensor depth against colour at the outlines of labels that fit in colour."""
    return [
        shift
        for frame in observed
        for o in frame.objects.values()
        if (shift := _against_colour(o)) is not None
    ]


def _against_colour(observation: ObjectObservation) -> DepthShift | None:
    """The shift of depth against the image; the label's own shift is subtracted."""
    limits = AggregateSettings.current()
    edges, depth = observation.edges, observation.depth_shift
    if edges is None or depth is None or observation.visible_fraction < limits.judged_fraction:
        return None
    if observation.shift is not None:
        x_px, y_px = depth.x_px - observation.shift.x_px, depth.y_px - observation.shift.y_px
        return replace(depth, x_px=x_px, y_px=y_px)
    close = edges.median_px is not None and edges.median_px <= limits.close * (edges.chance_px or 0)
    return depth if close else None


def _frame_depth_shift(frame: FrameObservation) -> list[float] | None:
    """Shift of depth in one frame, from at least two objects."""
    found = depth_shifts([frame])
    common = common_depth_shift(found)
    if common is None or len(found) < AggregateSettings.current().fewest_outlines:
        return None
    return [round(common.x_px, 2), round(common.y_px, 2)]


def check_materials(
    scene: Scene, observed: Sequence[FrameObservation]
) -> list[result.MaterialDepth]:
    """Raw depth against ground truth, for each material with measurements."""
    rows = []
    for material in MATERIAL_ORDER:
        ids = {o.id for o in scene.objects.objects if o.material == material}
        tally = ErrorTally.merged(
            [f.tallies[i] for f in observed for i in sorted(ids & set(f.tallies))]
        )
        if tally.truth_pixels == 0:
            continue
        centres, shares = tally.shown_histogram()
        rows.append(
            result.MaterialDepth(
                material=material,
                objects=len(ids),
                pixels=tally.truth_pixels,
                completeness=rounded(tally.completeness, 4),
                median_mm=in_mm(tally.quantile_m(0.5)),
                p05_mm=in_mm(tally.quantile_m(0.05)),
                p95_mm=in_mm(tally.quantile_m(0.95)),
                mae_mm=in_mm(tally.mae_m),
                rmse_mm=in_mm(tally.rmse_m),
                within_10mm=rounded(tally.share_within(0.01), 4),
                histogram_mm=centres,
                histogram_share=shares,
            )
        )
    return rows


def _check_object(
    scene: Scene,
    item: Object,
    observed: Sequence[FrameObservation],
    up: NDArray[np.float64],
    depth_bias: float | None,
) -> result.ObjectCheck:
    limits = AggregateSettings.current()
    label = scene.labels.of(item.id)
    state = "none"
    if label is not None:
        state = "annotated"
        if label.T_world_obj is not None:
            state = "refined" if label.refined else "propagated"
    rows = [(f.frame, f.objects[item.id]) for f in observed if item.id in f.objects]
    judged = [o for _, o in rows if o.visible_fraction >= limits.judged_fraction]
    seen = [f for f, o in rows if o.visible_fraction >= CoverageSettings.current().seen_fraction]
    tally = ErrorTally.merged([f.tallies[item.id] for f in observed if item.id in f.tallies])
    visible = rounded(median([o.visible_fraction for _, o in rows]))
    return result.ObjectCheck(
        object=item.id,
        name=item.name,
        model=item.model,
        category=scene.objects.model(item.model).category,
        material=item.material,
        label=state,  # type: ignore[arg-type]
        annotated_frame=label.frame if label else None,
        frames_seen=len(seen),
        values=[
            *known_values("views", len(rows), visible_fraction=visible),
            *_contour_values(judged),
            *_residual_values(judged, depth_bias),
            *_label_values(label),
            *_coverage_values(scene, item.id, seen, up),
            *known_values(
                "depth",
                completeness=rounded(tally.completeness, 4),
                raw_median_mm=in_mm(tally.quantile_m(0.5)),
                raw_mae_mm=in_mm(tally.mae_m),
                raw_rmse_mm=in_mm(tally.rmse_m),
            ),
        ],
        frames=[_object_frame(f, o, depth_bias) for f, o in rows],
    )


def known_values(
    source: result.Source, frames: int = 0, **numbers: result.Number
) -> list[result.Value]:
    """Values by key, without those that were not measured; a key ends in its unit."""
    return [
        result.Value(key=key, value=number, unit=_unit(key), source=source, frames=frames)
        for key, number in numbers.items()
        if number is not None
    ]


def _unit(key: str) -> Any:
    end = key.rsplit("_", 1)[-1]
    return end if end in ("px", "mm", "m", "deg") else ""


def _contour_values(judged: Sequence[ObjectObservation]) -> list[result.Value]:
    edges = [o.edges for o in judged if o.edges is not None]
    medians = [e.median_px for e in edges if e.median_px is not None]
    shifts = [hypot(o.shift.x_px, o.shift.y_px) for o in judged if o.shift is not None]
    return [
        *known_values(
            "contour",
            len(edges),
            edge_px=rounded(median(medians)),
            edge_p90_px=rounded(float(np.percentile(medians, 90))) if medians else None,
            edge_tail_px=rounded(median([e.p90_px for e in edges])),
            edge_support=rounded(median([e.support for e in edges])),
            edge_chance_px=rounded(median([e.chance_px for e in edges])),
        ),
        *known_values(
            "contour",
            len(shifts),
            shift_px=rounded(median(shifts)) if edges else None,
            shift_share=rounded(len(shifts) / len(edges)) if edges else None,
        ),
    ]


def _residual_values(
    judged: Sequence[ObjectObservation], depth_bias: float | None
) -> list[result.Value]:
    residuals = [o.residual for o in judged if o.residual is not None]
    return known_values(
        "depth",
        len(residuals),
        depth_mm=in_mm(median([r.median_m for r in residuals])),
        depth_mad_mm=in_mm(median([r.mad_m for r in residuals])),
        depth_unscaled_mm=in_mm(median([_unscaled(r, depth_bias) for r in residuals])),
        distance_m=rounded(median([r.depth_m for r in residuals])),
    )


def _label_values(label: Label | None) -> list[result.Value]:
    if label is None:
        return []
    std_mm = _weakest(label.covariance, 0, 1000)
    words = label.weak_direction
    return [
        *(
            [result.Value(key="label_std_mm", value=std_mm, unit="mm", source="label", text=words)]
            if std_mm is not None or words
            else []
        ),
        *known_values("label", label_std_deg=_weakest(label.covariance, 3, 180 / np.pi)),
    ]


def _coverage_values(
    scene: Scene, object_id: int, frames: list[int], up: NDArray[np.float64]
) -> list[result.Value]:
    view = view_directions(scene, object_id, frames, up)
    coverage = None if view is None else measure_coverage(*view)
    if coverage is None:
        return []
    return known_values(
        "views",
        len(frames),
        azimuth_span_deg=rounded(coverage.azimuth_span_deg, 1),
        elevation_min_deg=round(coverage.elevation_min_deg, 1),
        elevation_max_deg=round(coverage.elevation_max_deg, 1),
        parallax_deg=rounded(coverage.parallax_deg, 1),
        largest_step_deg=rounded(coverage.largest_step_deg, 1),
    )


def _unscaled(residual: DepthResidual, bias: float | None) -> float | None:
    """The residual without the common bias, metres."""
    if bias is None:
        return None
    # Bias is relative to the sensor's own depth: rendered = sensor * (1 + bias).
    return residual.median_m - bias / (1 + bias) * residual.depth_m


def _object_frame(
    frame: int, observation: ObjectObservation, depth_bias: float | None
) -> result.ObjectFrameCheck:
    shift = observation.shift
    return result.ObjectFrameCheck(
        frame=frame,
        visible_fraction=round(observation.visible_fraction, 4),
        edge_px=rounded(_edge(observation)),
        edge_support=rounded(observation.edges.support) if observation.edges else None,
        edge_chance_px=rounded(observation.edges.chance_px) if observation.edges else None,
        shift_px=[round(shift.x_px, 2), round(shift.y_px, 2)] if shift else None,
        depth_mm=in_mm(observation.residual.median_m) if observation.residual else None,
        depth_unscaled_mm=in_mm(_unscaled(observation.residual, depth_bias))
        if observation.residual
        else None,
    )


def _edge(observation: ObjectObservation) -> float | None:
    limits = AggregateSettings.current()
    judged = (
        observation.edges is not None and observation.visible_fraction >= limits.judged_fraction
    )
    return observation.edges.median_px if judged and observation.edges is not None else None


def _weakest(covariance: list[float] | None, first: int, unit: float) -> result.Number:
    """Standard deviation along the weakest of three directions of a 6x6 covariance."""
    if covariance is None:
        return None
    block = np.reshape(covariance, (6, 6))[first : first + 3, first : first + 3]
    largest = float(np.linalg.eigvalsh((block + block.T) / 2)[-1])
    return rounded(unit * np.sqrt(max(largest, 0.0)), 3)


def in_mm(metres: float | None) -> result.Number:
    """The length as the report shows it."""
    return None if metres is None else rounded(1000 * metres, 2)
