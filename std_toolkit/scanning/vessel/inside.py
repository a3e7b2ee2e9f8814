"""The inside of a vessel: what the user states of it, and the wall that its rim shows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.scanning.vessel.revolved_surface import Inside, OutlineView, RevolvedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class InsideSettings(Settings):
    """Which statements about the inside of a vessel are refused."""

    thinnest_m: float = limit(0.0003, unit="m", source="thinner than the glass of light bulbs")
    """smallest base, and smallest radius of the hollow"""
    shallowest_m: float = limit(0.002, unit="m", source="a shallower dent is no vessel")
    """smallest depth of the inside"""
    apart_m: float = limit(
        0.003, unit="m", source="two readings of a ruler, and heights that come out 1 to 2 mm high"
    )
    """largest difference of base and depth together from the height of the vessel"""


@dataclass(frozen=True, kw_only=True)
class StatedInside:
    """What the user measured, in millimetres as the options are; None for what is not known.

    Attributes:
        wall_mm: thickness of the wall, `--wall-mm`.
        base_mm: height of the floor of the inside above the table, `--base-mm`.
        depth_mm: of the floor below the rim, `--inside-depth-mm`.
    """

    wall_mm: float | None = None
    base_mm: float | None = None
    depth_mm: float | None = None


def with_inside(
    found: RevolvedSurface, views: Sequence[OutlineView], stated: StatedInside
) -> RevolvedSurface:
    """The vessel with the inside that the user stated; the rest from the rim, or guessed.

    Args:
        found: its outside.
        views: photos, for the rim.
        stated: what the user measured. Base and depth together must make the height; then the
            base counts.

    Raises:
        ToolkitError: a value is outside the vessel, or base and depth contradict its height.
    """
    inside = Inside()
    if stated.wall_mm is not None:
        inside = Inside(wall_m=stated.wall_mm / 1000, wall="stated by the user")
    elif (shown := wall_at_rim(views, found)) is not None:
        inside = Inside(wall_m=shown, wall="seen at the rim")
    floor = _stated_floor(found.height, stated)
    found = replace(found, inside=replace(inside, floor_m=floor))
    if floor is not None:
        _check_open(found, floor, stated)
    return found


def _stated_floor(height: float, stated: StatedInside) -> float | None:
    """Height of the floor of the inside in metres; None if the user does not state it."""
    limits = InsideSettings.current()
    tall, base, depth = 1000 * height, stated.base_mm, stated.depth_mm
    thinnest, shallowest = 1000 * limits.thinnest_m, 1000 * limits.shallowest_m
    if base is not None and base > tall - shallowest:
        raise ToolkitError(
            f"is not in the vessel, which is {tall:.1f} mm high", field="--base-mm", value=base,
            hint="measure the thickness of the base again: height less depth of the inside",
        )  # fmt: skip
    if depth is not None and not shallowest <= depth <= tall - thinnest:
        raise ToolkitError(
            f"is not in the vessel, which is {tall:.1f} mm high", field="--inside-depth-mm",
            value=depth, hint="measure from the rim down to the floor of the inside again",
        )  # fmt: skip
    if base is None:
        return None if depth is None else height - depth / 1000
    if depth is not None and abs(base + depth - tall) > 1000 * limits.apart_m:
        raise ToolkitError(
            f"with --base-mm {base:g} makes {base + depth:.1f} mm, but the vessel is {tall:.1f} mm "
            "high", field="--inside-depth-mm", value=depth,
            hint="measure again, or give one of the two",
        )  # fmt: skip
    return base / 1000


def _check_open(found: RevolvedSurface, floor: float, stated: StatedInside) -> None:
    """Refuse a floor below a place where the walls leave no hollow."""
    above = found.heights >= floor
    shut = above & (found.inner_radii() < InsideSettings.current().thinnest_m)
    if not shut.any():
        return
    place = float(found.heights[shut].max())
    field, value = "--base-mm", stated.base_mm
    if value is None:
        field, value = "--inside-depth-mm", stated.depth_mm
    raise ToolkitError(
        f"the vessel is narrower than two walls of {1000 * found.inside.wall_m:.1f} mm at "
        f"{1000 * place:.0f} mm above the table: its inside cannot reach below", field=field,
        value=value, hint="measure again, or give a thinner --wall-mm",
    )  # fmt: skip


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
