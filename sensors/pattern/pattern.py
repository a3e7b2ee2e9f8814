"""The image that a sensor's projector throws."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.pattern.dots import Array, Places, scattered, two_lattices
from sensors.specs import SensorSpec
from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import read_color

STYLES: dict[str, Places] = {"two_lattices": two_lattices, "scattered": scattered}
# Pixels per spread of a dot below which its image would be jagged.
FINEST_SPREAD_PX = 0.8


@dataclass(frozen=True, eq=False)
class DotPattern:
    """A perspective image of a projector's light, with square pixels.

    Attributes:
        image: (h, w) float32 0..1, relative power per direction; row 0 is up, column 0 left, seen
            along the axis (OpenCV axes).
        fov_x_deg: full angle between its left and right edges.
        dots: (N, 2) x/z and y/z of the dots, or None where they are not known.
    """

    image: NDArray[np.float32]
    fov_x_deg: float
    dots: Array | None = None

    @property
    def tan_half(self) -> tuple[float, float]:
        """Tangents of the half angles, across and down."""
        half = float(np.tan(np.deg2rad(self.fov_x_deg) / 2))
        return half, half * self.image.shape[0] / self.image.shape[1]


def make_pattern(spec: SensorSpec, *, seed: int = 0, width: int = 2048) -> DotPattern:
    """A pattern of the sensor's kind: the number, style and share of light of its dots.

    The real ones are secret and differ from unit to unit; the same seed gives the same pattern.

    Args:
        seed: of the places of the dots.
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
    # Both halves of the height are scaled like the width, so that pixels are square.
    at = (dots / half[0] + [1, height / width]) * width / 2 - 0.5
    image = _image_of(at, power, (height, width), projector.lit_share, spec.name)
    return DotPattern(image, projector.fov_deg[0], dots)


def load_pattern(path: Path | str, *, fov_x_deg: float) -> DotPattern:
    """A pattern of one's own from an 8-bit PNG or JPEG, grey or colour (its mean is taken).

    Args:
        fov_x_deg: full angle between the image's left and right edges.

    Raises:
        ToolkitError: unreadable, without light, or an angle that no lens has.
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
    """Area of the rectangle of directions up to these tangents, in the measure of `dots`."""
    y, x = np.linspace(-half[1], half[1], 400), np.linspace(-half[0], half[0], 400)
    tangent = np.hypot(x[None], y[:, None])
    angle = np.arctan(tangent)
    # 400 is even: no sample lies on the axis.
    density = angle * np.cos(angle) ** 2 / tangent
    return float(np.trapezoid(np.trapezoid(density, x, axis=1), y))


def _image_of(
    at: Array, power: Array, shape: tuple[int, int], lit_share: float, name: str
) -> NDArray[np.float32]:
    """Gaussian dots, of the spread at which so much of the image is brighter than half a peak."""
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


def _points(at: Array, power: Array, shape: tuple[int, int]) -> NDArray[np.float32]:
    """The dots as points of light, each shared by the four pixels around it."""
    points = np.zeros((shape[0] + 2, shape[1] + 2))
    corner = np.floor(at).astype(int)
    rest = at - corner
    for dx in (0, 1):
        for dy in (0, 1):
            share = abs(1 - dx - rest[:, 0]) * abs(1 - dy - rest[:, 1])
            np.add.at(points, (corner[:, 1] + 1 + dy, corner[:, 0] + 1 + dx), share * power)
    return points[1:-1, 1:-1].astype(np.float32)


def _blurred(points: NDArray[np.float32], spread: float) -> NDArray[np.float32]:
    peak = np.float32(2 * np.pi * spread**2)
    return cv2.GaussianBlur(points, (0, 0), spread) * peak
