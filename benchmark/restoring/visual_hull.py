"""The visual hull of glass and metal: where masks of many views and opaque depth allow it.

Every view tells of a voxel that it sees how much likelier the pixel there is if the voxel belongs
to glass or metal than if it does not; the logarithms are summed. A pixel outside of the mask
speaks against the voxel much more than one inside of it speaks for it, since every voxel of an
object lies inside of all masks, and many others inside of most.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.depth.figures import tolerance
from benchmark.restoring.restorer import GLASS
from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.compiled import compiled
from std_toolkit.geometry.camera import Camera, pixel_rays
from std_toolkit.geometry.se3 import SE3
from std_toolkit.settings import Settings, limit

_TRIED = "ray-cast bottle, tumbler, box and bowl, 12 to 18 views, masks off by up to 2 px"
_FAR = np.float32(1e9)  # metres; no number in compiled code is infinite
_COARSE = 64  # voxels along the longest side of the first grid, which finds where the hull is
_STRIDE = 3  # pixels; for whether masks agree


@dataclass(frozen=True, kw_only=True)
class HullSettings(Settings):
    """What belongs to the hull."""

    edge_mm: float = limit(4.0, unit="mm", source="a stem of a glass is 8 mm wide")
    """largest edge of a voxel"""
    cells: int = limit(150, source="1 to 2 mm for a bottle, as pixels at 0.6 m")
    """voxels along the longest side, if they are then smaller than `edge_mm`"""
    most_voxels: int = limit(8_000_000, source="0.1 s of processor time a view, 40 MB")
    """voxels are made larger beyond this number"""
    missed: float = limit(0.03, source=_TRIED)
    """share of the pixels of glass and metal that a mask misses; a third of it where depth is
    measured"""
    by_chance: float = limit(0.75, source=_TRIED)
    """share of the voxels beside an object that the mask of a view covers"""
    agreeing: float = limit(0.5, source="an empty mask has 0, one eroded by 2 px 0.8")
    """masks that cover less than this share of what the others agree on do not count"""


@dataclass(frozen=True, eq=False)
class PosedView:
    """A restored frame with the pose of its camera; maps are (H, W), the camera is a pinhole.

    Attributes:
        name: of the frame.
        camera: intrinsics.
        T_world_cam: camera to world, metres.
        depth: float32 metres, as restored from this frame alone; 0: no answer.
        spread: float32 metres, expected error of the method's answer.
        clear: float32 in [0, 1], probability of glass or metal.
        kept: pixels whose depth is the sensor's own.
        seen: pixels that the lens shows; None for all.
    """

    name: str
    camera: Camera
    T_world_cam: SE3
    depth: Floats
    spread: Floats
    clear: Floats
    kept: Mask
    seen: Mask | None = None

    @property
    def mask(self) -> Mask:
        """Pixels of glass or metal."""
        found = self.clear >= GLASS
        return found if self.seen is None else found & self.seen

    @property
    def intrinsics(self) -> Array:
        """fx, fy, cx, cy in pixels."""
        c = self.camera
        return np.array([c.fx, c.fy, c.cx, c.cy])


@dataclass(frozen=True, eq=False)
class Grid:
    """A box of voxels in the world frame.

    Attributes:
        origin: (3,) its lowest corner, metres.
        edge: of a voxel, metres.
        shape: number of voxels along x, y and z.
    """

    origin: Array
    edge: float
    shape: tuple[int, int, int]

    @staticmethod
    def over(low: Array, high: Array, edge: float) -> "Grid":
        """The grid from one corner to the other, (3,) metres each."""
        counts = np.maximum(np.ceil((high - low) / edge), 1).astype(int)
        return Grid(low, edge, (int(counts[0]), int(counts[1]), int(counts[2])))


@dataclass(frozen=True, eq=False)
class Entry:
    """Where rays meet the hull; arrays over rays.

    Attributes:
        front, back: z-depth of the first entry and of the last exit, metres; 0: missed.
        across: thickness of the hull behind the entry: the middle of three directions, metres.
    """

    front: Floats
    back: Floats
    across: Floats


@dataclass(frozen=True, eq=False)
class Hull:
    """The hull of all glass and metal.

    Attributes:
        grid: its voxels.
        inside: those that belong to it, uint8.
        counted: for every view whether its mask was used.
        around: sine of half the largest angle between the directions of views; 1: from all sides.
    """

    grid: Grid
    inside: NDArray[np.uint8]
    counted: tuple[bool, ...]
    around: float

    def entry(self, view: PosedView, pixels: Mask) -> Entry:
        """Where the rays of the pixels, row by row, meet the hull."""
        directions = pixel_rays(view.camera)[pixels] @ view.T_world_cam.R.T
        found = np.zeros((3, len(directions)), np.float32)
        grid = self.grid
        _cast(self.inside, grid.origin, grid.edge, view.T_world_cam.t, directions, found)
        return Entry(*found)


def hull_of(views: Sequence[PosedView]) -> Hull | None:
    """The hull of what the masks of at least two views show; None if there is none."""
    box = _reach(views)
    if box is None:
        return None
    coarse = Grid.over(*box, float((box[1] - box[0]).max()) / _COARSE)
    settings = HullSettings.current()
    missed = 5 * settings.missed  # a view may be wrong throughout; see below
    all_of_them = (True,) * len(views)
    odds = _carved(coarse, views, all_of_them, missed, widened=True)
    where = np.argwhere(odds > 0)
    if not len(where):
        return None
    low = coarse.origin + (where.min(axis=0) - 1) * coarse.edge
    high = coarse.origin + (where.max(axis=0) + 2) * coarse.edge
    edge = min(float((high - low).max()) / settings.cells, settings.edge_mm / 1000)
    edge = max(edge, float(np.prod(high - low) / settings.most_voxels) ** (1 / 3))
    grid = Grid.over(low, high, edge)
    around = _around(views, (low + high) / 2)
    odds = _carved(grid, views, all_of_them, missed)
    first = Hull(grid, (odds > 0).astype(np.uint8), all_of_them, around)
    covered = [_covered(first, view) for view in views]
    counted = tuple(share >= settings.agreeing for share in covered)
    inside = (_carved(grid, views, counted, settings.missed) > 0).astype(np.uint8)
    if not inside.any():
        return None
    return Hull(grid, inside, counted, around)


def _reach(views: Sequence[PosedView]) -> tuple[Array, Array] | None:
    """Corners of a box of all that the masks may show, by the answers and their spreads."""
    ends = []
    for view in views:
        pixels = view.mask & (view.depth > 0)
        rays = pixel_rays(view.camera)[pixels][::7]
        depth, spread = view.depth[pixels][::7], view.spread[pixels][::7]
        near, far = np.maximum(depth - 3 * spread, depth / 2), depth + 2 * spread
        ends += [view.T_world_cam @ (rays * z[:, None]) for z in (near, far)]
    points = np.concatenate(ends) if ends else np.zeros((0, 3))
    if len(points) < 8:
        return None
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    margin = 0.02 + 0.05 * float((high - low).max())
    return low - margin, high + margin


def _around(views: Sequence[PosedView], centre: Array) -> float:
    """See `Hull.around`."""
    to = np.array([centre - view.T_world_cam.t for view in views if view.mask.any()])
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    least = float(np.clip((to @ to.T).min(), -1, 1))
    return float(np.sqrt((1 - least) / 2))  # the sine of half that angle


def _carved(
    grid: Grid,
    views: Sequence[PosedView],
    counted: Sequence[bool],
    missed: float,
    *,
    widened: bool = False,
) -> Floats:
    """Log-odds of the voxels; `widened` holds for all points of a voxel, not its centre alone."""
    # Less than any view can add: one view alone makes no hull.
    doubt = 1.01 * np.log((1 - missed) / HullSettings.current().by_chance)
    odds = np.full(grid.shape, -doubt, np.float32)
    for view, counts in zip(views, counted, strict=True):
        if not counts:
            continue
        gain, limit_ = evidence(view, missed)
        lost = -float(np.log((1 - missed) / HullSettings.current().by_chance))
        if widened:
            near = max(float(np.median(view.depth[view.depth > 0])) / 2, 0.05)
            reach = int(np.ceil(0.87 * grid.edge * view.camera.fx / near))
            kernel = np.ones((2 * reach + 1,) * 2, np.uint8)
            gain, limit_ = (np.asarray(cv2.dilate(m, kernel), np.float32) for m in (gain, limit_))
        T = view.T_world_cam.inverse()
        _carve(odds, grid.origin, grid.edge, T.R, T.t, view.intrinsics, gain, limit_, lost)
    return odds


def evidence(view: PosedView, missed: float) -> tuple[Floats, Floats]:
    """What every pixel of a view tells of the voxels on its ray.

    Args:
        view: a view.
        missed: share of the pixels of glass and metal that its mask misses.

    Returns:
        (H, W) log-odds that it adds, and the z-depth, metres, from which on opaque surfaces hide
        voxels from it.
    """
    p, opaque = view.clear, ~view.mask & (view.depth > 0)
    # Who sees an opaque surface behind a voxel sees through it.
    miss = np.where(opaque & view.kept, missed / 3, missed)
    chance = HullSettings.current().by_chance
    inside, outside = p * (1 - miss) + (1 - p) * miss, p * chance + (1 - p) * (1 - chance)
    gain = np.log(inside / outside)
    if view.seen is not None:
        gain = np.where(view.seen, gain, 0)
    noise = tolerance(view.depth) + np.where(view.kept, 0, 2 * view.spread)
    hidden = np.where(opaque, view.depth + noise, _FAR)
    return gain.astype(np.float32), hidden.astype(np.float32)


def _covered(hull: Hull, view: PosedView) -> float:
    """Share of the pixels of the hull that nothing hides and that the mask of the view covers."""
    every = np.zeros(view.depth.shape, bool)
    every[::_STRIDE, ::_STRIDE] = True
    front, hidden = hull.entry(view, every).front, evidence(view, 0.5)[1][every]
    shown = (front > 0) & (front <= hidden)
    return float(view.mask[every][shown].mean()) if shown.any() else 1.0


def _carve_code(
    odds: Any, origin: Any, edge: Any, R: Any, t: Any, K: Any, gain: Any, hidden: Any, lost: Any
) -> None:
    """Add to the log-odds of all voxels what the pixels that show them tell."""
    height, width = gain.shape
    for i in range(odds.shape[0]):
        for j in range(odds.shape[1]):
            px = origin[0] + (i + 0.5) * edge
            py = origin[1] + (j + 0.5) * edge
            pz = origin[2] + 0.5 * edge
            x = R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz + t[0]
            y = R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz + t[1]
            z = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + t[2]
            for k in range(odds.shape[2]):
                if z > 0.01:
                    u = int(np.floor(K[0] * x / z + K[2] + 0.5))
                    v = int(np.floor(K[1] * y / z + K[3] + 0.5))
                    if 0 <= u < width and 0 <= v < height:
                        odds[i, j, k] += gain[v, u] if z <= hidden[v, u] else lost
                x += R[0, 2] * edge
                y += R[1, 2] * edge
                z += R[2, 2] * edge


def _cast_code(inside: Any, origin: Any, edge: Any, eye: Any, directions: Any, found: Any) -> None:
    """Walk rays from voxel to voxel; see `Entry` for what is found."""
    at, step, cell = np.zeros(3), np.zeros(3), np.zeros(3, np.int64)
    after, length = np.zeros(3), np.zeros(3)
    for n in range(directions.shape[0]):
        begin, end = 0.0, 1e9
        for a in range(3):
            d, far = directions[n, a], origin[a] + edge * inside.shape[a]
            if abs(d) < 1e-12:
                d = 1e-12
            one, other = (origin[a] - eye[a]) / d, (far - eye[a]) / d
            begin, end = max(begin, min(one, other)), min(end, max(one, other))
            step[a], length[a] = (1.0 if d > 0 else -1.0), edge / abs(d)
        if begin >= end:
            continue
        for a in range(3):
            d = directions[n, a] if abs(directions[n, a]) >= 1e-12 else 1e-12
            at[a] = (eye[a] + begin * d - origin[a]) / edge
            cell[a] = min(max(int(np.floor(at[a])), 0), inside.shape[a] - 1)
            border = cell[a] + (1.0 if d > 0 else 0.0)
            after[a] = begin + (border - at[a]) * edge / d
        z, entered = begin, False
        while True:
            a = 0
            if after[1] < after[a]:
                a = 1
            if after[2] < after[a]:
                a = 2
            if inside[cell[0], cell[1], cell[2]]:
                if not entered:
                    entered = True
                    found[0, n] = max(z, 1e-6)
                    found[2, n] = edge * _across(inside, cell)
                found[1, n] = after[a]
            z = after[a]
            cell[a] += int(step[a])
            if cell[a] < 0 or cell[a] >= inside.shape[a]:
                break
            after[a] += length[a]


def _across_code(inside: Any, cell: Any) -> float:
    """The middle of the lengths, in voxels, of the hull through a voxel along x, y and z."""
    runs = np.zeros(3)
    for a in range(3):
        for way in (-1, 1):
            i, j, k = cell[0], cell[1], cell[2]
            while True:
                if a == 0:
                    i += way
                elif a == 1:
                    j += way
                else:
                    k += way
                if i < 0 or j < 0 or k < 0:
                    break
                if i >= inside.shape[0] or j >= inside.shape[1] or k >= inside.shape[2]:
                    break
                if not inside[i, j, k]:
                    break
                runs[a] += 1
    return float(runs.sum() - runs.min() - runs.max() + 1)


_carve = compiled(_carve_code, error_model="numpy")
_across = compiled(_across_code)
_cast = compiled(_cast_code, error_model="numpy")
