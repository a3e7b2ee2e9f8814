"""From infrared light to the 8-bit images of a pair: lens, one exposure for both, sensor noise.

The figures were measured on the infrared pair of a real D415 (640x360, a cloth at 0.45 m).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

BLUR_SHARE = 0.5 / 640
"""Spread of the lens blur as a fraction of the image width.

Of blurs from 0 to 0.8 px at a width of 640, 0.4 to 0.7 px fitted real dots best (their contrast,
and the quantiles and autocorrelation of their brightness), depending on the size of the dots.
"""
_FULL = 255.0


@dataclass(frozen=True, kw_only=True)
class InfraredResponse:
    """An imager's response.

    Attributes:
        target: mean grey value of both images, to which the camera's auto-exposure converges
            ("mean intensity set point" in librealsense); the real pair has 54. Values above white
            count as white: bright objects on a dark ground saturate.
        blur_px: spread of the lens blur; None: `BLUR_SHARE` of the width. A crop of an image
            needs the blur of the whole image.
        electrons_per_grey: electrons per step of the 8-bit scale, which sets the shot noise. On
            smooth patches of the real pair the noise is 0.3 at grey 10, 0.5 at 24, 0.8 at 65,
            rounding included.
        read_noise_grey: standard deviation of the noise of an unlit pixel, grey values.
        noise: switch for the ablation without infrared noise.
    """

    target: float = 54.0
    blur_px: float | None = None
    electrons_per_grey: float = 130.0
    read_noise_grey: float = 0.2
    noise: bool = True


def expose_pair(
    left: NDArray[np.floating],
    right: NDArray[np.floating],
    *,
    rng: np.random.Generator,
    response: InfraredResponse | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], float]:
    """Both images of a pair at a common exposure, as set by the camera's auto-exposure.

    Args:
        left, right: (H, W) radiance.
        rng: generator of the noise.
        response: the default imager's when None.

    Returns:
        left and right as uint8, and the exposure (grey values per unit of radiance).
    """
    response = response or InfraredResponse()
    blur = BLUR_SHARE * left.shape[1] if response.blur_px is None else response.blur_px
    left, right = blurred(left, blur), blurred(right, blur)
    exposure = exposure_for(np.concatenate([left.ravel(), right.ravel()]), response.target)
    return (
        expose(left, exposure, rng=rng, response=response),
        expose(right, exposure, rng=rng, response=response),
        exposure,
    )


def blurred(light: NDArray[np.floating], spread_px: float) -> NDArray[np.floating]:
    """Light (H, W) after a lens that spreads points as Gaussians; 0 leaves it as it is."""
    if spread_px <= 0:
        return light
    return np.asarray(cv2.GaussianBlur(light, (0, 0), spread_px, borderType=cv2.BORDER_REPLICATE))


def exposure_for(light: NDArray[np.floating], target: float) -> float:
    """Grey values per unit of light at which the mean grey value, clipped, is the target."""
    level = np.sort(np.maximum(np.asarray(light, np.float64).ravel(), 0))
    below = np.cumsum(level)
    # Exposure that the target requires if pixels up to i are unsaturated.
    saturated = len(level) - 1 - np.arange(len(level))
    exposures = (target * len(level) - _FULL * saturated) / np.maximum(below, 1e-12)
    fits = np.flatnonzero((below > 0) & (exposures > 0) & (exposures * level <= _FULL))
    if len(fits) == 0:  # too few pixels are lit: they become white
        return _FULL / max(float(level[-1]), 1e-9)
    return float(exposures[fits[-1]])


def expose(
    light: NDArray[np.floating],
    exposure: float,
    *,
    rng: np.random.Generator,
    response: InfraredResponse,
) -> NDArray[np.uint8]:
    """(H, W) uint8 image of radiance at an exposure; bright pixels saturate."""
    grey = np.asarray(light, np.float64) * exposure
    if response.noise:
        # Poisson statistics are Gaussian to 1 % above a few tens of electrons.
        deviation = np.sqrt(
            np.maximum(grey, 0) / response.electrons_per_grey + response.read_noise_grey**2
        )
        grey = grey + deviation * rng.standard_normal(grey.shape)
    return np.asarray(np.clip(np.rint(grey), 0, 255), dtype=np.uint8)
