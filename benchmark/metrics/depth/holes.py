"""Holes elsewhere: depth that was right is removed, and the answer is compared with it.

No ground truth is needed: a recording without glass tells by its own depth what a restorer puts
into a hole. Holes are ellipses, a band at the border, and patches of a smooth random field.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.depth.depth_metrics import delta
from benchmark.metrics.depth.figures import usable
from benchmark.metrics.depth.harm import right_pixels
from std_toolkit.arrays import Floats, Mask
from std_toolkit.geometry.depth_maps import LARGEST_DEPTH_STEP
from std_toolkit.html.table import Column
from std_toolkit.settings import Settings, limit

KINDS = ("ellipses", "band", "patches")

_ORIGIN = "sizes of holes in depth of a D415 and a D435 on tables: 2 to 20 % of the width"


@dataclass(frozen=True, kw_only=True)
class HoleSettings(Settings):
    """Holes that are cut, and depth that is taken for right without ground truth."""

    ellipses: int = limit(8, source="about 5 % of the pixels of an image")
    """how many ellipses are cut into an image"""
    least_radius: float = limit(0.01, unit="of the width", source=_ORIGIN)
    """smallest half axis of an ellipse"""
    largest_radius: float = limit(0.10, unit="of the width", source=_ORIGIN)
    """largest half axis of an ellipse"""
    least_band: float = limit(0.03, unit="of the side", source="shadow of a baseline of 55 mm")
    """narrowest band at the border"""
    largest_band: float = limit(0.12, unit="of the side", source="shadow of a baseline of 55 mm")
    """widest band at the border"""
    patched: float = limit(0.3, unit="of the side", source="a dark or glossy object")
    """sides of the window in which half of the depth goes, in patches"""
    least_right: float = limit(0.8, source="a hole must be in what was right")
    """share of the pixels of an ellipse or a window that were right before"""
    smooth: int = limit(9, unit="px of 640", source="stereo windows of D400 cameras")
    """side of the window in which depth is whole and without a step, to be taken for right"""
    farthest_m: float = limit(1.5, unit="m", source="error of a D400 camera of 1 % of the depth")
    """farther depth is not taken for right without ground truth"""
    fewest_pixels: int = limit(100, source="a median of fewer is no figure")
    """compared pixels that a kind of hole needs in an image"""


def _columns(suffix: str, of: str) -> tuple[Column, ...]:
    return (
        Column(
            name=f"holes{suffix}", heading=f"error in cut holes{of}", unit="mm", factor=1e3,
            lower_is_better=True,
        ),
        Column(
            name=f"holes_d105{suffix}", heading=f"cut holes within 5 %{of}", unit="%", factor=100,
            lower_is_better=False,
        ),
    )  # fmt: skip


COLUMNS = (*_columns("", ""), *_columns("_nearest", ", nearest"))
NAMES = (*(c.name for c in COLUMNS), *(f"holes_{kind}" for kind in KINDS))


@dataclass(frozen=True, eq=False)
class CutHoles:
    """Holes in a depth image.

    Attributes:
        depth: (H, W) metres before they were cut, 0 where nothing was measured.
        right: (H, W) pixels that were right.
        removed: by kind, (H, W) pixels whose depth is removed.
    """

    depth: Floats
    right: Mask
    removed: Mapping[str, Mask]

    @cached_property
    def cut(self) -> Floats:
        """(H, W) metres, 0 in the holes, too."""
        gone = np.logical_or.reduce(list(self.removed.values()))
        return np.where(gone, np.float32(0), self.depth)

    def errors(self, restored: NDArray[np.floating]) -> dict[str, float]:
        """Compare an answer with what was measured, at the pixels that were right.

        Args:
            restored: (H, W) metres that a method gave for `cut`; a missing answer is off by the
                whole depth.

        Returns:
            `holes`: median absolute error in metres, `holes_d105`: share within 5 % (ratio below
            1.05), each the mean over the kinds of holes, so that a large band does not outweigh
            ellipses; `holes_KIND`: the median of each kind, NaN where it was not cut.
        """
        limits = HoleSettings.current()
        medians: dict[str, float] = {}
        shares = []
        for kind, removed in self.removed.items():
            where = removed & self.right
            medians[f"holes_{kind}"] = float("nan")
            if where.sum() < limits.fewest_pixels:
                continue
            found, measured = restored[where].astype(np.float64), self.depth[where]
            error = np.abs(np.where(usable(found), found, 0) - measured)
            medians[f"holes_{kind}"] = float(np.median(error))
            shares.append(delta(found, measured.astype(np.float64), threshold=1.05))
        known = [value for value in medians.values() if not np.isnan(value)]
        means = (np.mean(known), np.mean(shares)) if known else (np.nan, np.nan)
        return {"holes": float(means[0]), "holes_d105": float(means[1]), **medians}


def right_without_truth(depth: Floats) -> Mask:
    """Depth of a plain recording that can be taken for right: near, whole and without a step.

    Args:
        depth: (H, W) metres, 0 where nothing was measured.

    Returns:
        (H, W) bool.

    >>> int(right_without_truth(np.full((20, 20), 0.5, np.float32)).sum())
    400
    """
    limits = HoleSettings.current()
    side = max(3, round(limits.smooth * depth.shape[1] / 640) | 1)
    square, around = np.ones((3, 3), np.uint8), np.ones((side, side), np.uint8)
    # Beyond the border there is no hole and no step.
    step = cv2.dilate(depth, square) - cv2.erode(depth, square)
    whole = (depth > 0) & (step <= LARGEST_DEPTH_STEP * depth)
    whole = cv2.erode(whole.astype(np.uint8), around).astype(bool)
    return np.asarray(whole & (depth < limits.farthest_m))


def cut_holes(
    depth: Floats, key: str, *, true: Floats | None = None, avoid: Mask | None = None, seed: int = 0
) -> CutHoles | None:
    """Remove depth that was right.

    Args:
        depth: (H, W) metres, 0 where nothing was measured.
        key: name of the frame; the same key and seed cut the same holes.
        true: (H, W) true metres: right is what is within max(3 mm, 1 %) of it. Where it is 0, or
            None, `right_without_truth` decides.
        avoid: (H, W) pixels, such as of glass and metal, that no hole touches.
        seed: of all holes.

    Returns:
        The holes; None where too little depth is right to cut any.

    >>> cut = cut_holes(np.full((90, 160), 0.5, np.float32), "a")
    >>> cut.errors(cut.depth)["holes"], cut.errors(cut.cut)["holes"]
    (0.0, 0.5)
    """
    right = right_without_truth(depth)
    if true is not None:
        right = np.where(true > 0, right_pixels(depth, true), right)
    if avoid is not None:
        right &= ~avoid
    draw = np.random.default_rng(int.from_bytes(blake2b(f"{seed} {key}".encode()).digest()[:8]))
    shapes = {
        "ellipses": _ellipses(right, avoid, draw),
        "band": _band(right.shape, draw),
        "patches": _patches(right, avoid, draw),
    }
    removed, taken = {}, np.zeros(right.shape, bool)
    for kind, shape in shapes.items():
        # A hole of one kind in one of another would count twice.
        removed[kind] = shape & ~taken & (depth > 0)
        if avoid is not None:
            removed[kind] &= ~avoid
        taken |= removed[kind]
    found = CutHoles(depth, right, removed)
    fewest = HoleSettings.current().fewest_pixels
    if all((part & right).sum() < fewest for part in removed.values()):
        return None
    return found


def _fits(shape: Mask, right: Mask, avoid: Mask | None) -> bool:
    if avoid is not None and (shape & avoid).any():
        return False
    return bool(right[shape].mean() >= HoleSettings.current().least_right) if shape.any() else False


def _ellipses(right: Mask, avoid: Mask | None, draw: np.random.Generator) -> Mask:
    limits = HoleSettings.current()
    found = np.zeros(right.shape, bool)
    rows, columns = np.nonzero(right)
    if not len(rows):
        return found
    width = right.shape[1]
    for _ in range(limits.ellipses):
        for _ in range(20):  # places to try
            at = int(draw.integers(len(rows)))
            axes = draw.uniform(limits.least_radius, limits.largest_radius, 2) * width
            one = np.zeros(right.shape, np.uint8)
            centre = (int(columns[at]), int(rows[at]))
            sides = (max(1, round(axes[0])), max(1, round(axes[1])))
            cv2.ellipse(one, centre, sides, draw.uniform(0, 180), 0, 360, 1, -1)
            if _fits(one.astype(bool), right, avoid):
                found |= one.astype(bool)
                break
    return found


def _band(shape: tuple[int, ...], draw: np.random.Generator) -> Mask:
    limits = HoleSettings.current()
    found = np.zeros(shape, bool)
    side = int(draw.integers(4))
    length = shape[1] if side < 2 else shape[0]
    width = max(1, round(draw.uniform(limits.least_band, limits.largest_band) * length))
    part = np.s_[:width] if side % 2 else np.s_[-width:]
    if side < 2:
        found[:, part] = True
    else:
        found[part] = True
    return found


def _patches(right: Mask, avoid: Mask | None, draw: np.random.Generator) -> Mask:
    limits = HoleSettings.current()
    height, width = right.shape
    found = np.zeros(right.shape, bool)
    rows, columns = (max(2, round(limits.patched * side)) for side in (height, width))
    for _ in range(20):  # places to try
        top, left = int(draw.integers(height - rows + 1)), int(draw.integers(width - columns + 1))
        window = np.zeros(right.shape, bool)
        window[top : top + rows, left : left + columns] = True
        field = cv2.resize(draw.random((6, 6)), (columns, rows), interpolation=cv2.INTER_CUBIC)
        if _fits(window, right, avoid):
            found[window] = (field > np.median(field)).ravel()
            break
    return found
