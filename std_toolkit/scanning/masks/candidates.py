"""What stands on the table: parts of a coarse hull."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from std_toolkit.arrays import Array, Mask
from std_toolkit.scanning.masks.hull import surface_of
from std_toolkit.scanning.masks.table_comparison import Comparison, compare
from std_toolkit.scanning.masks.table_model import MOST_CELLS, model_tables
from std_toolkit.scanning.photos.views import Grid, View, in_threads
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Voxels of the first, coarse hull.
_COARSE_VOXELS = 400_000
# Height of an object in sizes of the board.
_TALLEST = 2.0
# Sizes of the inner part of a hull of points, and of what may belong to the object.
_INNER, _OUTER = 0.7, 1.15
# Rim of a coarse hull that may not be the object, as a share of the depth where it is deepest.
_RIM = 0.3

Surface = tuple[Array, NDArray[np.int64]]


@dataclass(frozen=True, kw_only=True)
class CandidateSettings(Settings):
    """What counts as an object on the table."""

    small: float = limit(0.02, source=NOT_RECORDED)
    """candidates smaller than this share of the largest are not offered"""
    hides: float = limit(0.2, source=NOT_RECORDED)
    """share of the photos in which an object hides the table"""
    above_m: float = limit(0.004, unit="m", source=NOT_RECORDED)
    """height above the table from which a voxel or a point counts as part of an object"""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something that stands on the table.

    Attributes:
        low, high: (3,) corners of its bounding box, world.
        volume: cubic metres of its coarse hull.
        vertices, faces: surface of its coarse hull.
        voxels: surfaces (vertices, faces) of all that may belong to it, which includes what is
            above the hull and stands before no known table in any photo, and of its inner part.
            None if it was found by points alone.
        points: (N, 3) its features, if it was found by these.
    """

    low: Array
    high: Array
    volume: float
    vertices: Array
    faces: NDArray[np.int64]
    voxels: tuple[Surface, Surface] | None = None
    points: Array | None = None

    @property
    def outer(self) -> Surface:
        """Surface of all that may belong to it."""
        return self._scaled(_OUTER) if self.voxels is None else self.voxels[0]

    @property
    def inner(self) -> Surface:
        """Surface of the part that certainly belongs to it."""
        return self._scaled(_INNER) if self.voxels is None else self.voxels[1]

    def _scaled(self, factor: float) -> Surface:
        middle = (self.low + self.high) / 2
        return middle + factor * (self.vertices - middle), self.faces


@dataclass(frozen=True, eq=False)
class CoarseHull:
    """Voxels on and beside the board that hide the table from photos.

    Attributes:
        different: number of photos in which each voxel hides the table.
        possible: voxels that few photos see the bare table through.
        grid: the voxels.
        compared: the photos against the table.
        board: (2,) low and high corner of the board.
    """

    different: NDArray[np.int16]
    possible: Mask
    grid: Grid
    compared: list[Comparison]
    board: tuple[Array, Array]

    @property
    def solid(self) -> Mask:
        """Voxels of what stands there."""
        return self.possible & (self.different >= 3)

    def silhouettes(self, views: Sequence[View]) -> list[Mask]:
        """Pixels (H, W) of photos, of any size, before which something stands."""
        return _silhouettes(views, self.solid, self.grid)


def find_candidates(
    views: Sequence[View], corners: Array, bare: Mapping[str, Array] | None = None, *, threads: int
) -> tuple[list[Candidate], list[Comparison]]:
    """What stands on the board or beside it, largest first, and the photos against the table.

    Args:
        views: photos.
        corners: (M, 3) corners of the board, world.
        bare: as of `compare_with_table`.
        threads: number of threads.
    """
    hull = coarse_hull(views, corners, bare, threads=threads)
    return split_hull(hull, len(views))[0], hull.compared


