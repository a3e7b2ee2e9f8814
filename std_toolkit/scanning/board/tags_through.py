"""Tags of the board that photos show through the object: displaced, though still legible.

An opaque object hides the tags behind it, and polished metal mirrors them, which makes them
illegible. Glass shows them, displaced by refraction. A tag that lies elsewhere than the board file
says, as on a bent sheet, is displaced in all photos; behind glass only in some.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.photos.views import View, in_threads
from std_toolkit.settings import Settings, limit

# Pixels of a cell of a tag in the images that are compared.
_CELL_PX = 4
# Widths and heights of a displaced tag in parts of those of a tag at its place.
_WIDTHS, _HEIGHTS = (0.65, 0.8, 1.0, 1.15), (0.87, 1.0)
# Displacement that is searched, in sizes of a tag: within its neighbours. Most tags are at their
# place, and searched nearby at first.
_REACH, _NEAR = 0.6, 0.12

# Photos that are looked at, spread over all: half a second each.
_PHOTOS = 24

_SET_ON = (
    "rendered photos: 16 and 22 displaced tags in 10 photos of two tumblers, none in 34 of a can, "
    "a clamp, a steel mug and a steel bowl"
)


@dataclass(frozen=True, kw_only=True)
class TagsThroughSettings(Settings):
    """When tags show that an object is clear."""

    smallest_px: float = limit(16.0, unit="px", source="two pixels a cell, as detectors need")
    """size of a tag from which it is legible"""
    legible: float = limit(0.88, source=_SET_ON)
    """share of the cells of a tag that must be right; two tags of 36h11 differ in 17 % of all"""
    sure: float = limit(0.95, source="nothing else has as many right cells")
    """the same from which a tag is the one near its place"""
    displaced_px: float = limit(1.0, unit="px", source=_SET_ON)
    """displacement from which a tag is not at its place"""
    displaced: float = limit(6.0, source=_SET_ON)
    """and this multiple of the median displacement of all tags"""
    at_place_px: float = limit(2.5, unit="px", source="real photos of one lens are within 1 px")
    """distance of all corners of a tag from where the board has them, within which it is bare"""
    at_place: float = limit(0.5, source="behind glass, a tag is in fewer than half of the photos")
    """share of the photos that show a tag at its place, unless it lies elsewhere"""
    fewest_tags: int = limit(4, source=_SET_ON)
    """displaced tags, over all photos, that an object is clear by"""
    fewest_photos: int = limit(3, source=_SET_ON)
    """photos with a displaced tag"""


@dataclass(frozen=True)
class FoundTag:
    """A legible tag in a photo.

    Attributes:
        tag: its id.
        off_px: distance of its middle from where the board has it.
        right: share of its cells that are right.
    """

    tag: int
    off_px: float
    right: float


def tags_through(
    views: Sequence[View], tags: Mapping[int, Array], dictionary: str, *, threads: int
) -> list[tuple[View, list[int]]]:
    """Photos with the ids of the tags that are displaced in them.

    Args:
        views: photos, undistorted, with poses.
        tags: corners (4, 3) of each tag in the world, in OpenCV's order, metres.
        dictionary: name of OpenCV's dictionary of the tags.
        threads: number of threads.
    """
    views = views[:: -(-len(views) // _PHOTOS)]
    found = in_threads(lambda v: legible_tags(v, tags, dictionary), views, threads=threads)
    through = zip(views, displaced_tags(found), strict=True)
    return [(view, names) for view, names in through if names]


def tags_at_place(
    views: Sequence[View], found: Mapping[str, Array], tags: Mapping[int, Array]
) -> dict[str, Array]:
    """Tags that detection found where the board has them: nothing opaque stands before them.

    Args:
        views: photos, undistorted, with poses.
        found: corners (4 * n, 2) of the tags found in each photo, pixels, by its name.
        tags: corners (4, 3) of each tag in the world, metres.

    Returns:
        Corners (n, 4, 2) in pixels, by the name of the photo.
    """
    if not tags:
        return {}
    limits = TagsThroughSettings.current()
    every = np.concatenate(list(tags.values()))
    at_place = {}
    for view in views:
        quads = found.get(view.name, np.zeros((0, 2))).reshape(-1, 4, 2)
        expected = np.nan_to_num(view.project(every)[0], nan=-1e6).reshape(-1, 4, 2)
        off = np.linalg.norm(quads[:, None] - expected, axis=-1).max(axis=-1).min(axis=1)
        at_place[view.name] = quads[off < limits.at_place_px]
    return at_place


def check_tags(
    through: Sequence[tuple[View, list[int]]],
    tags: Mapping[int, Array],
    caster: RayCaster | None = None,
) -> None:
    """Raise an error if photos show displaced tags, which a clear object refracts.

    Args:
        through: of `tags_through`.
        tags: corners (4, 3) of each tag in the world, metres.
        caster: all that may be the object; tags beside it do not count. None: all count.

    Raises:
        ToolkitError: the object is transparent.
    """
    limits = TagsThroughSettings.current()
    if caster is not None:
        through = [(view, _behind(view, names, tags, caster)) for view, names in through]
    photos = [view.name for view, names in through if names]
    count = sum(len(names) for _, names in through)
    if count >= limits.fewest_tags and len(photos) >= limits.fewest_photos:
        raise ToolkitError(
            f"the object is transparent: {len(photos)} photos show {count} tags of the board "
            "through it, displaced",
            value=", ".join(photos[:4]),
            hint="spray it matt and photograph it again, scan it with --revolve if it is a vessel "
            "of revolution, or give its outlines with --masks",
        )


def _behind(
    view: View, names: Sequence[int], tags: Mapping[int, Array], caster: RayCaster
) -> list[int]:
    """Those tags whose middle a surface hides in a photo."""
    middles = np.stack([tags[n].mean(axis=0) for n in names]) if names else np.zeros((0, 3))
    rays = np.concatenate([np.broadcast_to(view.centre, middles.shape), middles - view.centre], 1)
    hidden = caster.cast(rays).distance < 1
    return [n for n, is_hidden in zip(names, hidden, strict=True) if is_hidden]


def displaced_tags(found: Sequence[Sequence[FoundTag]]) -> list[list[int]]:
    """Ids of the tags of each photo that are displaced there and at their place elsewhere."""
    limits = TagsThroughSettings.current()
    every = [one.off_px for photo in found for one in photo]
    if not every:
        return [[] for _ in found]
    most = max(limits.displaced_px, limits.displaced * float(np.median(every)))
    offs: dict[int, list[float]] = {}
    for photo in found:
        for one in photo:
            offs.setdefault(one.tag, []).append(one.off_px)
    at_rest = {
        tag for tag, values in offs.items() if np.mean(np.array(values) <= most) >= limits.at_place
    }
    return [
        [one.tag for one in photo if one.off_px > most and one.tag in at_rest] for photo in found
    ]


def legible_tags(view: View, tags: Mapping[int, Array], dictionary: str) -> list[FoundTag]:
    """Tags that can be read at their place in a photo or within about half a tag of it."""
    limits = TagsThroughSettings.current()
    grey = view.grey()
    h, w = grey.shape
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    found = []
    for tag, corners in tags.items():
        uv, z = view.project(corners)
        if not (np.isfinite(uv).all() and (z > 0).all()):
            continue
        if (uv < 1).any() or (uv > np.array([w, h]) - 2).any():
            continue
        size = float(np.sqrt(abs(cv2.contourArea(uv.astype(np.float32)))))
        if size < limits.smallest_px:
            continue
        cells = known.markerSize + 2
        bits = np.asarray(known.generateImageMarker(tag, cells), np.uint8) > 127
        one = _read(grey, uv, bits, size)
        if one is not None and one[1] >= limits.legible:
            found.append(FoundTag(tag, *one))
    return found


def _read(
    grey: Floats, uv: Array, bits: NDArray[np.bool_], size: float
) -> tuple[float, float] | None:
    """Displacement in pixels of the best match of a tag, and the share of cells that are right."""
    near = _matched(grey, uv, bits, size, _NEAR, [(1.0, 1.0)])
    if near is not None and near[1] >= TagsThroughSettings.current().sure:
        return near
    return _matched(grey, uv, bits, size, _REACH, _scales())


def _matched(
    grey: Floats, uv: Array, bits: NDArray[np.bool_], size: float, reach: float,
    scales: Sequence[tuple[float, float]],
) -> tuple[float, float] | None:  # fmt: skip
    """As `_read`, within `reach` sizes of the tag and with some widths and heights."""
    # An image in which the tag has `_CELL_PX` pixels a cell, axes as in the photo.
    zoom = len(bits) * _CELL_PX / size
    middle = uv.mean(axis=0)
    widest = max(max(s) for s in scales)
    around = np.abs(uv - middle).max(axis=0) * widest + reach * size + 3 / zoom
    low = middle - around
    shape = tuple(int(n) for n in np.ceil(2 * around * zoom) + 1)
    to_patch = np.array([[zoom, 0, -zoom * low[0]], [0, zoom, -zoom * low[1]]])
    patch: Floats = cv2.warpAffine(
        grey, to_patch, shape, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float32)
    local = (uv - low) * zoom
    best: tuple[float, Array] | None = None
    for scale in scales:
        quad = (local - local.mean(axis=0)) * scale
        template, mask, start = _template(bits, quad)
        if (np.array(template.shape) > patch.shape).any():
            continue
        score: Floats = cv2.matchTemplate(patch, template, cv2.TM_CCOEFF_NORMED, mask=mask).astype(
            np.float32
        )
        score[~np.isfinite(score)] = -1
        _, value, _, place = cv2.minMaxLoc(score)
        if best is None or value > best[0] + 0.02:
            best = value, quad + _peak(score, *place) - start
    if best is None:
        return None
    off = float(np.linalg.norm(best[1].mean(axis=0) - local.mean(axis=0))) / zoom
    return off, _right_cells(patch, best[1], bits)


def _peak(score: Floats, x: int, y: int) -> Array:
    """(x, y) of a maximum between pixels, by parabolas."""
    place = np.array([x, y], np.float64)
    for axis, (n, line) in enumerate(((x, score[y]), (y, score[:, x]))):
        if 0 < n < len(line) - 1:
            before, here, after = (float(v) for v in line[n - 1 : n + 2])
            bend = before - 2 * here + after
            place[axis] += 0.5 * (before - after) / bend if bend < 0 else 0.0
    return place


def _scales() -> list[tuple[float, float]]:
    """Widths and heights, that of a tag at its place first."""
    every = [(x, y) for x in _WIDTHS for y in _HEIGHTS]
    return sorted(every, key=lambda s: abs(np.log(s[0])) + abs(np.log(s[1])))


def _template(bits: NDArray[np.bool_], quad: Array) -> tuple[Floats, Floats, Array]:
    """A tag drawn into corners (4, 2), its mask, and the place of the origin of the corners."""
    start = np.floor(quad.min(axis=0)) - 1
    width, height = (int(n) for n in np.ceil(quad.max(axis=0)) + 2 - start)
    fine = 8
    n = len(bits) * fine
    source = np.array([[0, 0], [n, 0], [n, n], [0, n]], np.float32) - 0.5
    H = cv2.getPerspectiveTransform(source, (quad - start).astype(np.float32))
    drawn = np.kron(bits, np.ones((fine, fine))).astype(np.float32)
    size = (width, height)
    template = cv2.warpPerspective(drawn, H, size, flags=cv2.INTER_AREA)
    mask = cv2.warpPerspective(np.ones_like(drawn), H, size, flags=cv2.INTER_LINEAR)
    return np.asarray(template, np.float32), np.asarray(mask > 0.5, np.float32), start


def _right_cells(patch: Floats, quad: Array, bits: NDArray[np.bool_]) -> float:
    """Share of the cells of a tag with these corners that are as bright as they should be."""
    n = len(bits)
    source = np.array([[0, 0], [n, 0], [n, n], [0, n]], np.float32)
    H = cv2.getPerspectiveTransform(source, quad.astype(np.float32))
    y, x = np.mgrid[:n, :n] + 0.5
    at = cv2.perspectiveTransform(np.stack([x, y], axis=-1).reshape(1, -1, 2), H)[0]
    u, v = at.astype(np.float32).T[:, None]
    value = cv2.remap(patch, u, v, cv2.INTER_LINEAR).reshape(n, n)
    low, high = np.percentile(value, [15, 90])
    return float(((value > (low + high) / 2) == bits).mean())
