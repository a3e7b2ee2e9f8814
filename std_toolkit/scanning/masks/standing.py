"""All objects of a recording: found in small photos within seconds, drawn, and chosen by a pixel.

Two things tell objects: parts of a coarse hull, which plain objects have, too, and clusters of
triangulated features, which among many things do not run into each other as the hulls of few photos
do.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.masks.candidates import (
    Candidate,
    CandidateSettings,
    CoarseHull,
    coarse_hull,
    split_hull,
)
from std_toolkit.scanning.masks.masks import covered
from std_toolkit.scanning.masks.table_comparison import Comparison
from std_toolkit.scanning.photos.views import Grid, View
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Pick = tuple[int, float, float]
Box = tuple[int, float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class StandingSettings(Settings):
    """How objects are told apart."""

    photos: int = limit(24, source="objects hide the table in many more photos than needed")
    """photos that are looked at, spread over all"""
    longest_px: int = limit(480, unit="px", source="a voxel of the coarse hull covers several")
    """longer side of these photos"""
    cells: int = limit(60_000, source="a cell for each pixel of the small photos on the board")
    """cells of the table at most"""
    link_m: float = limit(0.02, unit="m", source=NOT_RECORDED)
    """features of one object have a neighbour within this distance"""
    fewest_points: int = limit(20, source=NOT_RECORDED)
    """features of an object"""
    pick_px: float = limit(45.0, unit="px", source=NOT_RECORDED)
    """a picked pixel beside all objects belongs to the features within this distance"""
    covered: float = limit(0.3, source=NOT_RECORDED)
    """share of a part of the hull from which the features in it are the whole object"""
    clear: float = limit(
        0.3, source="a real table: 0.04, 0.11 and 0.26 of objects, 0.31 of a shadow, 0.43 of tags"
    )
    """median share of the known table that photos see bare at the place of an object, at most"""
    least_known: float = limit(0.3, source=NOT_RECORDED)
    """share of the place of an object behind which the table must be known in a photo"""
    least_pixels: int = limit(20, unit="px", source=NOT_RECORDED)
    """and pixels of it in the small photo"""
    fewest_photos: int = limit(4, source=NOT_RECORDED)
    """such photos of an object"""
    bare_tags: int = limit(3, source="an opaque object hides the tags below it from all photos")
    """times that photos show a tag in the middle half of the place of no object"""
    same_place: float = limit(0.4, source="objects stand beside one another")
    """share of the smaller of two boxes, from above, from which their features are one object"""
    in_box: float = limit(0.3, source=NOT_RECORDED)
    """share of an object that lies in a box around it"""


@dataclass(frozen=True, eq=False)
class Standing:
    """What stands on the board or beside it.

    Attributes:
        candidates: the objects, largest first.
        hull: voxels of all of them.
        tags: (N, 2) middles of the bare tags of all photos on the table.
        left_out: places on the board that stand out, largest first, though photos show the table
            there in part: flat, thin, clear or black things, or shadows.
    """

    candidates: list[Candidate]
    hull: CoarseHull
    tags: Array
    left_out: list[Candidate] = field(default_factory=list)


def find_standing(
    views: Sequence[View], corners: Array, points: Array,
    bare: Mapping[str, Array] | None = None, *, threads: int,
) -> Standing:  # fmt: skip
    """What stands on the board or beside it, by small photos.

    Args:
        views: photos.
        corners: (M, 3) corners of the board, world.
        points: (N, 3) triangulated features, world.
        bare: corners (N, 4, 2) in pixels of bare tags, by the name of the photo.
        threads: number of threads.
    """
    limits = StandingSettings.current()
    spread = np.linspace(0, len(views) - 1, min(len(views), limits.photos)).round().astype(int)
    few = [small_view(views[i], limits.longest_px) for i in spread]
    smaller = {v.name: small.camera.width / v.camera.width
               for v, small in zip([views[i] for i in spread], few, strict=True)}  # fmt: skip
    tags = _on_table(views, bare or {})
    # Pixel centres are at whole numbers.
    bare = {name: (quads + 0.5) * smaller[name] - 0.5 for name, quads in (bare or {}).items()
            if name in smaller}  # fmt: skip
    hull = coarse_hull(few, corners, bare, cells=limits.cells, threads=threads)
    parts, number = split_hull(hull, len(few))
    kept = sure_candidates(parts, few, corners, hull.compared, tags)
    # Numbers of the parts that are left: beside bare tags, a lone object is not told apart.
    left = np.zeros(len(parts) + 1, np.int32)
    left[[parts.index(part) + 1 for part in kept]] = np.arange(1, len(kept) + 1)
    found = _told_apart(kept, left[number], hull.grid, _clusters(points))
    found = sure_candidates(found, few, corners, hull.compared, tags)
    bounds = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    left_out = [c for c in parts if c not in kept and _on_board(c, *bounds) and not _bare(c, tags)]
    return Standing(found, hull, tags, left_out)


def _on_table(views: Sequence[View], quads: Mapping[str, Array]) -> Array:
    """Middles (N, 2) on the table of the tags (n, 4, 2) that photos show."""
    places = [np.zeros((0, 2))]
    for view in views:
        middles = quads.get(view.name, np.zeros((0, 4, 2))).mean(axis=1)
        rays = view.camera.unproject(middles) @ view.T_world_cam.R.T
        places.append((view.centre - rays * (view.centre[2] / rays[:, 2:]))[:, :2])
    return np.concatenate(places)


def sure_candidates(
    found: Sequence[Candidate], views: Sequence[View], corners: Array,
    compared: Sequence[Comparison], tags: Array,
) -> list[Candidate]:  # fmt: skip
    """Those of several candidates that hide the board; the first, if none certainly does.

    Args:
        found: candidates, largest first.
        views: photos.
        corners: (M, 3) corners of the board, world.
        compared: the photos against the table.
        tags: (N, 2) middles of the bare tags of all photos on the table.
    """
    if len(found) < 2:
        return list(found)
    bounds = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    sure = [
        c for c in found
        if _on_board(c, *bounds) and not _bare(c, tags) and _hides(c, views, compared)
    ]  # fmt: skip
    return sure or [found[0]]


def _bare(candidate: Candidate, tags: Array) -> bool:
    """Whether photos show tags where the middle of a candidate stands."""
    middle, half = (
        (candidate.low + candidate.high)[:2] / 2,
        (candidate.high - candidate.low)[:2] / 4,
    )
    return bool(
        (np.abs(tags - middle) < half).all(axis=1).sum() >= StandingSettings.current().bare_tags
    )


def _on_board(candidate: Candidate, low: Array, high: Array) -> bool:
    """Whether the middle of a candidate is above the board: beside it, little is known."""
    middle = (candidate.low + candidate.high)[:2] / 2
    return bool(((middle >= low) & (middle <= high)).all())


def _hides(candidate: Candidate, views: Sequence[View], compared: Sequence[Comparison]) -> bool:
    """Whether the photos that show the place of a candidate show no bare table there."""
    limits = StandingSettings.current()
    caster = RayCaster(candidate.vertices, candidate.faces, threads=1)
    shares = []
    for view, c in zip(views, compared, strict=True):
        place = covered(view, caster)
        known = (place & c.known).sum()
        if known > limits.least_known * max(1, place.sum()) and known >= limits.least_pixels:
            shares.append(float((place & c.clear).sum() / known))
    if len(shares) < limits.fewest_photos:
        return False
    return float(np.median(shares)) <= limits.clear


def small_view(view: View, longest: float) -> View:
    """A photo reduced to a longer side in pixels, without its mask and its depth."""
    h, w = view.image.shape[:2]
    factor = longest / max(h, w)
    if factor >= 1:
        return replace(view, mask=None, hidden=None, sensor=None)
    size = round(w * factor), round(h * factor)
    image = np.asarray(cv2.resize(view.image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return View(view.name, image, view.camera.resized(*size), view.T_world_cam)


def _told_apart(
    parts: Sequence[Candidate], number: NDArray[np.int32], grid: Grid,
    clusters: Sequence[Candidate],
) -> list[Candidate]:  # fmt: skip
    """Parts of the hull, or the clusters of features in them, largest first."""
    covered = StandingSettings.current().covered
    within: list[list[Candidate]] = [[] for _ in range(len(parts) + 1)]
    for cluster in clusters:
        assert cluster.points is not None
        index = np.rint((cluster.points - np.array(grid.origin)) / grid.step).astype(int)[:, ::-1]
        index = index[((index >= 0) & (index < grid.shape)).all(axis=1)]
        votes = np.bincount(number[tuple(index.T)], minlength=len(parts) + 1)
        votes[0] = 0
        if votes.max() >= covered * len(cluster.points):
            within[int(votes.argmax())].append(cluster)
    found = []
    for part, inside in zip(parts, within[1:], strict=True):
        # One object alone may have texture in two places.
        several = len(inside) > 1 and len(parts) > 1
        if several or sum(c.volume for c in inside) > covered * part.volume:
            found += inside
        else:
            found.append(part)
    found.sort(key=lambda c: -c.volume)
    smallest = CandidateSettings.current().small
    return [c for c in found if c.volume > smallest * found[0].volume]


def _clusters(points: Array) -> list[Candidate]:
    """Objects as clusters of features above the table; of any size, in any place."""
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    limits = StandingSettings.current()
    points = points[points[:, 2] > 1.5 * CandidateSettings.current().above_m]
    if len(points) < limits.fewest_points:
        return []
    tree = cKDTree(points)
    pairs = tree.sparse_distance_matrix(tree, limits.link_m, output_type="coo_matrix")
    _, label = connected_components(pairs, directed=False)
    large = np.flatnonzero(np.bincount(label) >= limits.fewest_points)
    hulls = [_standing_hull(points[label == n]) for n in large]
    return _joined([c for c in hulls if c is not None])


def _joined(clusters: list[Candidate]) -> list[Candidate]:
    """Clusters, those above the same place of the table as one: objects do not stand in another."""
    share = StandingSettings.current().same_place
    for n, one in enumerate(clusters):
        for other in clusters[n + 1 :]:
            sides = np.minimum(one.high, other.high)[:2] - np.maximum(one.low, other.low)[:2]
            areas = [float(np.prod((c.high - c.low)[:2])) for c in (one, other)]
            if float(np.maximum(sides, 0).prod()) <= share * min(areas):
                continue
            assert one.points is not None
            assert other.points is not None
            both = _standing_hull(np.concatenate([one.points, other.points]))
            if both is not None:
                rest = [c for c in clusters if c is not one and c is not other]
                return _joined([both, *rest])
    return clusters


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
        vertices.min(axis=0), vertices.max(axis=0), float(mesh.volume), vertices,
        np.asarray(mesh.faces, np.int64), points=points,
    )  # fmt: skip


def choose_candidate(
    candidates: Sequence[Candidate],
    views: Sequence[View],
    *,
    pick: Pick | None = None,
    box: Box | None = None,
) -> tuple[list[Candidate], int]:
    """The candidates and the index of the object to scan among them.

    Args:
        candidates: what stands on the table.
        views: photos.
        pick: index of a photo and a pixel (x, y) on the object.
        box: index of a photo and x0, y0, x1, y1 around the object. Features outside of it are not
            of the object, so the chosen candidate may get smaller.

    Raises:
        ToolkitError: nothing stands there, or there are several objects and no choice.
    """
    candidates = list(candidates)
    if not candidates:
        raise ToolkitError(
            "nothing was found standing on the board",
            hint="put the object on the board, photograph it also from above so that the board is "
            "seen behind it, or give --masks; clear glass is hardly seen: spray it matt",
        )
    if pick is not None:
        return candidates, _picked(candidates, views[pick[0]], np.array(pick[1:]))
    if box is not None:
        return _boxed(candidates, views[box[0]], np.array(box[1:]))
    if len(candidates) > 1:
        raise ToolkitError(f"{len(candidates)} objects stand on the board")
    return candidates, 0


def _picked(candidates: Sequence[Candidate], view: View, pixel: Array) -> int:
    """Index of the nearest candidate at a pixel, or of that with most features around it."""
    ray = view.T_world_cam.R @ view.camera.unproject(pixel)
    hit = _caster(candidates).cast(np.array([[*view.centre, *ray]]))
    if np.isfinite(hit.distance[0]):
        return int(hit.mesh[0])
    near = [0 if c.points is None else _near(c.points, view, pixel) for c in candidates]
    if max(near) < 3:
        raise ToolkitError(f"no object at this pixel of {view.name}", field="--pick",
                           value=[round(float(x), 1) for x in pixel])  # fmt: skip
    return int(np.argmax(near))


def _near(points: Array, view: View, pixel: Array) -> int:
    uv, z = view.project(points)
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(uv - pixel, axis=1) < StandingSettings.current().pick_px
    return int((near & (z > 0)).sum())


def _boxed(candidates: list[Candidate], view: View, box: Array) -> tuple[list[Candidate], int]:
    """The candidate with the largest part in a box, limited to it."""
    limits = StandingSettings.current()

    def within(points: Array) -> Mask:
        uv, z = view.project(points)
        with np.errstate(invalid="ignore"):
            return np.asarray(((uv >= box[:2]) & (uv <= box[2:])).all(axis=1) & (z > 0))

    shares = [
        float(within(c.vertices if c.points is None else c.points).mean()) for c in candidates
    ]
    sizes = [
        s * c.volume if s >= limits.in_box else 0.0 for s, c in zip(shares, candidates, strict=True)
    ]
    best = int(np.argmax(sizes))
    if not sizes[best]:
        raise ToolkitError(
            f"no object in this box of {view.name}", field="--box",
            value=[round(float(x), 1) for x in box],
        )  # fmt: skip
    points = candidates[best].points
    if points is not None:
        smaller = _standing_hull(points[within(points)])
        candidates[best] = candidates[best] if smaller is None else smaller
    return candidates, best


def _caster(candidates: Sequence[Candidate]) -> RayCaster:
    caster = RayCaster(threads=1)
    for c in candidates:
        caster.add(c.vertices, c.faces)
    return caster
