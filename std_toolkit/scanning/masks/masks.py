"""Masks of the object without a network: GrabCut per photo, made consistent by the visual hull."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from std_toolkit.arrays import Array, Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.log import logger
from std_toolkit.scanning.masks.hull import hull_field, largest_component, surface_of
from std_toolkit.scanning.photos.views import Grid, View, in_threads
from std_toolkit.scanning.photos.visibility import hull_depth, hull_pixels

# Width and height, in sum, from which an object is cut in half the size at first.
_LARGE_PX = 300


def segment_by_border(views: Sequence[View], *, threads: int) -> list[View]:
    """Photos with masks of an object before a background that the image borders show."""

    def one(view: View) -> View:
        image = cv2.GaussianBlur(view.image, (0, 0), 1.0).astype(np.float32)
        sides = image[:4], image[-4:], image[:, :4], image[:, -4:]
        edge = np.concatenate([side.reshape(-1, 3) for side in sides])
        middle = np.median(edge, axis=0)
        noise = 1.5 * np.median(np.abs(edge - middle)) + 1
        off = np.abs(image - middle).max(axis=-1)
        scaled = np.clip(off, 0, 255).astype(np.uint8)
        level, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        sure = largest_component(off > max(0.9 * level, 6 * noise))
        maybe = off > max(0.25 * level, 4 * noise)
        labels, _ = ndimage.label(maybe)
        reached = np.isin(labels, np.unique(labels[sure & (labels > 0)])) & (labels > 0)
        return view.with_mask(grab_cut(view.image, reached, eroded(sure, 2)))

    return consistent(in_threads(one, views, threads=threads), threads=threads)


def volume_of_masks(views: Sequence[View]) -> tuple[Array, Array]:
    """Corners (low, high) of a box that contains what the masks show.

    Raises:
        ToolkitError: the masks do not meet in space.
    """
    rays, centres, radii = [], [], []
    for view in views:
        if view.shown.sum() < 50:
            continue
        rows, columns = np.nonzero(view.shown)
        middle = np.array([columns.mean(), rows.mean()])
        ray = view.T_world_cam.R @ view.camera.unproject(middle)
        rays.append(ray / np.linalg.norm(ray))
        centres.append(view.centre)
        reach = np.hypot(columns - middle[0], rows - middle[1]).max() / view.camera.fx
        radii.append(reach)
    if len(rays) < 2:
        raise ToolkitError("the masks are empty", hint="give your own with --masks")
    P = np.eye(3) - np.einsum("ni,nj->nij", np.array(rays), np.array(rays))
    centre = np.linalg.solve(P.sum(axis=0), np.einsum("nij,nj->i", P, np.array(centres)))
    away = np.linalg.norm(np.array(centres) - centre, axis=1)
    radius = 1.2 * float(np.median(np.array(radii) * away))
    grid = Grid.around(centre - radius, centre + radius, 2 * radius / 90, margin=0)
    field = hull_field(views, grid, allowed=max(1, len(views) // 10))
    inside = np.argwhere(largest_component(field < grid.step))
    if len(inside) == 0:
        raise ToolkitError(
            "the masks of the photos do not meet in one volume",
            hint="check the camera poses and the masks in the report",
        )
    points = grid.points(inside)
    return points.min(axis=0) - 1.5 * grid.step, points.max(axis=0) + 1.5 * grid.step


def consistent(
    views: Sequence[View],
    *,
    never: Sequence[Mask] | None = None,
    always: Sequence[Mask] | None = None,
    overruled: int | None = None,
    rounds: int = 2,
    threads: int = 1,
) -> list[View]:
    """Photos whose masks agree with the visual hull of all of them.

    A pixel that the hull covers although its photo's mask does not, or the reverse, is decided
    again by colour.

    Args:
        views: photos with masks.
        never: pixels (H, W) of each photo that do not show the object.
        always: pixels (H, W) of each photo that show the object, if the hull covers them.
        overruled: pixels from the outline of the hull inwards from where `never` does not count;
            None for four times the width in which the outline is searched.
        rounds: number of repetitions.
        threads: number of threads.
    """
    current = list(views)
    for n in range(rounds):
        caster = hull_of(current, cells=1_000_000, allowed=len(current) // 12, threads=threads)

        def one(
            i: int, caster: RayCaster = caster, band: int = 5 - n, now: Any = current,
            coarse: bool = n < rounds - 1,
        ) -> View:  # fmt: skip
            view = now[i]
            inside = covered(view, caster)
            hidden = view.hidden if view.hidden is not None else np.zeros(inside.shape, bool)
            maybe = dilated(inside, band) & ~hidden
            if never is not None:
                # By chance the object has the colour of the table behind it: other photos decide.
                maybe &= ~never[i] | eroded(inside, overruled or 4 * band)
            sure = eroded(inside & ~hidden, band) & (view.shown | eroded(inside, 4 * band))
            if always is not None:
                sure |= always[i] & inside & ~hidden
            found = grab_cut(view.image, maybe, sure, coarse=coarse)
            return view.with_mask(found, view.hidden)

        changed = in_threads(one, range(len(current)), threads=threads)
        moved = [
            float((a.shown ^ b.shown).sum()) / max(1, b.shown.sum())
            for a, b in zip(changed, current, strict=True)
        ]
        current = changed
        logger.info("masks: round %d changed %.1f %% of them", n + 1, 100 * float(np.mean(moved)))
    return current


def with_hidden(
    views: Sequence[View], never: Sequence[Mask], *, rounds: int = 3, threads: int = 1
) -> list[View]:
    """Photos in which what hides the object from them is marked.

    Where a mask lacks a thick part of the hull on which most other photos agree, something stands
    before it. Marked as hidden, the part does not carve the hull.
    """
    current = list(views)
    for _ in range(rounds):
        caster = hull_of(current, cells=300_000, allowed=len(current) // 8, threads=threads)

        def one(i: int, caster: RayCaster = caster, now: Any = current) -> View:
            view = now[i]
            inside = covered(view, caster)
            radius = max(2, round(0.02 * float(np.sqrt(inside.sum()))))
            thick = eroded(inside & ~view.possible & ~never[i], radius)
            if not thick.any():
                return view
            hidden = dilated(thick, 2 * radius + 2) & ~view.shown & ~never[i]
            return view.with_mask(
                view.shown, hidden if view.hidden is None else hidden | view.hidden
            )

        current = in_threads(one, range(len(current)), threads=threads)
    return current


def hull_of(views: Sequence[View], *, cells: int, allowed: int, threads: int) -> RayCaster:
    """The largest part of the visual hull; arguments and errors as of `hull_surface`."""
    return RayCaster(*hull_surface(views, cells=cells, allowed=allowed, threads=threads), threads=1)


def hull_surface(
    views: Sequence[View], *, cells: int, allowed: int, threads: int
) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) and faces (F, 3) of the largest part of the visual hull.

    Args:
        views: photos with masks.
        cells: number of cells of its grid, about.
        allowed: photos, at least one, whose masks may lack a point of the hull.
        threads: number of threads.

    Raises:
        ToolkitError: the masks do not meet in space, or contradict each other.
    """
    low, high = volume_of_masks(views)
    step = float(((high - low).prod() / cells) ** (1 / 3))
    grid = Grid.around(low, high, step)
    field = hull_field(views, grid, allowed=max(1, allowed), threads=threads)
    field = np.where(largest_component(field < 0) | (field >= 0), field, step)
    vertices, faces = surface_of(field.astype(np.float32), grid)
    if len(faces) == 0:
        raise ToolkitError(
            "the masks of the photos contradict each other",
            hint="correct them with std-annotate and give them with --masks",
        )
    return vertices, faces


