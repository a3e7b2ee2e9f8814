"""From infrared light to the 8-bit images of a pair: one exposure for both, sensor noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class InfraredResponse:
    """An imager's response.

    Attributes:
        target: grey value that the median of both images is exposed to. A D415 over a cloth lit
            by its own projector has 50.
        brightest: grey value that all but `bright_share` of the pixels stay below: the exposure is
            shorter where bright things lie on a dark ground.
        bright_share: the same camera has 0.04 % above 245.
        electrons_per_grey: electrons in one step of the 8-bit scale: sets the shot noise.
        read_noise_grey: deviation of the noise of an unlit pixel, grey values.
        noise: switch for the ablation without infrared noise.
    """

    target: float = 50.0
    brightest: float = 245.0
    bright_share: float = 0.005
    electrons_per_grey: float = 40.0
    read_noise_grey: float = 0.6
    noise: bool = True


def expose_pair(
    left: NDArray[np.floating],
    right: NDArray[np.floating],
    *,
    rng: np.random.Generator,
    response: InfraredResponse | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], float]:
    """Both images of a pair at a common exposure, as the camera's own control sets it.

    Args:
        left, right: (H, W) radiance.
        rng: of the noise.
        response: the default imager's when None.

    Returns:
        left and right as uint8, and the exposure (grey values per unit of radiance).
    """
    response = response or InfraredResponse()
    both = np.concatenate([left.ravel(), right.ravel()])
    middle, bright = np.quantile(both, [0.5, 1 - response.bright_share])
    exposure = float(
        min(response.target / max(middle, 1e-9), response.brightest / max(bright, 1e-9))
    )
    return (
        expose(left, exposure, rng=rng, response=response),
        expose(right, exposure, rng=rng, response=response),
        exposure,
    )


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
