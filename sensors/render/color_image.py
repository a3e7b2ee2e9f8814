"""From rendered colour to the 8-bit image of a camera: denoising, exposure, tone curve, noise.

Open Image Denoise runs on a limited number of threads: by default it uses every core and pins its
threads to the first ones, which several workers on one machine would then share. The image does not
depend on the number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from sensors.materials.textures import to_srgb
from sensors.render.sim_renderer import ColorLight
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.log import logger

MIDDLE_GREY = 0.2

Image = Floats


"""Linear value to which the exposure maps the log-mean of the image."""

BRIGHTEST, BRIGHT_SHARE = 0.8, 0.03


"""Linear value that all but this fraction of the image stays below."""

NOISE = 0.006


"""Standard deviation of the camera noise as a fraction of full scale."""


WIDEST_LENS = 3.0


"""Largest pinhole image for a lens, as a multiple of the image's sides."""


def denoise(light: ColorLight, *, threads: int | None = None, fast: bool = False) -> Floats:
    """(H, W, 3) radiance without the renderer's noise, by Open Image Denoise if installed.

    Without it (package pyoidn) the radiance is returned unchanged, with one warning.

    Args:
        light: as rendered.
        threads: None uses all cores.
        fast: see `Denoiser`.

    Raises:
        ToolkitError: the denoiser fails.
    """
    clean = denoiser(threads)
    if clean is None:
        return light.radiance
    if light.albedo is None or light.normal is None:
        return clean(light.radiance, None, None, fast=fast)
    return clean(light.radiance, light.albedo, light.normal, fast=fast)


@dataclass(frozen=True)
class Lens:
    """Images of a camera with distortion from those of a pinhole, which renderers know.

    Attributes:
        camera: of the images.
        rendered: pinhole of the same focal length that sees at least as much.
    """

    camera: Camera
    rendered: Camera

    @staticmethod
    def of(camera: Camera) -> Lens:
        """The lens of a camera.

        Raises:
            ToolkitError: the lens sees too wide for a pinhole.
        """
        if not camera.is_distorted:
            return Lens(camera, camera)
        rays = camera.rays()[..., :2].reshape(-1, 2)
        # Bilinear sampling reads a pixel further.
        half = [
            int(np.ceil(f * np.abs(axis).max())) + 2 if np.isfinite(axis).all() else np.inf
            for axis, f in zip(rays.T, (camera.fx, camera.fy), strict=True)
        ]
        if max(half[0] / camera.width, half[1] / camera.height) > WIDEST_LENS / 2:
            raise ToolkitError(
                "the lens sees too wide to be rendered by a pinhole",
                field="distortion",
                value=list(camera.distortion),
                hint="undistort the images first: `std-curate import --undistort-fov`",
            )
        width, height = (2 * int(n) + 1 for n in half)
        middle = float(half[0]), float(half[1])
        return Lens(camera, Camera(width, height, camera.fx, camera.fy, *middle))

    def bent(self, radiance: Floats) -> Floats:
        """(H, W, 3) image of `camera` of one of `rendered`."""
        if self.rendered is self.camera:
            return radiance
        u, v = np.moveaxis(self.rendered.project(self.camera.rays()).astype(np.float32), -1, 0)
        return np.asarray(cv2.remap(radiance, u, v, cv2.INTER_LINEAR), np.float32)


class ColorResponse(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the colour camera in one frame; the defaults are those of a good picture.

    Attributes:
        exposure_ev: deviation from the automatic exposure, in stops.
        red_gain, blue_gain: errors of the white balance, relative to green.
        gain: factor on the noise.
        blur_share: length of the motion blur as a fraction of the image's width.
        blur_rad: its direction, from the image's x axis.
    """

    exposure_ev: float = 0.0
    red_gain: float = 1.0
    blue_gain: float = 1.0
    gain: float = 1.0
    blur_share: float = 0.0
    blur_rad: float = 0.0


EXPOSURE_EV = 1.5

BLURRED_SHARE, LONGEST_BLUR = 0.3, 8 / 640


def draw_response(rng: np.random.Generator) -> ColorResponse:
    """Random settings; consumes seven numbers."""
    off, spread, red, blue, gain, blurred, angle = rng.random(7)
    # Most automatic exposures are nearly right.
    ev = EXPOSURE_EV * (2 * spread - 1) * (1.0 if off < 0.4 else 0.3)
    blur = blurred / BLURRED_SHARE if blurred < BLURRED_SHARE else 0.0
    return ColorResponse(
        exposure_ev=float(ev),
        red_gain=float(0.85 + 0.3 * red),
        blue_gain=float(0.85 + 0.3 * blue),
        gain=float(4**gain),
        blur_share=float(LONGEST_BLUR * blur),
        blur_rad=float(np.pi * angle),
    )


def _moved(radiance: Image, length_px: float, angle: float) -> Image:
    """Light smeared along a line."""
    size = 2 * int(np.ceil(length_px / 2)) + 1
    at = np.linspace(-length_px / 2, length_px / 2, 4 * size)
    kernel = np.zeros((size, size), np.float32)
    x, y = (np.rint(at * f(angle)).astype(int) + size // 2 for f in (np.cos, np.sin))
    np.add.at(kernel, (y, x), 1 / len(at))
    return np.asarray(cv2.filter2D(radiance, -1, kernel, borderType=cv2.BORDER_REFLECT), np.float32)


def develop(
    radiance: NDArray[np.floating],
    *,
    rng: np.random.Generator | None = None,
    exposure: float | None = None,
    response: ColorResponse | None = None,
) -> tuple[NDArray[np.uint8], float]:
    """8-bit sRGB image of linear radiance.

    Args:
        radiance: (H, W, 3).
        rng: generator of the camera noise; None adds none.
        exposure: factor on the radiance; None exposes for middle grey.
        response: deviations from a good picture; None: there are none.

    Returns:
        (H, W, 3) uint8 image and the exposure used.
    """
    if exposure is None:
        level = np.asarray(radiance, np.float64).mean(axis=-1)
        middle = float(np.exp(np.log(level + 1e-4).mean()))
        bright = float(np.quantile(level, 1 - BRIGHT_SHARE))
        exposure = min(MIDDLE_GREY / max(middle, 1e-6), BRIGHTEST / max(bright, 1e-6))
    response = response or ColorResponse()
    exposure *= 2**response.exposure_ev
    x = np.maximum(np.asarray(radiance, np.float32) * np.float32(exposure), 0)
    x = x * np.array([response.red_gain, 1.0, response.blue_gain], np.float32)
    if response.blur_share * x.shape[1] >= 1:
        x = _moved(x, response.blur_share * x.shape[1], response.blur_rad)
    # Highlights roll off instead of clipping at once.
    x = np.where(x > 0.6, 0.6 + 0.4 * (1 - np.exp(-(x - 0.6) / 0.4)), x)
    if rng is not None:
        x = x + response.gain * NOISE * rng.standard_normal(x.shape, np.float32) * np.sqrt(x + 0.05)
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

    def __call__(
        self, color: Image, albedo: Image | None, normal: Image | None, *, fast: bool = False
    ) -> Image:
        """(H, W, 3) high-dynamic-range colour without noise.

        Args:
            color: (H, W, 3) linear.
            albedo, normal: of the first surface, each (H, W, 3) or None.
            fast: use the smaller network, in half the time.

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
            if fast:
                work.set_int("quality", oidn.OIDN_QUALITY_FAST)
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
