"""Dot patterns of projectors: positions of the dots, and the projected image.

Positions are angles from the projector's axis: a dot at (a, b) leaves the axis by the angle
|(a, b)| towards (a, b). With uniform density in these angles, dots on a wall become sparser away
from the axis: 73 % of the central density at 27 degrees, 59 % at 35. An image of a D415's pattern
showed 70 % and 59 %.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from sensors.specs import SensorSpec
from std_toolkit.arrays import Array, Floats
from std_toolkit.compiled import compiled
from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import read_color

# Farthest dot from the axis, in radians.
WIDEST = 1.3

Places = Callable[[float, np.random.Generator], Array]

# Of the real D415: cells, where the two lattices coincide, are 5.5 pitches apart.
LATTICE_TURN_RAD = 0.18

# Jitter of the dots and bending of the lattices, as a fraction of the pitch. Without them all cells
# would be alike, and a matcher would confuse them. On a plane at 0.75 m tilted by 40 degrees the
# largest share of holes of ten seeds, without noise, was 4.4 % with a jitter of 0.04, 0.09 % with
# 0.1 and 0.01 % with 0.13; a photographed D415 pattern has 0.12 %.
LATTICE_JITTER = 0.1

LATTICE_BEND = 0.25

# Minimum distance of scattered dots as a fraction of the mean one. Dart throwing until no more fit
# reaches 0.83; a smaller value keeps the dots irregular.
SCATTER_DISTANCE = 0.72

# Below this spread of a dot, in pixels, its image would be aliased.
FINEST_SPREAD_PX = 0.8


def two_lattices(density: float, rng: np.random.Generator) -> Array:
    """Two square lattices rotated against each other, like those of a D415's two projectors.

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
    """Random dots with a minimum distance; arguments and result as of `two_lattices`."""
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
    """The first `count` of the darts (N, 2), up to WIDEST off axis, that keep the distance."""
    cells = max(1, int(2 * WIDEST / distance))
    kept = _apart(darts, distance, count, cells)
    return darts[kept[kept >= 0]]


@compiled
def _apart(darts, distance, count, cells):  # type: ignore[no-untyped-def]
    # A cell is at least as wide as the distance, so that neighbours are in the adjacent cells, and
    # less than twice as wide, so that it contains at most nine dots.
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


STYLES: dict[str, Places] = {"two_lattices": two_lattices, "scattered": scattered}


@dataclass(frozen=True, eq=False)
class DotPattern:
    """A perspective image of a projector's light, with square pixels.

    Attributes:
        image: (h, w) float32 0..1, relative power per direction; row 0 is up, column 0 left, seen
            along the axis (OpenCV axes).
        fov_x_deg: full angle between its left and right edges.
        dots: (N, 2) x/z and y/z of the dots, or None if unknown.
    """

    image: Floats
    fov_x_deg: float
    dots: Array | None = None

    @property
    def tan_half(self) -> tuple[float, float]:
        """Tangents of the half angles, horizontal and vertical."""
        half = float(np.tan(np.deg2rad(self.fov_x_deg) / 2))
        return half, half * self.image.shape[0] / self.image.shape[1]


def make_pattern(spec: SensorSpec, *, seed: int = 0, width: int = 2048) -> DotPattern:
    """A pattern with the sensor's number, style and lit area of dots.

    The patterns of real projectors are not published and differ from unit to unit. The same seed
    gives the same pattern.

    Args:
        seed: of the positions of the dots.
        width: of the image, in pixels.

    Raises:
        ToolkitError: the sensor has no projector, or the image is too small for the dots.
    """
    projector = spec.projector
    if projector is None:
        raise ToolkitError("this sensor has no projector", field="projector", value=spec.name)
    rng = np.random.default_rng([seed, projector.dots_in_view])
    view = _tangents(spec.depth.field_of_view_deg)
    half = _tangents(projector.fov_deg)
    angles = STYLES[projector.style](projector.dots_in_view / _square_radians(view), rng)
    off_axis = np.hypot(*angles.T)
    dots = angles * np.divide(np.tan(off_axis), off_axis, where=off_axis > 0, out=off_axis)[:, None]
    dots = dots[(abs(dots) < half).all(axis=1)]
    height = round(width * half[1] / half[0])
    power = rng.uniform(0.75, 1.25, len(dots))
    # Both half heights are scaled like the width, so that pixels are square.
    at = (dots / half[0] + [1, height / width]) * width / 2 - 0.5
    image = _image_of(at, power, (height, width), projector.lit_share, spec.name)
    return DotPattern(image, projector.fov_deg[0], dots)


def load_pattern(path: Path | str, *, fov_x_deg: float) -> DotPattern:
    """Your own pattern from an 8-bit PNG or JPEG, grey or colour (the channel mean is used).

    Args:
        fov_x_deg: full angle between the image's left and right edges.

    Raises:
        ToolkitError: unreadable, black, or an angle out of range.
    """
    if not 1 <= fov_x_deg <= 170:
        raise ToolkitError("must lie in 1..170", field="fov_x_deg", value=fov_x_deg)
    image = read_color(path).mean(axis=2, dtype=np.float32) / np.float32(255)
    if not image.any():
        raise ToolkitError("the pattern is black", path=path)
    return DotPattern(image, float(fov_x_deg))


def _tangents(fov_deg: list[float]) -> Array:
    return np.tan(np.deg2rad(fov_deg) / 2)


def _square_radians(half: Array) -> float:
    """Area of the rectangle of directions up to these tangents, in square radians of `dots`."""
    y, x = np.linspace(-half[1], half[1], 400), np.linspace(-half[0], half[0], 400)
    tangent = np.hypot(x[None], y[:, None])
    angle = np.arctan(tangent)
    # 400 is even: no sample is on the axis.
    density = angle * np.cos(angle) ** 2 / tangent
    return float(np.trapezoid(np.trapezoid(density, x, axis=1), y))


def _image_of(
    at: Array, power: Array, shape: tuple[int, int], lit_share: float, name: str
) -> Floats:
    """Gaussian dots with the spread at which `lit_share` of the image exceeds half a peak."""
    points = _points(at, power, shape)
    low, high = 0.2, 20.0
    for _ in range(14):
        spread = np.sqrt(low * high)
        lit = float((_blurred(points, spread) > 0.5).mean())
        low, high = (spread, high) if lit < lit_share else (low, spread)
    if spread < FINEST_SPREAD_PX:
        raise ToolkitError(
            f"the pattern of {name} has dots finer than a pixel of this image",
            field="width",
            value=shape[1],
            hint=f"make it {int(np.ceil(shape[1] * FINEST_SPREAD_PX / spread))} wide",
        )
    return np.minimum(_blurred(points, spread), 1)


def _points(at: Array, power: Array, shape: tuple[int, int]) -> Floats:
    """The dots as points of light, each distributed over the four nearest pixels."""
    points = np.zeros((shape[0] + 2, shape[1] + 2))
    corner = np.floor(at).astype(int)
    rest = at - corner
    for dx in (0, 1):
        for dy in (0, 1):
            share = abs(1 - dx - rest[:, 0]) * abs(1 - dy - rest[:, 1])
            np.add.at(points, (corner[:, 1] + 1 + dy, corner[:, 0] + 1 + dx), share * power)
    return points[1:-1, 1:-1].astype(np.float32)


def _blurred(points: Floats, spread: float) -> Floats:
    peak = np.float32(2 * np.pi * spread**2)
    return cv2.GaussianBlur(points, (0, 0), spread) * peak
