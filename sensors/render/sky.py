"""The environment as the wavefront path tracer samples it: one look-up to draw a direction.

Mitsuba's own map descends a hierarchy of ten levels for every ray; drawing from an alias table of
coarse cells costs a third of that, and what it loses in precision the weighing against the
surface's own sampling makes up for.

Imported only after a variant has been set.
"""

from __future__ import annotations

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
_EVERYWHERE = 0.05
"""Share of the directions drawn without regard to brightness: dark cells beside bright ones."""


class Sky:
    """Radiance from far away by direction.

    Args:
        environment: lat-long map, straight up in the first row.
        rotation_rad: turn about the world's z axis.
    """

    def __init__(self, environment: EnvironmentMap, rotation_rad: float) -> None:
        self._texture = mi.Texture2f(
            mi.TensorXf(environment.pixels),
            filter_mode=dr.FilterMode.Linear,
            wrap_mode=dr.WrapMode.Repeat,
        )
        share, alias, chance = alias_table(cell_weights(environment.pixels))
        self._share, self._alias = mi.Float(share), mi.UInt32(alias)
        self._chance = mi.Float(chance.astype(np.float32))
        self._cos = dr.opaque(mi.Float, float(np.cos(rotation_rad)))
        self._sin = dr.opaque(mi.Float, float(np.sin(rotation_rad)))

    def radiance(self, d: Any, active: Any) -> Any:
        """Light arriving from unit world directions."""
        return mi.Spectrum(self._texture.eval(self._uv(d), active))

    def density(self, d: Any, active: Any) -> Any:
        """Probability per solid angle that `draw` gives a direction."""
        uv = self._uv(d)
        column = dr.minimum(mi.UInt32(uv.x * COLUMNS), COLUMNS - 1)
        row = dr.minimum(mi.UInt32(uv.y * ROWS), ROWS - 1)
        chance = dr.gather(mi.Float, self._chance, row * COLUMNS + column, active)
        return chance * _per_angle(dr.safe_sqrt(1 - dr.square(d.z)))

    def draw(self, point: Any, active: Any) -> tuple[Any, Any, Any]:
        """Direction, its density and the light from there, for uniform points in the square."""
        scaled = point.x * _CELLS
        slot = dr.minimum(mi.UInt32(scaled), _CELLS - 1)
        rest = scaled - mi.Float(slot)
        share = dr.gather(mi.Float, self._share, slot, active)
        stays = rest < share
        cell = dr.select(stays, slot, dr.gather(mi.UInt32, self._alias, slot, active))
        # What is left of the random number is uniform again.
        rest = dr.select(stays, rest / share, (rest - share) / dr.maximum(1 - share, 1e-6))
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
    """(cells,) probabilities by the light in each cell of the sphere."""
    light = cv2.resize(pixels @ LUMINANCE, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA)
    light = light.astype(np.float64)
    height = np.sin((np.arange(ROWS) + 0.5) / ROWS * np.pi)[:, None]
    bright = light * height
    flat = np.broadcast_to(height, light.shape)
    total = (1 - _EVERYWHERE) * bright / bright.sum() + _EVERYWHERE * flat / flat.sum()
    return total.ravel()


def alias_table(
    chance: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float64]]:
    """Walker's table of probabilities that sum to 1.

    Returns:
        share: of each slot that belongs to its own cell.
        alias: the cell that the rest of each slot belongs to.
        chance: as given.
    """
    scaled = (chance * len(chance)).tolist()
    share = np.ones(len(chance), np.float32)
    alias = np.arange(len(chance), dtype=np.uint32)
    small = [i for i, x in enumerate(scaled) if x < 1]
    large = [i for i, x in enumerate(scaled) if x >= 1]
    while small and large:
        low, high = small.pop(), large[-1]
        share[low], alias[low] = scaled[low], high
        scaled[high] -= 1 - scaled[low]
        if scaled[high] < 1:
            small.append(large.pop())
    return share, alias, chance
