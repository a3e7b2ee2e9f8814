"""Lens models: where a ray meets the image, and the ray behind a pixel.

A model maps normalised rays (x/z, y/z) to normalised image coordinates, to which the camera applies
focal lengths and principal point. `Camera.lens` is `Pinhole | OpenCV | Fisheye`. Other names of a
model, such as those of ROS, Kalibr, nerfstudio and COLMAP, are attributes of its class, so that
every reader recognises them.

To add a model, edit two files:

1. here: a subclass of `Lens` with `distort` and `undistort`, and its entry in `MODELS`;
2. `tests/std_toolkit/geometry/test_camera_models.py`: an example in `LENSES`, which is compared
   with the reference projection and must invert.

Import, restoring, scanning and the COLMAP interface then use it. With `in_scenes = False`, images
are undistorted to a pinhole before they become part of a scene.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError

Array = NDArray[np.float64]

# Rational models of real lenses reach some hundred.
LARGEST_DISTORTION = 1e4


@dataclass(frozen=True)
class Lens(ABC):
    """Base class of lens models.

    Attributes:
        coefficients: distortion coefficients.
        counts: allowed numbers of coefficients.
        order: what the coefficients are, for messages.
        in_scenes: whether scenes keep images of this lens as they are.
        named: names in foreign files, lower case without separators.
        colmap: COLMAP's models: name -> number of focal lengths and of coefficients.

    Raises:
        ToolkitError: another number of coefficients, or one that is not finite or implausible.
    """

    coefficients: tuple[float, ...] = ()

    counts: ClassVar[tuple[int, ...]]
    order: ClassVar[str]
    in_scenes: ClassVar[bool]
    named: ClassVar[tuple[str, ...]]
    colmap: ClassVar[dict[str, tuple[int, int]]]

    def __post_init__(self) -> None:
        k = self.coefficients
        if len(k) not in self.counts:
            allowed = " or ".join(
                filter(None, (", ".join(map(str, self.counts[:-1])), str(self.counts[-1])))
            )
            raise ToolkitError(
                f"distortion has {allowed} coefficients ({self.order})",
                field="distortion",
                value=len(k),
            )
        if not all(np.isfinite(k)):
            raise ToolkitError("is not finite", field="distortion", value=k)
        if any(abs(c) > LARGEST_DISTORTION for c in k):
            raise ToolkitError(
                f"no lens has coefficients above {LARGEST_DISTORTION:g}",
                field="distortion",
                value=k,
            )

    @abstractmethod
    def distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Normalised image coordinates of normalised rays, all (...).

        Rays beyond the fold, where the polynomial no longer increases, give NaN.
        """

    @abstractmethod
    def undistort(self, uv: Array, K: Array) -> Array:
        """Normalised rays (..., 2) behind pixels uv (..., 2); NaN where none reaches the pixel.

        Args:
            uv: pixels.
            K: (3, 3) camera matrix.
        """


class Pinhole(Lens):
    """The ideal lens."""

    counts = (0,)
    order = "none"
    in_scenes = True
    named = ("pinhole", "simplepinhole", "perspective", "none")
    colmap: ClassVar = {"SIMPLE_PINHOLE": (1, 0), "PINHOLE": (2, 0)}

    def distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        """See `Lens`."""
        return x, y

    def undistort(self, uv: Array, K: Array) -> Array:
        """See `Lens`."""
        return (uv - [K[0, 2], K[1, 2]]) / [K[0, 0], K[1, 1]]


