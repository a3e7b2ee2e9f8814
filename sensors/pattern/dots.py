"""Where a projector's dots lie, as angles from its axis.

A dot at (a, b) leaves the axis by the angle |(a, b)| towards (a, b). Spread evenly so, dots thin
out on a wall away from the axis: to 73 % at 27 degrees and to 59 % at 35. In a picture of a D415's
pattern it was 70 % and 59 %.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sensors.compiled import compiled

Array = NDArray[np.float64]
# Farthest dot from the axis, in radians.
WIDEST = 1.3
Places = Callable[[float, np.random.Generator], Array]

# Of the real D415: cells, where the two lattices fall together, are 5.5 pitches apart.
LATTICE_TURN_RAD = 0.18
# Share of the pitch by which a dot misses its place, and by which the lattices are bent: without
# the latter all cells were alike, and a matcher could mistake one for another.
LATTICE_JITTER = 0.04
LATTICE_BEND = 0.25
# Least distance of scattered dots, as a share of the mean one. Darts that are thrown until no more
# fit come to 0.83: this leaves them some freedom.
SCATTER_DISTANCE = 0.72


def two_lattices(density: float, rng: np.random.Generator) -> Array:
    """Two square lattices, turned against each other, as of a D415's two projectors.

    Args:
        density: dots per square radian.

    Returns:
        (N, 2) angles in radians.
    """
    pitch = float(np.sqrt(2 / density))
    turn = rng.uniform(0, np.pi / 2)
    count = int(1.1 * WIDEST * np.sqrt(2) / pitch)
    grid = np.mgrid[-count : count + 1, -count : count + 1].reshape(2, -1).T * pitch
    lattices = []
    for angle in (turn - LATTICE_TURN_RAD / 2, turn + LATTICE_TURN_RAD / 2):
        c, s = np.cos(angle), np.sin(angle)
        dots = grid @ np.array([[c, s], [-s, c]]) + rng.uniform(-0.5, 0.5, 2) * pitch
        dots = dots + _bend(dots, rng) * LATTICE_BEND * pitch
        lattices.append(dots + rng.normal(size=dots.shape) * LATTICE_JITTER * pitch)
    return _ahead(np.concatenate(lattices))


def scattered(density: float, rng: np.random.Generator) -> Array:
    """Dots at random places that keep a distance; arguments and result as of `two_lattices`."""
    count = round(4 * WIDEST**2 * density)
    distance = SCATTER_DISTANCE / np.sqrt(density)
    dots = np.empty((0, 2))
    for throws in (12, 24, 48, 96):
        darts = rng.uniform(-WIDEST, WIDEST, (throws * count, 2))
        dots = apart(np.concatenate([dots, darts]), distance, count)
        if len(dots) == count:
            break
    return _ahead(dots)


def apart(darts: Array, distance: float, count: int) -> Array:
    """The first `count` of the darts (N, 2), up to WIDEST off, that keep the distance."""
    cells = max(1, int(2 * WIDEST / distance))
    kept = _apart(darts, distance, count, cells)
    return darts[kept[kept >= 0]]


@compiled
def _apart(darts, distance, count, cells):  # type: ignore[no-untyped-def]
    # A cell is at least as wide as the distance, so that neighbours lie in the cells around, and
    # less than twice as wide, so that it holds at most nine dots.
    holds = np.full((cells, cells, 9), -1)
    kept = np.full(count, -1)
    found = 0
    for i in range(len(darts)):
        x, y = darts[i]
        column = min(cells - 1, int((x / WIDEST + 1) / 2 * cells))
        row = min(cells - 1, int((y / WIDEST + 1) / 2 * cells))
        free = True
        for r in range(max(0, row - 1), min(cells, row + 2)):
            for c in range(max(0, column - 1), min(cells, column + 2)):
                for k in range(9):
                    j = holds[r, c, k]
                    if j < 0:
                        break
                    if (darts[j, 0] - x) ** 2 + (darts[j, 1] - y) ** 2 < distance**2:
                        free = False
        if not free:
            continue
        k = 0
        while k < 8 and holds[row, column, k] >= 0:
            k += 1
        holds[row, column, k] = i
        kept[found] = i
        found += 1
        if found == count:
            break
    return kept


def _bend(dots: Array, rng: np.random.Generator) -> Array:
    """Smooth displacements (N, 2) of unit size, a few waves over the field of view."""
    out = np.zeros_like(dots)
    for _ in range(6):
        direction = rng.uniform(0, 2 * np.pi)
        waves = 2 * np.pi / rng.uniform(0.25, 0.8)
        phase = dots @ (waves * np.array([np.cos(direction), np.sin(direction)]))
        way = rng.normal(size=2)
        out += np.sin(phase + rng.uniform(0, 2 * np.pi))[:, None] * way / np.sqrt(6)
    return out


def _ahead(dots: Array) -> Array:
    return dots[(dots**2).sum(axis=1) < WIDEST**2]
