"""The skirt at the foot of an object: a film of shadow and table in the masks, cut at the contact.

A shadow that all photos show lies in the plane of the table, so the hull has it as a flat film
around the foot. It is no higher than the error of the masks, and no depth map measures it above the
table.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from std_toolkit.arrays import Floats
from std_toolkit.scanning.masks.hull import column_tops
from std_toolkit.scanning.photos.views import Grid
from std_toolkit.settings import Settings, limit


@dataclass(frozen=True, kw_only=True)
class SkirtSettings(Settings):
    """What is the skirt of a foot."""

    thickest_m: float = limit(
        0.003, unit="m", source="2 px of the masks at 0.7 m, seen from 25 deg"
    )
    """largest height above the table"""
    on_table_m: float = limit(0.0015, unit="m", source="depth of the bare board is off by less")
    """a film that depth maps measure above this height is a part of the object"""
    supported: float = limit(4.0, source="as of plain tops that are sure")
    """weight of these depth measurements"""
    largest: float = limit(0.6, source="more is an object as flat as a film")
    """largest share of the area that the object covers from above"""


def without_skirt(field: Floats, support: Floats, grid: Grid) -> tuple[Floats, float]:
    """A surface without the film around its foot, and the share of its base that was cut.

    Args:
        field: (d, h, w) signed distance to the surface, metres, positive outside, z first and up
            from the table at z = 0.
        support: the same shape, weight of the depth measurements.
        grid: the voxels of both.
    """
    limits = SkirtSettings.current()
    index, covers = column_tops(field < 0)
    height = grid.origin[2] + index * grid.step
    layers = int(np.ceil((limits.thickest_m - grid.origin[2]) / grid.step)) + 1
    above = max(0, round((limits.on_table_m - grid.origin[2]) / grid.step))
    measured = support[above:layers].max(axis=0, initial=0) >= limits.supported
    tall = covers & (height > limits.thickest_m)
    # What a foot encloses, such as a ring, is not around it.
    film = covers & ~ndimage.binary_fill_holes(tall) & ~(measured & (height > limits.on_table_m))
    share = float(film.sum() / max(1, covers.sum()))
    if not film.any() or not tall.any() or share > limits.largest:
        return field, 0.0
    kept = covers & ~film
    # The wall of the foot goes straight down, between the columns on both of its sides.
    away = np.asarray(ndimage.distance_transform_edt(~kept), np.float32)
    deep = np.asarray(ndimage.distance_transform_edt(kept), np.float32)
    wall = (np.where(kept, 0.5 - deep, away - 0.5) * grid.step).astype(np.float32)
    beside = ndimage.binary_dilation(film, iterations=2)
    cut = field.copy()
    cut[:layers] = np.where(beside, np.maximum(field[:layers], wall), field[:layers])
    # A column of film may be higher by a voxel.
    cut[layers:, film] = np.maximum(cut[layers:, film], wall[film])
    return cut, share
