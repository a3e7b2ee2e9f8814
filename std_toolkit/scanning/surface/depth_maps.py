"""Depth maps of the photos of a scan: neighbouring photos, the hull as a start, two resolutions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.plugins import Registry
from std_toolkit.scanning.photos.views import View, in_threads
from std_toolkit.scanning.photos.visibility import hull_depth
from std_toolkit.scanning.surface.patch_match import Map, match
from std_toolkit.settings import Settings, limit

# Angles between viewing directions: below, depth is uncertain; above, windows look different.
_BEST_ANGLE_DEG = 15.0


@dataclass(frozen=True, kw_only=True)
class NeighbourSettings(Settings):
    """Photos that are compared for depth."""

    largest_angle_deg: float = limit(45.0, unit="deg", source="above, windows look different")
    """largest angle between viewing directions"""
    smallest_angle_deg: float = limit(4.0, unit="deg", source="below, depth is uncertain")
    """smallest angle between viewing directions"""


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth and normal of one photo in a window of it.

    Attributes:
        x, y: top-left pixel of the window.
        depth: (h, w) z-depth in metres, 0 for none.
        normal: (h, w, 3) unit normal in the camera frame.
        cost: (h, w) mean of 1 - correlation over the better half of the neighbours.
        contrast: (h, w) standard deviation of the grey values in the window of correlation.
    """

    x: int
    y: int
    depth: Map
    normal: Map
    cost: Map
    contrast: Map


class DepthEngine(Protocol):
    """Makes the depth maps of a scan; `depth_maps` of this module is the built-in one."""

    def __call__(
        self,
        views: Sequence[View],
        hull: tuple[Array, NDArray[np.int64]],
        *,
        deepest: float,
        neighbours: int,
        threads: int,
    ) -> list[DepthMap | None]:
        """Depth maps in the order of the photos; arguments as of `depth_maps`."""
        ...


ENGINES: Registry[DepthEngine] = Registry(
    "std_toolkit.scan_depth",
    {
        "patchmatch": "std_toolkit.scanning.surface.depth_maps:depth_maps",
        "colmap": "std_toolkit.scanning.surface.colmap_depth:colmap_depth",
    },
)


def depth_engine(name: str) -> DepthEngine:
    """The engine of a name, which may have a function `check` that raises where it cannot run.

    Raises:
        ToolkitError: there is no such engine, or it cannot run here.
    """
    engine = ENGINES.get(name)
    check = getattr(engine, "check", None)
    if check is not None:
        check()
    return engine


def choose_neighbours(views: Sequence[View], target: Array, count: int) -> list[list[int]]:
    """For each view, the others that see `target` from a suitable angle, best first.

    Args:
        views: all photos.
        target: (3,) centre of the object.
        count: largest number of neighbours.
    """
    limits = NeighbourSettings.current()
    rays = np.stack([v.centre - target for v in views])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(rays @ rays.T, -1, 1)))
    found = []
    for i in range(len(views)):
        score = np.abs(np.log(np.maximum(angle[i], 1e-3) / _BEST_ANGLE_DEG))
        # Views within 4 degrees of a chosen one add little; wide ones help where few are near.
        order = [int(j) for j in np.argsort(score) if j != i]
        chosen: list[int] = []
        for j in order:
            if not limits.smallest_angle_deg <= angle[i, j] <= limits.largest_angle_deg:
                continue
            if any(angle[j, k] < limits.smallest_angle_deg for k in chosen):
                continue
            chosen.append(j)
            if len(chosen) == count:
                break
        found.append(chosen)
    return found


def depth_maps(
    views: Sequence[View],
    hull: tuple[Array, NDArray[np.int64]],
    *,
    deepest: float,
    neighbours: int,
    threads: int,
) -> list[DepthMap | None]:
    """Depth maps of all photos; None for a photo without neighbours or that misses the object.

    Args:
        views: photos with masks.
        hull: closed surface that contains the object; the search starts at it.
        deepest: largest depth below the hull, metres.
        neighbours: number of photos that each is compared with.
        threads: number of threads.
    """
    vertices, faces = hull
    target = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    chosen = choose_neighbours(views, target, neighbours)
    caster = RayCaster(vertices - target, faces, threads=1)
    greys: list[Any] = [cv2.GaussianBlur(v.grey(), (0, 0), 0.6) for v in views]
    return in_threads(
        lambda i: _one(i, views, greys, chosen[i], caster, target, deepest),
        range(len(views)),
        threads=threads,
    )


def object_window(mask: NDArray[np.bool_], margin: int) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1 around the true pixels; None if there are none."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    h, w = mask.shape
    return (
        max(int(columns[0]) - margin, 0),
        max(int(rows[0]) - margin, 0),
        min(int(columns[-1]) + 1 + margin, w),
        min(int(rows[-1]) + 1 + margin, h),
    )


def _one(
    index: int,
    views: Sequence[View],
    greys: Sequence[Map],
    chosen: Sequence[int],
    caster: RayCaster,
    target: Array,
    deepest: float,
) -> DepthMap | None:
    view = views[index]
    window = object_window(view.shown, 2)
    if not chosen or window is None:
        return None
    x0, y0, x1, y1 = window
    start, normal = hull_depth(view, caster, target, window)
    mask = (view.shown[y0:y1, x0:x1] & (start > 0)).astype(np.uint8)
    if mask.sum() < 50:
        return None
    others = [greys[j] for j in chosen]
    T = [views[j].T_world_cam.inverse() @ view.T_world_cam for j in chosen]
    coarse = match(
        _shrink(greys[index]), [_shrink(g) for g in others], _half_K(view.camera.K),
        np.stack([_half_K(views[j].camera.K) for j in chosen]), T,
        (x0 // 2, y0 // 2), mask[::2, ::2], start[::2, ::2], normal[::2, ::2], None,
        deepest, iterations=4, seed=index,
    )  # fmt: skip
    size = (x1 - x0, y1 - y0)
    depth: Any = cv2.resize(coarse[0], size, interpolation=cv2.INTER_NEAREST)
    turned: Any = cv2.resize(coarse[1], size, interpolation=cv2.INTER_NEAREST)
    depth = np.where(depth > 0, depth, start)
    fine = match(
        greys[index], others, view.camera.K, np.stack([views[j].camera.K for j in chosen]), T,
        (x0, y0), mask, start, normal, (depth, turned), deepest, iterations=2, seed=index,
    )  # fmt: skip
    return DepthMap(x0, y0, *fine)


def _shrink(image: Map) -> Map:
    h, w = image.shape
    return cv2.resize(image, (w // 2, h // 2), interpolation=cv2.INTER_AREA)  # type: ignore[return-value]


def _half_K(K: Array) -> Array:
    half = K.copy()
    half[:2] *= 0.5
    half[:2, 2] -= 0.25
    return half
