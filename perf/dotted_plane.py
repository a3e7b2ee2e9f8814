"""A matt plane under the projector's dots, by formula: no renderer, hence no render noise.

Holes in its depth come from the pattern, the sensor's noise and the matcher alone. Real cameras
measure such a plane almost completely, which sets the bounds of a pattern.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.depth_models.stereo import with_noise
from sensors.lighting.light_draw import INFRARED_STRENGTH, PROJECTOR_POWER
from sensors.pattern import DotPattern
from sensors.render import infrared_image
from sensors.specs import SensorSpec
from sensors.stereo import make_matcher
from std_toolkit.errors import ToolkitError

# Samples per pixel along each side.
_FINER = 3


@dataclass(frozen=True, kw_only=True)
class DottedPlane:
    """A plane in front of the left infrared camera.

    Attributes:
        distance_m: along the camera's axis.
        tilt_deg: angle between its normal and the axis; its upper part is farther away.
        albedo: its reflectance in infrared.
        ambient: strength of uniform light from all directions.
    """

    distance_m: float = 0.75
    tilt_deg: float = 40.0
    albedo: float = 0.5
    ambient: float = INFRARED_STRENGTH


@dataclass(frozen=True, eq=False)
class PlaneView:
    """A measured plane.

    Attributes:
        left, right: (h, w) uint8 infrared images.
        disparity: (h, w) float32 of the matcher, 0 = none.
        exact: (h, w) true disparity.
        lit: (h, w) bool, pixels that the pattern and both cameras cover, away from the borders.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    disparity: NDArray[np.float32]
    exact: NDArray[np.float64]
    lit: NDArray[np.bool_]

    @property
    def holes(self) -> float:
        """Fraction of the lit pixels without a measurement."""
        return float((self.disparity[self.lit] <= 0).mean())

    @property
    def errors(self) -> NDArray[np.float64]:
        """(N,) errors of the disparity in pixels, of the lit pixels with a measurement."""
        seen = self.lit & (self.disparity > 0)
        return np.asarray((self.disparity - self.exact)[seen], np.float64)


def measure_plane(
    spec: SensorSpec,
    pattern: DotPattern,
    *,
    plane: DottedPlane | None = None,
    noise: bool = True,
    seed: int = 0,
    width: int = 640,
    height: int = 360,
) -> PlaneView:
    """Images of a plane, matched by the local matcher.

    Args:
        spec: sensor with a projector.
        pattern: image that the projector shows.
        plane: the default plane when None.
        noise: whether images and disparity have the sensor's noise.
        seed: of the noise.
        width, height: of the infrared images.

    Raises:
        ToolkitError: the sensor has no projector, or no image of this aspect ratio.
    """
    if spec.projector is None:
        raise ToolkitError("this sensor has no projector", field="projector", value=spec.name)
    plane = plane or DottedPlane()
    camera = spec.infrared_camera(width, height)
    fine = camera.resized(_FINER * width, _FINER * height)
    angle = np.deg2rad(plane.tilt_deg)
    normal = np.array([0.0, np.sin(angle), np.cos(angle)])
    rays = fine.rays()
    z = plane.distance_m * normal[2] / (rays @ normal)
    T_projector_ir = spec.projector.T_ir_projector.inverse()
    light, covered = [], []
    for x in (0.0, spec.baseline_m):
        # The plane contains the baseline's direction: both cameras see the same z.
        seen = T_projector_ir @ (rays * z[..., None] + [x, 0, 0]).reshape(-1, 3)
        seen = seen.reshape(rays.shape)
        at, inside = _pattern_pixels(pattern, seen)
        dots = cv2.remap(pattern.image, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        squared = (seen**2).sum(axis=-1)
        facing = seen @ (T_projector_ir.R @ normal) / np.sqrt(squared)
        irradiance = PROJECTOR_POWER * dots * facing / squared
        radiance = plane.albedo * (irradiance / np.pi + plane.ambient)
        shape = (height, _FINER, width, _FINER)
        light.append(radiance.reshape(shape).mean(axis=(1, 3)))
        covered.append(np.asarray(inside.reshape(shape).all(axis=(1, 3))))
    response = infrared_image.InfraredResponse(noise=noise)
    rng = np.random.default_rng(seed)
    left, right, _ = infrared_image.expose_pair(*light, rng=rng, response=response)
    low, high = spec.disparity_range(width, height)
    found = make_matcher("local", min_disparity=low, max_disparity=high, threads=1)
    disparity = found.match(left, right)
    if noise:
        disparity = with_noise(disparity, rng)
    depth = plane.distance_m * normal[2] / (camera.rays() @ normal)
    exact = camera.fx * spec.baseline_m / depth
    return PlaneView(left, right, disparity, exact, _both_see(covered[0], exact))


def _pattern_pixels(
    pattern: DotPattern, seen: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Pixels of the pattern (..., 2) that points in the projector's frame receive light from."""
    height, width = pattern.image.shape
    at = (seen[..., :2] / seen[..., 2:] / pattern.tan_half + 1) * [width / 2, height / 2] - 0.5
    inside = ((at > 0) & (at < [width - 1, height - 1])).all(axis=-1)
    return at.astype(np.float32), inside


def _both_see(covered: NDArray[np.bool_], exact: NDArray[np.float64]) -> NDArray[np.bool_]:
    window = 7
    lit = covered.copy()
    lit[:window] = lit[-window:] = False
    lit[:, -window:] = False
    column = np.arange(exact.shape[1])
    return np.asarray(lit & (column - exact > window))
