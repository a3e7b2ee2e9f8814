"""Masks of an object on the table from what the photos prove.

A pixel that has the colour of the bare table behind it shows the table, if it is joined to the
table around the object; one that has another colour, on a ray that meets the hull of all photos,
shows the object. Only what is left is decided by colour: where no table is known behind a pixel,
as at the feet of the object, and before a wall.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from std_toolkit.arrays import Mask
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.masks.candidates import Candidate
from std_toolkit.scanning.masks.masks import (
    consistent,
    covered,
    dilated,
    eroded,
    grab_cut,
    hull_of,
    view_depth,
    with_hidden,
)
from std_toolkit.scanning.masks.table_comparison import Comparison
from std_toolkit.scanning.photos.views import View, in_threads
from std_toolkit.scanning.photos.visibility import hull_depth
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class ProvenMaskSettings(Settings):
    """Which pixels are the bare table."""

    island: float = limit(0.03, source=NOT_RECORDED)
    """islands of the table's colour within an object that are smaller, as a share of its
    outline, belong to its texture"""
    contradictions: float = limit(0.06, source=NOT_RECORDED)
    """share of the photos that may see the bare table through a point of the first hull"""


def segment_on_table(
    views: Sequence[View],
    candidates: Sequence[Candidate],
    chosen: int,
    compared: Sequence[Comparison],
    *,
    threads: int,
) -> list[View]:
    """Photos with the mask of the chosen object.

    Args:
        views: photos.
        candidates: what stands on the table.
        chosen: index of the object among them.
        compared: the photos against the table.
        threads: number of threads.

    Raises:
        ToolkitError: the photos contradict each other.
    """
    target = candidates[chosen]
    others = [c for i, c in enumerate(candidates) if i != chosen]
    outer = RayCaster(*target.outer, threads=1)
    inner = RayCaster(*target.inner, threads=1)
    before = None
    if others:
        before = RayCaster(threads=1)
        for c in others:
            before.add(c.vertices, c.faces)

    def bounded(i: int) -> tuple[View, Mask]:
        """A photo with all that may be the object, and its pixels that show the bare table."""
        view = views[i]
        reach = view_depth(view, outer)
        hidden = np.zeros(reach.shape, bool)
        if before is not None and reach.any():
            # Only where the object may be.
            rows, columns = np.flatnonzero(reach.any(axis=1)), np.flatnonzero(reach.any(axis=0))
            x0, x1, y0, y1 = columns[0], columns[-1] + 1, rows[0], rows[-1] + 1
            other, _ = hull_depth(view, before, np.zeros(3), (x0, y0, x1, y1))
            ours = reach[y0:y1, x0:x1]
            hidden[y0:y1, x0:x1] = (other > 0) & (other < ours)
        table = without_islands(compared[i].clear, reach > 0)
        shown = (reach > 0) & ~table & ~hidden
        return view.with_mask(shown, hidden if hidden.any() else None), table

    found = in_threads(bounded, range(len(views)), threads=threads)
    first, never = [view for view, _ in found], [table for _, table in found]
    allowed = max(1, round(ProvenMaskSettings.current().contradictions * len(views)))
    hull = hull_of(first, cells=1_000_000, allowed=allowed, threads=threads)

    def proven(i: int) -> tuple[View, Mask]:
        """A photo with its mask, and the pixels that certainly show the object."""
        view = first[i]
        inside = covered(view, hull)
        hidden = view.hidden if view.hidden is not None else np.zeros(inside.shape, bool)
        # The rim is a mixture of object and table: colour decides where between them it lies.
        c = compared[i]
        seen = eroded(c.different, 1) & inside & ~hidden
        # Islands did not carve the hull: they belong to its texture.
        seen |= c.clear & ~never[i] & eroded(inside, 2) & ~hidden
        # Before a wall it may be the air above a vessel: from above, its inside looks as if
        # something stood there.
        certain = covered(view, inner) & ~c.beyond
        core = eroded(certain & ~never[i] & ~hidden, 3)
        maybe = dilated(inside, 3) & ~never[i] & ~hidden
        cut = grab_cut(view.image, maybe, seen | core, coarse=True)
        return view.with_mask(cut, view.hidden), seen

    found = in_threads(proven, range(len(views)), threads=threads)
    if not others:
        # Parts of the colour of the table: where most photos show the object, colour decides. Among
        # other things few photos show a side, and its outlines are needed as they are.
        never = [n & ~eroded(covered(v, hull), 1) for n, v in zip(never, views, strict=True)]
    done = consistent(
        [view for view, _ in found], never=never, always=[seen for _, seen in found],
        overruled=None if others else 1, threads=threads,
    )  # fmt: skip
    return with_hidden(done, never, threads=threads) if others else done


def without_islands(clear: Mask, outline: Mask) -> Mask:
    """The pixels of the bare table without islands within an outline that may be texture.

    Args:
        clear: (H, W) pixels of the colour of the table behind them.
        outline: (H, W) pixels that may show the object.
    """
    labels, count = ndimage.label(clear)
    if count == 0:
        return clear
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    outside = np.zeros(count + 1, bool)
    outside[np.unique(labels[clear & ~outline])] = True
    table = outside | (sizes > ProvenMaskSettings.current().island * outline.sum())
    table[0] = False
    return np.asarray(table[labels])
