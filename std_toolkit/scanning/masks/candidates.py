"""What stands on the table: parts of a coarse hull."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from std_toolkit.arrays import Array, Mask
from std_toolkit.compiled import compiled
from std_toolkit.scanning.masks.hull import largest_component, surface_of
from std_toolkit.scanning.masks.table_comparison import Comparison, compare
from std_toolkit.scanning.masks.table_model import MOST_CELLS, TableModel, model_tables
from std_toolkit.scanning.photos.views import Grid, View, in_threads
from std_toolkit.scanning.photos.visibility import part_of
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Voxels of the first, coarse hull.
_COARSE_VOXELS = 400_000
# Height of an object in sizes of the board.
_TALLEST = 2.0
# Sizes of the inner part of a hull of points, and of what may belong to the object.
_INNER, _OUTER = 0.7, 1.15
# Rim of a coarse hull that may not be the object, as a share of the depth where it is deepest.
_RIM = 0.3
# Pixels around a box that are compared with the table: an island there joins the table beside it.
_AROUND_PX = 24

Surface = tuple[Array, NDArray[np.int64]]


@dataclass(frozen=True, kw_only=True)
class CandidateSettings(Settings):
    """What counts as an object on the table."""

    small: float = limit(0.02, source=NOT_RECORDED)
    """candidates smaller than this share of the largest are not offered"""
    hides: float = limit(0.2, source=NOT_RECORDED)
    """share of the photos in which an object hides the table"""
    agreed: float = limit(0.5, source=NOT_RECORDED)
    """a voxel hides it in this share of the photos that the surest of its object do"""
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
        agreed: surface of its voxels that hide the table from many photos: without the spikes of
            a hull of few photos. None if it was found by points alone.
        points: (N, 3) its features, if it was found by these.
    """

    low: Array
    high: Array
    volume: float
    vertices: Array
    faces: NDArray[np.int64]
    voxels: tuple[Surface, Surface] | None = None
    agreed: Surface | None = None
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
        bare, threads: as of `compare_with_tables`.
    """
    tables = model_tables(views, corners, blocked, cells=cells, threads=threads)
    return compare_with_tables(views, tables, bare=bare, threads=threads)


def compare_with_tables(
    views: Sequence[View],
    tables: Sequence[TableModel],
    *,
    bare: Mapping[str, Array] | None = None,
    within: Array | None = None,
    threads: int,
) -> list[Comparison]:
    """The photos against known tables.

    Args:
        views: photos.
        tables: of `model_tables` over all of them.
        bare: corners (N, 4, 2) in pixels of bare tags, by the name of the photo.
        within: (2, 3) low and high corner of a box, world: only pixels before it, and those around
            these, are compared. None: all.
        threads: number of threads.
    """
    bare = bare or {}

    def one(i: int) -> Comparison:
        view, window = views[i], None
        if within is not None:
            w, h = view.camera.size
            # A photo that shows nothing of the box is compared in a corner.
            x0, y0, x1, y1 = part_of(view, within, (0, 0, w, h)) or (0, 0, 1, 1)
            window = (max(0, x0 - _AROUND_PX), max(0, y0 - _AROUND_PX),
                      min(w, x1 + _AROUND_PX), min(h, y1 + _AROUND_PX))  # fmt: skip
        found = compare(view, tables, i, window)
        quads = bare.get(view.name)
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
        drawn = np.zeros(view.image.shape[:2], bool)
        ok = np.isfinite(uv).all(axis=1) & (z > 0)
        pixels = np.rint(np.where(ok[:, None], uv, 0).clip(-1e6, 1e6)).astype(np.int64)
        _draw(pixels, faces[ok[faces].all(axis=1)], drawn)
        found.append(drawn)
    return found


@compiled
def _draw(pixels, faces, drawn) -> None:  # type: ignore[no-untyped-def]
    """Mark the pixels of triangles, those of their edges included."""
    h, w = drawn.shape
    for n in range(len(faces)):
        ax, ay = pixels[faces[n, 0]]
        bx, by = pixels[faces[n, 1]]
        cx, cy = pixels[faces[n, 2]]
        if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) < 0:
            bx, by, cx, cy = cx, cy, bx, by
        for y in range(max(0, min(ay, by, cy)), min(h - 1, max(ay, by, cy)) + 1):
            for x in range(max(0, min(ax, bx, cx)), min(w - 1, max(ax, bx, cx)) + 1):
                if (
                    (bx - ax) * (y - ay) >= (by - ay) * (x - ax)
                    and (cx - bx) * (y - by) >= (cy - by) * (x - bx)
                    and (ax - cx) * (y - cy) >= (ay - cy) * (x - cx)
                ):
                    drawn[y, x] = True


def _not_carved(
    views: Sequence[View], compared: Sequence[Comparison], grid: Grid
) -> tuple[NDArray[np.int16], Mask]:
    """Number of photos in which each voxel hides the table, and voxels that may hide it.

    The latter stand before the bare table in few photos.
    """
    clear, different = (np.zeros(grid.shape, np.int16) for _ in range(2))
    origin = np.asarray(grid.origin)
    middle = grid.points(np.array(grid.shape)[None] // 2)
    for view, c in zip(views, compared, strict=True):
        # The coarse voxel covers several pixels: all of them must be clear.
        away = max(0.02, float((view.P[2, :3] @ middle[0]) + view.P[2, 3]))
        radius = max(0, round(0.35 * grid.step * view.camera.fx / away))
        kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
        whole = cv2.erode(c.clear.astype(np.uint8), kernel) > 0
        _count(view.P, origin, grid.step, whole, c.different, clear, different)
    return different, np.asarray(clear <= np.maximum(1, 0.12 * different))


@compiled
def _count(P, origin, step, whole, differs, clear, different) -> None:  # type: ignore[no-untyped-def]
    """Add a photo to the counts of the voxels that it shows clear and different."""
    h, w = whole.shape
    for k in range(clear.shape[0]):
        for j in range(clear.shape[1]):
            y, z = origin[1] + j * step, origin[2] + k * step
            for i in range(clear.shape[2]):
                x = origin[0] + i * step
                away = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
                if away <= 0.02:
                    continue
                u = int(np.rint((P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / away))
                v = int(np.rint((P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / away))
                if 0 <= u < w and 0 <= v < h:
                    clear[k, j, i] += whole[v, u]
                    different[k, j, i] += differs[v, u]


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
        hides = different[place]
        agreed = part & (
            hides >= CandidateSettings.current().agreed * np.percentile(hides[part], 90)
        )
        agreed = ndimage.binary_fill_holes(largest_component(agreed))
        found.append((n, Candidate(
            vertices.min(axis=0), vertices.max(axis=0), volume, vertices, faces, surfaces,
            surface_of(np.where(agreed, -grid.step, grid.step).astype(np.float32), local),
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
