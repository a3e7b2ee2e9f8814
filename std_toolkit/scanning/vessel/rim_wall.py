"""The thickness of a vessel's wall from the inner edge of its rim."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from std_toolkit.scanning.vessel.revolved_surface import OutlineView, RevolvedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class WallSettings(Settings):
    """Which walls are measured at a rim."""

    smallest_m: float = limit(0.0008, unit="m", source=NOT_RECORDED)
    """smallest thickness"""
    largest_m: float = limit(0.012, unit="m", source=NOT_RECORDED)
    """largest thickness"""


def wall_at_rim(views: Sequence[OutlineView], found: RevolvedSurface) -> float | None:
    """Thickness of the wall from the rim's inner edge; None if no photo shows it."""
    limits = WallSettings.current()
    top, radius = float(found.heights[-1]), float(found.radii[-1])
    wall = np.arange(0.0, min(limits.largest_m, 0.6 * radius), 1.5e-4)
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    score, used = np.zeros(len(wall)), 0
    for view in views:
        T = found.T_world_axis.inverse() @ view.T_world_cam
        if view.image is None or T.t[2] < top + 0.3 * np.hypot(*T.t[:2]):
            continue
        grey = cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY).astype(np.float32)
        grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), 0.8), np.float32)
        rings = (radius - wall)[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        circle = np.concatenate([rings, np.full((*rings.shape[:2], 1), top)], axis=2)
        uv = view.camera.project(T.inverse() @ circle.reshape(-1, 3)).reshape(rings.shape)
        value = cv2.remap(
            grey,
            uv[..., 0].astype(np.float32),
            uv[..., 1].astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        change = np.abs(np.gradient(value, axis=0))
        # Where the ring is seen edge-on, walls of any thickness look the same.
        wide = np.linalg.norm(uv[0] - uv[-1], axis=1)
        clear = wide > 0.6 * wide.max()
        score += np.median(change[:, clear] / (change[:, clear].mean(axis=0) + 1.0), axis=1)
        used += 1
    if not used:
        return None
    score /= used
    inner = np.flatnonzero(wall >= limits.smallest_m)
    peaks = [
        i
        for i in inner[:-1]
        if score[i] >= score[i - 1] and score[i] > score[i + 1] and score[i] > 2 * np.median(score)
    ]
    return float(wall[max(peaks, key=lambda i: score[i])]) if peaks else None