def covered(view: View, caster: RayCaster) -> Mask:
    """Pixels of a photo that the hull covers."""
    return hull_pixels(view, caster)


def view_depth(view: View, caster: RayCaster) -> NDArray[np.float32]:
    """(H, W) z-depth of a surface in a photo, 0 beside it."""
    whole = (0, 0, view.camera.width, view.camera.height)
    return hull_depth(view, caster, np.zeros(3), whole)[0]


def grab_cut(image: NDArray[np.uint8], maybe: Mask, sure: Mask, *, coarse: bool = False) -> Mask:
    """Pixels of the object by GrabCut, within `maybe` and with all of `sure`.

    Args:
        image: (H, W, 3) RGB.
        maybe, sure: (H, W).
        coarse: cut a large object in an image of half the size: the outline is a pixel off.
    """
    rows, columns = np.flatnonzero(maybe.any(axis=1)), np.flatnonzero(maybe.any(axis=0))
    result = np.zeros(maybe.shape, bool)
    if len(rows) < 3 or len(columns) < 3 or sure.sum() < 30:
        return result
    margin = 30
    y0, y1 = max(rows[0] - margin, 0), min(rows[-1] + margin + 1, maybe.shape[0])
    x0, x1 = max(columns[0] - margin, 0), min(columns[-1] + margin + 1, maybe.shape[1])
    window = (slice(y0, y1), slice(x0, x1))
    photo, may, must = image[window], maybe[window], sure[window]
    if not coarse or len(rows) + len(columns) < _LARGE_PX:
        result[window] = _cut(photo, may, must)
        return result
    h, w = may.shape
    size = (w + 1) // 2, (h + 1) // 2
    # Only pixels that are certain as a whole are certain.
    small = [cv2.resize(m.astype(np.float32), size, interpolation=cv2.INTER_AREA)
             for m in (may, must)]  # fmt: skip
    half = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.uint8)
    found = _cut(half, small[0] > 0, small[1] > 0.999).astype(np.float32)
    result[window] = (cv2.resize(found, (w, h), interpolation=cv2.INTER_LINEAR) > 0.5) & may
    return result