def coarse_hull(
    views: Sequence[View], corners: Array, bare: Mapping[str, Array] | None = None, *,
    cells: int = MOST_CELLS, threads: int,
) -> CoarseHull:  # fmt: skip
    """Voxels of all that stands on the board or beside it.

    Args:
        views: photos.
        corners: (M, 3) corners of the board, world.
        bare: as of `compare_with_table`.
        cells: number of cells of the table at most.
        threads: number of threads.
    """
    limits = CandidateSettings.current()
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    size = float((high - low).max())
    # Objects stand on the board or reach over its border by a little.
    edge = 0.12 * size
    low, high = low - edge, high + edge
    tallest = min(float(np.percentile([v.centre[2] for v in views], 75)), _TALLEST * size)
    box = np.array([*(high - low), tallest])
    step = float((box.prod() / _COARSE_VOXELS) ** (1 / 3))
    grid = Grid.around(np.array([*low, limits.above_m]), np.array([*high, tallest]), step, margin=0)

    compared = compare_with_table(views, corners, bare=bare, cells=cells, threads=threads)
    different, possible = _not_carved(views, compared, grid)
    # What stands on the table hides the cells below it from all photos. Their colour is its own,
    # which may pass for that of the table: look at the table once more without them.
    blocked = _silhouettes(views, possible & (different >= 3), grid)
    compared = compare_with_table(views, corners, blocked, bare=bare, cells=cells, threads=threads)
    different, possible = _not_carved(views, compared, grid)
    return CoarseHull(different, possible, grid, compared, (low + edge, high - edge))


def compare_with_table(
    views: Sequence[View],
    corners: Array,
    blocked: Sequence[Mask] | None = None,
    *,
    bare: Mapping[str, Array] | None = None,
    cells: int = MOST_CELLS,
    threads: int,
) -> list[Comparison]:
    """The photos against the table on which they agree.

    Args:
        views, corners, blocked, cells: as of `model_tables`.
        bare: corners (N, 4, 2) in pixels of bare tags, by the name of the photo.
        threads: number of threads.
    """
    tables = model_tables(views, corners, blocked, cells=cells)
    bare = bare or {}

    def one(i: int) -> Comparison:
        quads = bare.get(views[i].name)
        found = compare(views[i], tables, i)
        return found if quads is None else _with_bare(found, quads)

    return in_threads(one, range(len(views)), threads=threads)


def _with_bare(compared: Comparison, quads: Array) -> Comparison:
    """The comparison with tags (N, 4, 2) that are bare: their edges differ by blur."""
    tags = np.zeros(compared.clear.shape, np.uint8)
    for quad in np.rint(quads).astype(np.int32):
        cv2.fillConvexPoly(tags, quad, 1)
    # The rim may be that of something before it.
    shown = cv2.erode(tags, np.ones((3, 3), np.uint8)) > 0
    return Comparison(
        compared.clear | shown, compared.different & ~shown, compared.known | shown,
        compared.beyond & ~shown,
    )  # fmt: skip


def _silhouettes(views: Sequence[View], solid: Mask, grid: Grid) -> list[Mask]:
    """Pixels (H, W) of each photo that show voxels; horizontal holes of them are filled."""
    solid = np.stack([ndimage.binary_fill_holes(layer) for layer in solid])
    vertices, faces = surface_of(np.where(solid, -grid.step, grid.step).astype(np.float32), grid)
    found = []
    for view in views:
        uv, z = view.project(vertices)
        drawn = np.zeros(view.image.shape[:2], np.uint8)
        triangles = uv[faces][(np.isfinite(uv).all(axis=1) & (z > 0))[faces].all(axis=1)]
        for part in np.rint(triangles).astype(np.int32):
            cv2.fillConvexPoly(drawn, part, 1)
        found.append(drawn > 0)
    return found


def _not_carved(
    views: Sequence[View], compared: Sequence[Comparison], grid: Grid
) -> tuple[NDArray[np.int16], Mask]:
    """Number of photos in which each voxel hides the table, and voxels that may hide it.

    The latter stand before the bare table in few photos.
    """
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), axis=-1)
    points = grid.points(index.reshape(-1, 3))
    clear = np.zeros(len(points), np.int16)
    different = np.zeros(len(points), np.int16)
    for view, c in zip(views, compared, strict=True):
        homogeneous = points @ view.P[:, :3].T + view.P[:, 3]
        z = homogeneous[:, 2]
        h, w = view.image.shape[:2]
        with np.errstate(divide="ignore", invalid="ignore"):
            x = np.rint(homogeneous[:, 0] / z)
            y = np.rint(homogeneous[:, 1] / z)
        ok = (z > 0.02) & (x >= 0) & (y >= 0) & (x < w) & (y < h)
        xi, yi = x[ok].astype(np.int64), y[ok].astype(np.int64)
        # The coarse voxel covers several pixels: all of them must be clear.
        radius = max(0, round(0.35 * grid.step * view.camera.fx / float(np.median(z[ok])))) if (
            ok.any()
        ) else 0  # fmt: skip
        kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
        whole = cv2.erode(c.clear.astype(np.uint8), kernel) > 0
        clear[ok] += whole[yi, xi]
        different[ok] += c.different[yi, xi]
    possible = (clear <= np.maximum(1, 0.12 * different)).reshape(grid.shape)
    return different.reshape(grid.shape), possible


