"""The environment as sampled by the wavefront path tracer: one look-up to draw a direction.

Mitsuba's own map descends a hierarchy of ten levels for every ray; a look-up in a table of equally
likely slots costs a third of that. The slots follow a space-filling curve, so that the strata of a
pixel's random numbers are patches of the sphere. On a floor under a studio's light 16 paths per
pixel have 9 % of noise; with cells in arbitrary order they had 13 %.

Import only after a variant has been set.
"""

from typing import Any

import cv2
import drjit
import mitsuba
import numpy as np
from numpy.typing import NDArray

from sensors.lighting.environment import LUMINANCE, EnvironmentMap

mi: Any = mitsuba  # their types differ by variant
dr: Any = drjit
ROWS, COLUMNS = 128, 256
_CELLS = ROWS * COLUMNS
_SIDEWAYS, _FROM_BELOW = 0.4, 0.2
"""Sampling weight of light from the horizon and from below, relative to light from straight up.

Most surfaces seen by a camera over a table are floors and lids.
"""
_SLOTS = 8 * _CELLS
"""Every cell has at least one, an eighth in total, so that dark cells are sampled too."""


class Sky:
    """Radiance at infinity by direction.

    Args:
        environment: lat-long map, straight up in the first row.
        rotation_rad: rotation about the world's z axis.
    """

    def __init__(self, environment: EnvironmentMap, rotation_rad: float) -> None:
        self._texture = mi.Texture2f(
            mi.TensorXf(environment.pixels),
            filter_mode=dr.FilterMode.Linear,
            wrap_mode=dr.WrapMode.Repeat,
        )
        counts = slots_of_cells(cell_weights(environment.pixels))
        along = curve()
        self._cell = mi.UInt32(np.repeat(along, counts[along]).astype(np.uint32))
        self._chance = mi.Float((counts / _SLOTS).astype(np.float32))
        self._cos = dr.opaque(mi.Float, float(np.cos(rotation_rad)))
        self._sin = dr.opaque(mi.Float, float(np.sin(rotation_rad)))

    def radiance(self, d: Any, active: Any) -> Any:
        """Light arriving from unit world directions."""
        return mi.Spectrum(self._texture.eval(self._uv(d), active))

    def density(self, d: Any, active: Any) -> Any:
        """Probability density per solid angle with which `draw` returns a direction."""
        uv = self._uv(d)
        column = dr.minimum(mi.UInt32(uv.x * COLUMNS), COLUMNS - 1)
        row = dr.minimum(mi.UInt32(uv.y * ROWS), ROWS - 1)
        chance = dr.gather(mi.Float, self._chance, row * COLUMNS + column, active)
        return chance * _per_angle(dr.safe_sqrt(1 - dr.square(d.z)))

    def draw(self, point: Any, active: Any) -> tuple[Any, Any, Any]:
        """Direction, its density and its radiance, for uniform points in the unit square."""
        scaled = point.x * _SLOTS
        slot = dr.minimum(mi.UInt32(scaled), _SLOTS - 1)
        cell = dr.gather(mi.UInt32, self._cell, slot, active)
        # The remainder of the random number is uniform again.
        rest = scaled - mi.Float(slot)
        row = cell // COLUMNS
        u = (mi.Float(cell - row * COLUMNS) + dr.clip(rest, 0, 0.999999)) / COLUMNS
        v = (mi.Float(row) + point.y) / ROWS
        sin_polar, cos_polar = dr.sincos(v * dr.pi)
        sin_around, cos_around = dr.sincos(u * dr.two_pi)
        x, y = sin_around * sin_polar, cos_around * sin_polar
        d = mi.Vector3f(x * self._cos - y * self._sin, x * self._sin + y * self._cos, cos_polar)
        chance = dr.gather(mi.Float, self._chance, cell, active)
        light = mi.Spectrum(self._texture.eval(mi.Point2f(u, v), active))
        return d, chance * _per_angle(sin_polar), light

    def _uv(self, d: Any) -> Any:
        x = d.x * self._cos + d.y * self._sin
        y = d.y * self._cos - d.x * self._sin
        around = dr.atan2(x, y) * dr.inv_two_pi
        return mi.Point2f(around - dr.floor(around), dr.safe_acos(d.z) * dr.inv_pi)


def _per_angle(sin_polar: Any) -> Any:
    return _CELLS / (2 * dr.pi * dr.pi * dr.maximum(sin_polar, 1e-4))


def cell_weights(pixels: NDArray[np.float32]) -> NDArray[np.float64]:
    """(cells,) fractions of the light that cells give to surfaces, most of which face up."""
    light = cv2.resize(pixels @ LUMINANCE, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA)
    polar = (np.arange(ROWS)[:, None] + 0.5) / ROWS * np.pi
    up = np.cos(polar)
    use = np.where(up > 0, _SIDEWAYS + (1 - _SIDEWAYS) * up, _FROM_BELOW)
    bright = light.astype(np.float64) * np.sin(polar) * use
    return (bright / bright.sum()).ravel()


def slots_of_cells(weights: NDArray[np.float64]) -> NDArray[np.int64]:
    """(cells,) numbers of slots, at least 1, `_SLOTS` in total, nearly proportional to weights."""
    spare = weights * (_SLOTS - len(weights))
    counts = np.floor(spare).astype(np.int64)
    largest_rests = np.argsort(counts - spare, kind="stable")
    counts[largest_rests[: _SLOTS - len(weights) - counts.sum()]] += 1
    return counts + 1


def curve() -> NDArray[np.int64]:
    """(cells,) the cells in the order of two Hilbert curves, one for each half of the map."""
    step = np.arange(ROWS * ROWS)
    x, y, rest, side = np.zeros_like(step), np.zeros_like(step), step.copy(), 1
    while side < ROWS:
        right = (rest >> 1) & 1
        down = (rest ^ right) & 1
        turned = (down == 0) & (right == 1)
        x, y = np.where(turned, side - 1 - x, x), np.where(turned, side - 1 - y, y)
        x, y = np.where(down == 0, y, x) + side * right, np.where(down == 0, x, y) + side * down
        rest >>= 2
        side *= 2
    half = y * COLUMNS + x
    return np.concatenate([half, half + ROWS])
