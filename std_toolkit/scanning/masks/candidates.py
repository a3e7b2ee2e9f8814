"""What stands on the table: parts of a coarse hull, or clusters of triangulated features."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from std_toolkit.arrays import Array, Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.masks.hull import surface_of
from std_toolkit.scanning.masks.table_comparison import Comparison, compare
from std_toolkit.scanning.masks.table_model import model_tables
from std_toolkit.scanning.photos.views import Grid, View, in_threads
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Voxels of the first, coarse hull.
_COARSE_VOXELS = 400_000
# Height of an object in sizes of the board.
_TALLEST = 2.0
# Features of one object have a neighbour within this distance.
_LINK_M = 0.02
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
    fewest_points: int = limit(20, source=NOT_RECORDED)
    """features of an object"""
    pick_px: float = limit(45.0, unit="px", source=NOT_RECORDED)
    """a picked pixel belongs to the features within this distance"""


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
    """

    low: Array
    high: Array
    volume: float
    vertices: Array
    faces: NDArray[np.int64]
    voxels: tuple[Surface, Surface] | None = None

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


def find_candidates(
    views: Sequence[View], corners: Array, *, threads: int
) -> tuple[list[Candidate], list[Comparison]]:
    """What stands on the board or beside it, largest first, and the photos against the table.

    Args:
        views: photos.
        corners: (M, 3) corners of the board, world.
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

    compared = compare_with_table(views, corners, threads=threads)
    different, possible = _not_carved(views, compared, grid)
    # What stands on the table hides the cells below it from all photos. Their colour is its own,
    # which may pass for that of the table: look at the table once more without them.
    blocked = _silhouettes(views, possible & (different >= 3), grid)
    compared = compare_with_table(views, corners, blocked, threads=threads)
    different, possible = _not_carved(views, compared, grid)
    return _split(different, possible, grid, len(views)), compared


def compare_with_table(
    views: Sequence[View],
    corners: Array,
    blocked: Sequence[Mask] | None = None,
    *,
    threads: int,
) -> list[Comparison]:
    """The photos against the table on which they agree; arguments as of `model_tables`."""
    tables = model_tables(views, corners, blocked)
    return in_threads(lambda i: compare(views[i], tables, i), range(len(views)), threads=threads)


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


def _split(
    different: NDArray[np.int16], possible: Mask, grid: Grid, photos: int
) -> list[Candidate]:
    """Connected parts of the coarse hull that begin near the table, largest first."""
    limits = CandidateSettings.current()
    labels, _ = ndimage.label(possible & (different >= 3))
    found = []
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
        found.append(
            Candidate(
                vertices.min(axis=0), vertices.max(axis=0), volume, vertices, faces,
                (_outer(labels == n, possible, grid), _inner(part, local)),
            )
        )  # fmt: skip
    found.sort(key=lambda c: -c.volume)
    return [c for c in found if c.volume > limits.small * found[0].volume]


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


def choose_candidate(
    candidates: Sequence[Candidate],
    views: Sequence[View],
    *,
    pick: tuple[int, float, float] | None = None,
    box: tuple[int, float, float, float, float] | None = None,
) -> int:
    """Index of the object to scan.

    Args:
        candidates: what stands on the table.
        views: photos.
        pick: index of a photo and a pixel (x, y) on the object.
        box: index of a photo and x0, y0, x1, y1 around the object.

    Raises:
        ToolkitError: nothing stands there, or several objects and no choice.
    """
    if not candidates:
        raise ToolkitError(
            "nothing was found standing on the board",
            hint="put the object on the board, photograph it also from above so that the board is "
            "seen behind it, or give --masks; clear glass is hardly seen: spray it matt",
        )
    if pick is not None:
        view = views[pick[0]]
        ray = view.T_world_cam.R @ view.camera.unproject(np.array(pick[1:]))
        hits = [
            RayCaster(c.vertices, c.faces).cast(np.array([[*view.centre, *ray]])).distance[0]
            for c in candidates
        ]
        if not np.isfinite(hits).any():
            raise ToolkitError(
                f"no object at this pixel of {view.name}", field="--pick", value=pick[1:]
            )
        return int(np.argmin(hits))
    if box is not None:
        view = views[box[0]]
        shares = []
        for c in candidates:
            uv, _ = view.project(c.vertices)
            shares.append(float(((uv >= box[1:3]) & (uv <= box[3:])).all(axis=1).mean()))
        best = int(np.argmax([s * c.volume for s, c in zip(shares, candidates, strict=True)]))
        if shares[best] < 0.3:
            raise ToolkitError(
                f"no object in this box of {view.name}", field="--box", value=box[1:]
            )
        return best
    if len(candidates) > 1:
        raise ToolkitError(
            f"{len(candidates)} objects stand on the board",
            hint="choose one with --pick FRAME:x,y or --box FRAME:x0,y0,x1,y1; the picture "
            "candidates.jpg in the output folder shows them",
        )
    return 0


def cluster_points(
    points: Array,
    views: Sequence[View],
    *,
    pick: tuple[int, float, float] | None = None,
    box: tuple[int, float, float, float, float] | None = None,
) -> tuple[list[Candidate], int] | None:
    """Objects as clusters of triangulated features, and the index of the chosen one.

    Among other things, hulls of few photos run into each other, and features do not.

    Args:
        points: (N, 3) features, world.
        views: photos.
        pick, box: the choice, as in `choose_candidate`.

    Returns:
        None if the chosen object has too few features.
    """
    settings = CandidateSettings.current()
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    points = points[points[:, 2] > 1.5 * settings.above_m]
    chosen = pick or box
    if chosen is None or len(points) < settings.fewest_points:
        return None
    uv, z = views[chosen[0]].project(points)
    with np.errstate(invalid="ignore"):
        if box is not None:
            near = ((uv >= box[1:3]) & (uv <= box[3:])).all(axis=1) & (z > 0)
        else:
            near = (np.linalg.norm(uv - np.array(chosen[1:3]), axis=1) < settings.pick_px) & (z > 0)
    tree = cKDTree(points)
    pairs = tree.sparse_distance_matrix(tree, _LINK_M, output_type="coo_matrix")
    _, label = connected_components(pairs, directed=False)
    if near.sum() < 3:
        return None
    votes = np.bincount(label[near], minlength=int(label.max()) + 1)
    best = int(votes.argmax())
    order = [best] + [n for n in range(int(label.max()) + 1) if n != best]
    found = []
    for n in order:
        part = points[label == n]
        if box is not None and n == best:
            # The box limits the object, too.
            part = points[(label == n) & near]
        candidate = _standing_hull(part) if len(part) >= settings.fewest_points else None
        if candidate is not None:
            found.append(candidate)
        elif n == best:
            return None
    return found, 0


def _standing_hull(points: Array) -> Candidate | None:
    """Convex hull of the dense part of some features and of their feet on the table."""
    import trimesh
    from scipy.spatial import QhullError, cKDTree

    distance, _ = cKDTree(points).query(points, k=min(4, len(points)))
    points = points[distance[:, -1] <= 4 * np.median(distance[:, -1])]
    feet = points * [1, 1, 0]
    try:
        mesh = trimesh.convex.convex_hull(np.concatenate([points, feet]))
    except QhullError:
        return None
    vertices = np.asarray(mesh.vertices)
    return Candidate(
        vertices.min(axis=0),
        vertices.max(axis=0),
        float(mesh.volume),
        vertices,
        np.asarray(mesh.faces, np.int64),
    )