def split_hull(hull: CoarseHull, photos: int) -> tuple[list[Candidate], NDArray[np.int32]]:
    """Connected parts of a coarse hull that begin near the table, largest first.

    Returns:
        The parts, and the number of the part of each voxel, from 1; 0 for none.
    """
    limits = CandidateSettings.current()
    different, possible, grid = hull.different, hull.possible, hull.grid
    labels = _labelled(hull)
    found: list[tuple[int, Candidate]] = []
    bottom = max(2, round(0.02 / grid.step))
    for n, place in enumerate(ndimage.find_objects(labels), start=1):
        part = labels[place] == n
        volume = float(part.sum()) * grid.step**3
        if part.sum() < 12 or place[0].start > bottom or volume < 5e-7:
            continue
        # Places that few photos show well are not carved, but do not hide the table either.
        if np.percentile(different[place][part], 90) < limits.hides * photos:
            continue
        start = np.array([s.start for s in place])
        corner = grid.points(start[None])[0]
        local = Grid(tuple(corner), grid.step, part.shape)
        field = np.where(part, -grid.step, grid.step).astype(np.float32)
        vertices, faces = surface_of(field, local)
        surfaces = _outer(labels == n, possible, grid), _inner(part, local)
        found.append((n, Candidate(
            vertices.min(axis=0), vertices.max(axis=0), volume, vertices, faces, surfaces,
        )))  # fmt: skip
    found.sort(key=lambda f: -f[1].volume)
    found = [f for f in found if f[1].volume > limits.small * found[0][1].volume]
    number = np.zeros(int(labels.max()) + 1, np.int32)
    number[[n for n, _ in found]] = np.arange(1, len(found) + 1)
    return [c for _, c in found], number[labels]


def _labelled(hull: CoarseHull) -> NDArray[np.int32]:
    """Numbers of the connected parts of a hull above the board; what is beside it joins the
    nearest part, but joins no two: too few photos show the table there."""
    x, y = (
        hull.grid.origin[k] + np.arange(n) * hull.grid.step
        for k, n in enumerate(hull.grid.shape[:0:-1])
    )
    low, high = hull.board
    above = ((y >= low[1]) & (y <= high[1]))[:, None] & ((x >= low[0]) & (x <= high[0]))
    labels, count = ndimage.label(hull.solid & above)
    if not count:
        return np.asarray(labels, np.int32)
    nearest = ndimage.distance_transform_edt(labels == 0, return_distances=False,
                                             return_indices=True)  # fmt: skip
    joined = np.where(hull.solid, labels[tuple(nearest)], 0)
    # Not across a gap.
    for n, place in enumerate(ndimage.find_objects(joined), start=1):
        part = joined[place] == n
        pieces, number = ndimage.label(part)
        if number > 1:
            own = np.unique(pieces[part & (labels[place] == n)])
            joined[place][part & ~np.isin(pieces, own)] = 0
    return np.asarray(joined, np.int32)


def _outer(part: Mask, possible: Mask, grid: Grid) -> Surface:
    """Surface of a part with a margin, and of the possible voxels above it."""
    near = ndimage.binary_dilation(part, iterations=2)
    footprint = near.any(axis=0)
    above = possible & footprint[None]
    # Below its top, the part itself is the limit.
    top = int(np.flatnonzero(part.any(axis=(1, 2)))[-1])
    above[: max(0, top - 2)] = False
    labels, _ = ndimage.label(near | above)
    joined = np.isin(labels, np.unique(labels[part])) & (labels > 0)
    return surface_of(np.where(joined, -grid.step, grid.step).astype(np.float32), grid)


def _inner(part: Mask, grid: Grid) -> Surface:
    """Surface of the voxels of a part that are deep in it, whatever its shape."""
    # Below is the table, not the outline.
    padded = np.pad(part, ((0, 1), (1, 1), (1, 1)))
    depth = ndimage.distance_transform_edt(padded)[:-1, 1:-1, 1:-1]
    limit = _RIM * float(depth.max())
    return surface_of(((limit - depth) * grid.step).astype(np.float32), grid)
