"""From rendered colour to the 8-bit image of a camera: denoising, exposure, tone curve, noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sensors.materials.textures import to_srgb
from sensors.render.denoiser import denoiser
from sensors.render.protocol import ColorLight

MIDDLE_GREY = 0.2
"""Linear value that the mean of the logarithm of the image is exposed to."""
BRIGHTEST, BRIGHT_SHARE = 0.8, 0.03
"""Linear value that all but this share of the image stays below."""
NOISE = 0.006
"""Deviation of the camera's own noise, as a share of full scale."""


def denoise(light: ColorLight, *, threads: int | None = None) -> NDArray[np.float32]:
    """(H, W, 3) radiance without the renderer's noise, by Open Image Denoise where it is there.

    Without it (package pyoidn) the light comes back as it is, and a warning says so once.

    Args:
        light: as rendered.
        threads: None takes all cores.

    Raises:
        ToolkitError: the denoiser fails.
    """
    clean = denoiser(threads)
    if clean is None:
        return light.radiance
    if light.albedo is None or light.normal is None:
        return clean(light.radiance, None, None)
    return clean(light.radiance, light.albedo, light.normal)


def develop(
    radiance: NDArray[np.floating],
    *,
    rng: np.random.Generator | None = None,
    exposure: float | None = None,
) -> tuple[NDArray[np.uint8], float]:
    """8-bit sRGB image of linear radiance.

    Args:
        radiance: (H, W, 3).
        rng: of the camera's noise; None adds none.
        exposure: factor on the radiance; None exposes for middle grey.

    Returns:
        (H, W, 3) uint8 image and the exposure used.
    """
    if exposure is None:
        level = np.asarray(radiance, np.float64).mean(axis=-1)
        middle = float(np.exp(np.log(level + 1e-4).mean()))
        bright = float(np.quantile(level, 1 - BRIGHT_SHARE))
        exposure = min(MIDDLE_GREY / max(middle, 1e-6), BRIGHTEST / max(bright, 1e-6))
    x = np.maximum(np.asarray(radiance, np.float32) * np.float32(exposure), 0)
    # Highlights roll off instead of clipping at once.
    x = np.where(x > 0.6, 0.6 + 0.4 * (1 - np.exp(-(x - 0.6) / 0.4)), x)
    if rng is not None:
        x = x + NOISE * rng.standard_normal(x.shape, np.float32) * np.sqrt(x + 0.05)
    return to_srgb(x), float(exposure)