class OpenCV(Lens):
    """OpenCV's radial-tangential model: k1 k2 p1 p2 [k3 [k4 k5 k6]], the last ones rational."""

    counts = (0, 4, 5, 8)
    order = "k1 k2 p1 p2 [k3 [k4 k5 k6]]"
    in_scenes = True
    named = (
        "opencv", "fullopencv", "simpleradial", "radial", "radtan", "radialtangential", "plumbbob",
        "rationalpolynomial", "rational", "rationalmodel", "brownconrady", "brown", "radtan8",
        "pinholeradtan", "pinholeradtan8", "radialtangential8", "pinholebrownconrady", "opencv5",
        "opencv8",
    )  # fmt: skip
    colmap: ClassVar = {
        "SIMPLE_RADIAL": (1, 1), "RADIAL": (1, 2), "OPENCV": (2, 4), "FULL_OPENCV": (2, 8),
    }  # fmt: skip

    @cached_property
    def padded(self) -> tuple[float, ...]:
        """The eight coefficients k1 k2 p1 p2 k3 k4 k5 k6."""
        return (*self.coefficients, *([0.0] * (8 - len(self.coefficients))))

    def distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        """See `Lens`."""
        valid = x * x + y * y < largest_radius2(self.coefficients)
        return self._polynomial(np.where(valid, x, np.nan), y)

    def undistort(self, uv: Array, K: Array) -> Array:
        """See `Lens`."""
        if not uv.size:  # for which OpenCV returns nothing
            return np.empty(uv.shape)
        # OpenCV's default stops after 5 iterations, which leaves 0.1 px at wide corners.
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
        flat = np.ascontiguousarray(uv.reshape(-1, 1, 2))
        k = np.array(self.coefficients)
        found = cv2.undistortPoints(flat, K, k, criteria=criteria)
        xy = np.asarray(found, dtype=np.float64).reshape(uv.shape)
        wrong = self._is_wrong(xy, uv, K)
        if wrong.any():
            # The fixed-point iteration diverges for strong lenses, and may find a ray beyond the
            # fold.
            xy[wrong] = self._newton((uv[wrong] - [K[0, 2], K[1, 2]]) / [K[0, 0], K[1, 1]])
            wrong[wrong] = self._is_wrong(xy[wrong], uv[wrong], K)
        return np.where(wrong[..., None], np.nan, xy)

    def _is_wrong(self, xy: Array, uv: Array, K: Array) -> NDArray[np.bool_]:
        # Without a solution, the result of the iteration is arbitrary.
        x, y = self._polynomial(xy[..., 0], xy[..., 1])
        error = np.hypot(K[0, 0] * x + K[0, 2] - uv[..., 0], K[1, 1] * y + K[1, 2] - uv[..., 1])
        beyond = (xy**2).sum(axis=-1) >= largest_radius2(self.coefficients)
        return np.asarray(~(error < 1e-6) | beyond)

    def _newton(self, xy: Array) -> Array:
        """Rays (N, 2) of distorted coordinates (N, 2): radial part first, then both."""
        _, _, p1, p2, *_ = self.padded
        radius = np.hypot(xy[:, 0], xy[:, 1])
        # Just before the fold, which may be a pole.
        end = min(np.sqrt(largest_radius2(self.coefficients)) * (1 - 1e-12), 1e3)
        found = solve_increasing(
            lambda r: r * self._radial(r * r)[0],
            lambda r: self._radial(r * r)[0] + 2 * r * r * self._radial(r * r)[1],
            radius,
            end,
        )
        x, y = (xy * (found / np.maximum(radius, 1e-300))[:, None]).T
        with np.errstate(all="ignore"):  # where no ray exists
            for _ in range(20):
                scale, slope = self._radial(x * x + y * y)
                dx, dy = self._polynomial(x, y)
                a = scale + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
                b = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
                d = scale + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
                dx, dy, det = dx - xy[:, 0], dy - xy[:, 1], a * d - b * b
                x, y = x - (d * dx - b * dy) / det, y - (a * dy - b * dx) / det
        return np.stack([x, y], axis=-1)

    def _radial(self, s: Array) -> tuple[Array, Array]:
        """The radial factor at squared radii, and its derivative by them."""
        k1, k2, _, _, k3, k4, k5, k6 = self.padded
        top, bottom = 1 + s * (k1 + s * (k2 + s * k3)), 1 + s * (k4 + s * (k5 + s * k6))
        d_top, d_bottom = k1 + s * (2 * k2 + 3 * s * k3), k4 + s * (2 * k5 + 3 * s * k6)
        return top / bottom, (d_top * bottom - top * d_bottom) / bottom**2

    def _polynomial(self, x: Array, y: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3, k4, k5, k6 = self.padded
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )


