"""From rendered colour to the 8-bit image of a camera: denoising, exposure, tone curve, noise.

Open Image Denoise runs on a limited number of threads: by default it uses every core and pins its
threads to the first ones, which several workers on one machine would then share. The image does not
depend on the number of threads.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.materials.textures import to_srgb
from sensors.render.sim_renderer import ColorLight
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

MIDDLE_GREY = 0.2

Image = NDArray[np.float32]


"""Linear value to which the exposure maps the log-mean of the image."""

BRIGHTEST, BRIGHT_SHARE = 0.8, 0.03


"""Linear value that all but this fraction of the image stays below."""

NOISE = 0.006


"""Standard deviation of the camera noise as a fraction of full scale."""


def denoise(light: ColorLight, *, threads: int | None = None) -> NDArray[np.float32]:
    """(H, W, 3) radiance without the renderer's noise, by Open Image Denoise if installed.

    Without it (package pyoidn) the radiance is returned unchanged, with one warning.

    Args:
        light: as rendered.
        threads: None uses all cores.

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
        rng: generator of the camera noise; None adds none.
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


class Denoiser:
    """A device of Open Image Denoise.

    Args:
        oidn: the module pyoidn.
        threads: None uses all cores.

    Raises:
        ToolkitError: the device cannot be created.
    """

    def __init__(self, oidn: Any, threads: int | None) -> None:
        self._oidn = oidn
        self._device = oidn.Device()
        if threads is not None:
            self._device.set_int("numThreads", threads)
        self._device.set_bool("setAffinity", False)
        self._device.commit()
        self._check()

    def __call__(self, color: Image, albedo: Image | None, normal: Image | None) -> Image:
        """(H, W, 3) high-dynamic-range colour without noise.

        Args:
            color: (H, W, 3) linear.
            albedo, normal: of the first surface, each (H, W, 3) or None.

        Raises:
            ToolkitError: the denoiser fails.
        """
        oidn = self._oidn
        clean = np.empty(color.shape, np.float32)
        images = {"color": color, "albedo": albedo, "normal": normal, "output": clean}
        # Referenced until the filter is done: it reads and writes the arrays in place.
        held = {k: np.ascontiguousarray(v, np.float32) for k, v in images.items() if v is not None}
        with oidn.Filter(self._device) as work:
            for name, image in held.items():
                work.set_image(name, image, oidn.OIDN_FORMAT_FLOAT3)
            work.set_bool("hdr", True)
            work.commit()
            work.execute()
            self._check()
        return held["output"]

    def _check(self) -> None:
        problem = self._device.get_error()
        if problem:
            raise ToolkitError(f"the denoiser failed: {problem}")


@lru_cache(maxsize=4)
def denoiser(threads: int | None) -> Denoiser | None:
    """The denoiser of this process with this many threads; None and a warning if not installed."""
    try:
        import pyoidn
    except (ImportError, OSError) as error:
        logger.warning("images keep the renderer's noise: no denoiser (%s)", error)
        return None
    return Denoiser(pyoidn, threads)