def _cut(image: NDArray[np.uint8], maybe: Mask, sure: Mask) -> Mask:
    """Pixels of the object by GrabCut, cleaned, in an image (H, W, 3) that shows little else."""
    state = np.full(maybe.shape, cv2.GC_BGD, np.uint8)
    state[maybe] = cv2.GC_PR_FGD
    state[sure] = cv2.GC_FGD
    if (state == cv2.GC_BGD).sum() < 30 or sure.sum() < 30:
        return np.asarray(maybe)
    crop = np.ascontiguousarray(image[..., ::-1])
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(crop, state, None, *models, 3, cv2.GC_INIT_WITH_MASK)  # type: ignore[call-overload]
    found = (state == cv2.GC_FGD) | (state == cv2.GC_PR_FGD)
    found = ndimage.binary_opening(found, iterations=1) | (sure & found)
    labels, count = ndimage.label(found)
    if count > 1:
        sizes = np.bincount(labels.ravel())
        sizes[0] = 0
        found = sizes[labels] > 0.02 * sizes.max()
    return _small_holes_filled(found)


def _small_holes_filled(mask: Mask) -> Mask:
    """The mask with holes below 0.3 % of its area filled: highlights, not handles."""
    labels, _ = ndimage.label(~mask)
    sizes = np.bincount(labels.ravel())
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    small = sizes < max(20, 0.003 * mask.sum())
    small[border] = False
    small[0] = False
    return np.asarray(mask | small[labels])


def eroded(mask: Mask, radius: int) -> Mask:
    """The mask without pixels within `radius` of its outline."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(cv2.erode(mask.astype(np.uint8), kernel) > 0)


def dilated(mask: Mask, radius: int) -> Mask:
    """The mask and all pixels within `radius` of it."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), kernel) > 0)