class Fisheye(Lens):
    """OpenCV's fisheye (Kannala-Brandt): the radius is t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)
    with t the angle from the optical axis. Rays of 90 degrees and more have no z-depth: NaN.
    """

    counts = (4,)
    order = "k1 k2 k3 k4"
    in_scenes = False
    named = (
        "fisheye", "opencvfisheye", "simplefisheye", "radialfisheye", "simpleradialfisheye",
        "equidistant", "equidist", "equi", "kannalabrandt", "kannalabrandt4", "kannalabrandt8",
        "kb4", "pinholeequi", "pinholeequidistant", "equidistant4", "fisheyeopencv", "fisheye4",
    )  # fmt: skip
    colmap: ClassVar = {
        "SIMPLE_FISHEYE": (1, 0), "FISHEYE": (2, 0), "SIMPLE_RADIAL_FISHEYE": (1, 1),
        "RADIAL_FISHEYE": (1, 2), "OPENCV_FISHEYE": (2, 4),
    }  # fmt: skip

    @cached_property
    def largest_angle(self) -> float:
        """Angle from the axis, radians, up to which the radius increases; at most 90 degrees."""
        k1, k2, k3, k4 = self.coefficients
        first = _first_positive_root([1, 3 * k1, 5 * k2, 7 * k3, 9 * k4])
        return float(np.sqrt(min(first, (np.pi / 2) ** 2)))

    def distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        """See `Lens`."""
        r = np.hypot(x, y)
        angle = np.arctan(r)
        angle = np.where(angle < self.largest_angle, angle, np.nan)
        scale = np.where(r > 1e-12, self._radius(angle) / np.maximum(r, 1e-12), 1.0)
        return x * scale, y * scale

    def undistort(self, uv: Array, K: Array) -> Array:
        """See `Lens`."""
        xy = (uv - [K[0, 2], K[1, 2]]) / [K[0, 0], K[1, 1]]
        radius = np.hypot(xy[..., 0], xy[..., 1])
        end = self.largest_angle
        inside = radius < self._radius(np.asarray(end))
        angle = solve_increasing(self._radius, self._slope, np.where(inside, radius, 0.0), end)
        scale = np.where(radius > 1e-12, np.tan(angle) / np.maximum(radius, 1e-12), 1.0)
        return np.where(inside[..., None], xy * scale[..., None], np.nan)

    def _radius(self, angle: Array) -> Array:
        k1, k2, k3, k4 = self.coefficients
        s = angle * angle
        return angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))

    def _slope(self, angle: Array) -> Array:
        k1, k2, k3, k4 = self.coefficients
        s = angle * angle
        return 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))


MODELS: dict[str, type[Lens]] = {"opencv": OpenCV, "fisheye": Fisheye}


@lru_cache(maxsize=64)
def lens_of(model: str, coefficients: tuple[float, ...]) -> Lens:
    """The lens of a model of `MODELS`; the pinhole for OpenCV's without (nonzero) coefficients.

    Raises:
        ToolkitError: no such model, or coefficients that it does not have.
    """
    if model not in MODELS:
        raise ToolkitError(
            "no such lens model", field="model", value=model, hint=f"one of {', '.join(MODELS)}"
        )
    lens = MODELS[model](coefficients)
    return Pinhole() if model == "opencv" and not any(coefficients) else lens


@lru_cache(maxsize=64)
def largest_radius2(distortion: tuple[float, ...]) -> float:
    """Squared normalised radius below which OpenCV's radial distortion increases.

    r (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3) with s = r^2 increases until the
    first zero of the numerator of its derivative, or of its denominator.
    """
    k1, k2, _, _, k3, k4, k5, k6 = (*distortion, *([0.0] * (8 - len(distortion))))
    s = np.polynomial.Polynomial([0, 1])
    top = 1 + k1 * s + k2 * s**2 + k3 * s**3
    bottom = 1 + k4 * s + k5 * s**2 + k6 * s**3
    slope = top * bottom + 2 * s * (top.deriv() * bottom - top * bottom.deriv())
    return min(_first_positive_root(p.coef) for p in (slope, bottom))


def _first_positive_root(coefficients: ArrayLike) -> float:
    """The smallest positive real root of 1 + c1 s + c2 s^2 + ...; infinite if there is none.

    Args:
        coefficients: 1, c1, c2, ...
    """
    # Of the polynomial in 1/s, whose first coefficient is 1: the last ones may be tiny.
    inverse = np.roots(np.asarray(coefficients))
    real = inverse.real[np.abs(inverse.imag) < 1e-9 * np.maximum(1, np.abs(inverse.real))]
    largest = float(real.max(initial=0.0))
    return 1 / largest if largest > 1e-9 else np.inf


def solve_increasing(
    value: Callable[[Array], Array], slope: Callable[[Array], Array], target: Array, end: float
) -> Array:
    """x in [0, end] with value(x) = target (...), by Newton's method within a bracket.

    Args:
        value: increasing on [0, end], about the identity near 0.
        slope: its derivative.
        target: values; what is beyond value(end) gives `end`.
    """
    low, high = np.zeros_like(target), np.full_like(target, end)
    x = np.clip(target, low, high)
    move = np.full_like(target, end)
    for _ in range(100):
        error = value(x) - target
        high, low = np.where(error > 0, x, high), np.where(error > 0, low, x)
        with np.errstate(all="ignore"):  # the slope is 0 at the fold
            step = x - error / slope(x)
        # Steps that do not halve would cycle about an inflection.
        good = (step >= low) & (step <= high) & (np.abs(step - x) <= move / 2)
        moved = np.where(good, step, (low + high) / 2)
        move, x = np.abs(moved - x), moved
        if move.max(initial=0.0) <= 4e-16 * end:
            break
    return x
