"""Open Image Denoise on as many threads as a worker may use.

Left alone it takes every core and pins its threads to the first ones: several workers on one
machine would then share those. The image does not depend on the number of threads.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

Image = NDArray[np.float32]


class Denoiser:
    """A device of the denoiser.

    Args:
        oidn: the module pyoidn.
        threads: None takes all cores.

    Raises:
        ToolkitError: the device cannot be made.
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
        # Held until the filter is done: it reads and writes them in place.
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
    """The process's denoiser of so many threads; None, with a warning, without the package."""
    try:
        import pyoidn
    except (ImportError, OSError) as error:
        logger.warning("colour images keep the renderer's noise: no denoiser (%s)", error)
        return None
    return Denoiser(pyoidn, threads)
