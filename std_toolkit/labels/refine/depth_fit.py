"""How well a pose agrees with the sensor depth in the end, in metres and shares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.object_surface import ObjectSurface
from std_toolkit.labels.refine.observed import ObservedView

_PIXELS_PER_VIEW = 20_000
# A reading explains the surface if it is this close along the ray: metres, and share of the range.
_CLOSE_M, _CLOSE_SHARE = 0.005, 0.01


@dataclass(frozen=True)
class DepthAgreement:
    """Sensor depth on the visible surface of an object at a pose.

    Attributes:
        median_m: median of |rendered - sensor| depth over all readings on the visible surface,
            metres; nan without readings.
        rms_m: root mean square of the distance across the surface of the readings that explain
            it, metres; nan without such.
        explained: share of the readings within 5 mm, or 1 % of the distance, of the surface.
        measured: share of the visible surface that has a reading.
        readings: their number, in pixels of the images.
    """

    median_m: float
    rms_m: float
    explained: float
    measured: float
    readings: int


def measure_depth(
    surface: ObjectSurface,
    observed: Sequence[ObservedView],
    T_world_obj: SE3,
    *,
    depth_factor: float = 1.0,
) -> DepthAgreement:
    """Compare the rendered object with the sensor.

    Args:
        depth_factor: true depth = depth_factor * sensor depth.
    """
    shown = 0
    ratio = 0.0
    along: list[NDArray[np.float64]] = []
    across: list[NDArray[np.float64]] = []
    close: list[NDArray[np.bool_]] = []
    for view in observed:
        pixels = view.thinned(_PIXELS_PER_VIEW)
        T_cam_obj = pixels.T_world_cam.inverse() @ T_world_obj
        hits = surface.cast(pixels.directions, T_cam_obj)
        visible = np.isfinite(hits.depth) & (hits.depth < pixels.others)
        read = visible & (pixels.sensor > 0)
        gap = depth_factor * pixels.sensor[read] - hits.depth[read]
        rays = pixels.directions[read] @ T_cam_obj.R
        shown += int(visible.sum())
        ratio = max(ratio, view.sensor.size / max(len(pixels.uv), 1))
        along.append(np.abs(gap))
        across.append(gap * np.einsum("ij,ij->i", rays, hits.normal[read]))
        close.append(np.abs(gap) < np.maximum(_CLOSE_M, _CLOSE_SHARE * hits.depth[read]))
    gaps = np.concatenate(along) if along else np.empty(0)
    if not len(gaps):
        return DepthAgreement(float("nan"), float("nan"), 0.0, 0.0, 0)
    inside = np.concatenate(close)
    normal = np.concatenate(across)[inside]
    return DepthAgreement(
        float(np.median(gaps)),
        float(np.sqrt(np.mean(normal**2))) if len(normal) else float("nan"),
        float(inside.mean()),
        len(gaps) / shown,
        round(len(gaps) * ratio),
    )
