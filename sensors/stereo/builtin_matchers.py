"""The built-in stereo matchers: local (census or ZNCC), OpenCV's SGBM, and that of DREDS.

- The local matcher minimises a sum of costs over a window, without smoothness between pixels.
- SGBM is OpenCV's semi-global matcher: smooth, hence less like a depth camera on glass and metal.
- The DREDS matcher is a soft minimum: every disparity has weight exp(100 ZNCC). If two are about
  equally likely, as on glass, the result is between them and on neither surface.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.stereo.local_options import Backend, LocalMatcherOptions
from sensors.stereo.stereo_matcher import Disparity, Image, check_pair
from std_toolkit.errors import ToolkitError
from std_toolkit.options import usable_cores

NONE = np.float32(-1)


@dataclass(frozen=True, kw_only=True)
class DredsOptions:
    """Constants of the released simulator, for images of 640x360.

    Attributes:
        block_px: side of the correlation's window.
        min_disparity, max_disparity: pixels. As released, the two largest are never tried; their
            correlation counts as 0.
        sharpness: factor of the correlation in the exponent.
        left_right_px2: largest squared difference of the two images' disparities.
        median_px: side of the median filter, 3 or 5.
        bilateral_px, bilateral_disparity, bilateral_space: diameter of the bilateral filter, and
            its spreads in pixels of disparity and of the image. Holes enter as -1, as released.
    """

    block_px: int = 11
    min_disparity: int = 3
    max_disparity: int = 110
    sharpness: float = 100.0
    left_right_px2: float = 0.5
    median_px: int = 5
    bilateral_px: int = 7
    bilateral_disparity: float = 0.02 * 108
    bilateral_space: float = 3.0

    def __post_init__(self) -> None:
        if self.block_px < 3 or self.block_px % 2 == 0:
            raise ToolkitError("must be an odd number", field="block_px", value=self.block_px)
        if not 0 <= self.min_disparity <= self.max_disparity - 4:
            raise ToolkitError(
                "the disparity range needs at least five values, from 0 on",
                field="max_disparity",
                value=(self.min_disparity, self.max_disparity),
            )
        if self.median_px not in (3, 5):
            raise ToolkitError("must be 3 or 5", field="median_px", value=self.median_px)


class DredsMatcher:
    """ZNCC, soft minimum, left-right check, median and bilateral filter."""

    def __init__(self, options: DredsOptions | None = None) -> None:
        self.options = options or DredsOptions()

    def match(self, left: Image, right: Image) -> Disparity:
        """See `StereoMatcher`; the released simulator halves images of 1280x720 first."""
        check_pair(left, right)
        o = self.options
        volume = _correlations(left, right, o)
        of_left = _soft_winner(volume, o)
        of_right = _soft_winner(_seen_from_right(volume, o), o)
        width = left.shape[1]
        x = np.arange(width, dtype=np.float32)
        partner = np.clip(np.rint(x - of_left).astype(np.int64), 0, width - 1)
        theirs = np.take_along_axis(of_right, partner, axis=1)
        found = np.where((of_left - theirs) ** 2 > o.left_right_px2, NONE, of_left)
        found = cv2.medianBlur(found, o.median_px)
        found = cv2.bilateralFilter(found, o.bilateral_px, o.bilateral_disparity, o.bilateral_space)
        inside = (found >= o.min_disparity) & (found <= o.max_disparity)
        return np.where(inside, found, 0).astype(np.float32)


def dreds_matcher(**options: Any) -> DredsMatcher:
    """The plug-in: options of `DredsOptions` as keywords."""
    return DredsMatcher(DredsOptions(**options))


def _correlations(left: Image, right: Image, options: DredsOptions) -> NDArray[np.float32]:
    """(H, W, D) zero-mean normalised cross correlation; 0 where a window leaves an image."""
    height, width = left.shape
    d0, radius = options.min_disparity, options.block_px // 2
    count = options.max_disparity - d0 + 1
    volume = np.zeros((height, width, count), dtype=np.float32)
    a, b = left.astype(np.float64), right.astype(np.float64)
    l_mean, r_mean = _window_mean(a, options), _window_mean(b, options)
    l_spread = np.sqrt(np.maximum(_window_mean(a * a, options) - l_mean**2, 0))
    r_spread = np.sqrt(np.maximum(_window_mean(b * b, options) - r_mean**2, 0))
    for d in range(d0, min(options.max_disparity - 1, width - 2 * radius)):
        mean = _window_mean(a[:, d:] * b[:, : width - d], options)
        top = mean - l_mean[:, d:] * r_mean[:, : width - d]
        bottom = l_spread[:, d:] * r_spread[:, : width - d]
        correlation = np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 1e-6)
        rows, columns = slice(radius, height - radius), slice(radius, width - d - radius)
        volume[rows, d + radius : width - radius, d - d0] = correlation[rows, columns]
    return volume


def _window_mean(values: NDArray[np.float64], options: DredsOptions) -> NDArray[np.float64]:
    return cv2.boxFilter(values, cv2.CV_64F, (options.block_px,) * 2)  # type: ignore[return-value]


def _seen_from_right(volume: NDArray[np.float32], options: DredsOptions) -> NDArray[np.float32]:
    """The correlations by pixel of the right image."""
    width = volume.shape[1]
    mirrored = np.zeros_like(volume)
    for i in range(volume.shape[2]):
        d = options.min_disparity + i
        if d < width:
            mirrored[:, : width - d, i] = volume[:, d:, i]
    return mirrored


def _soft_winner(volume: NDArray[np.float32], options: DredsOptions) -> NDArray[np.float32]:
    """(H, W) mean over all disparities of disparity plus parabola offset, or -1."""
    height = volume.shape[0]
    out = np.empty(volume.shape[:2], dtype=np.float32)
    disparity = np.arange(options.min_disparity, options.max_disparity + 1, dtype=np.float32)
    for y in range(height):
        c = volume[y]
        offset = np.zeros_like(c)
        before, here, after = c[:, :-2], c[:, 1:-1], c[:, 2:]
        bend = 2 * (before + after - 2 * here)
        np.divide(before - after, bend, out=offset[:, 1:-1], where=bend != 0)
        weight = np.exp(options.sharpness * (c - c.max(axis=1, keepdims=True)))
        out[y] = (weight * (disparity + offset)).sum(axis=1) / weight.sum(axis=1)
        # At the edges no correlation is known; the mean of the range would pass every check.
        out[y][~c.any(axis=1)] = NONE
    return out


@dataclass(frozen=True, kw_only=True)
class SgbmOptions:
    """Options of `cv2.StereoSGBM`.

    Attributes:
        min_disparity: pixels.
        disparities: number of them, a multiple of 16.
        block_px: odd side of the matched block.
        p1, p2: cost of a change of disparity by one and by more, per pixel of the block.
        uniqueness_percent: the second best must cost at least this much more.
        left_right_px: tolerance of the left-right check, -1: none.
        speckle_px, speckle_step_px: smaller patches are removed; see `LocalMatcherOptions`.
    """

    min_disparity: int = 3
    disparities: int = 112
    block_px: int = 5
    p1: int = 8
    p2: int = 32
    uniqueness_percent: int = 10
    left_right_px: int = 1
    speckle_px: int = 100
    speckle_step_px: int = 2

    def __post_init__(self) -> None:
        if self.disparities <= 0 or self.disparities % 16:
            raise ToolkitError(
                "must be a multiple of 16", field="disparities", value=self.disparities
            )
        if self.block_px < 1 or self.block_px % 2 == 0:
            raise ToolkitError("must be an odd number", field="block_px", value=self.block_px)
        if not 0 < self.p1 < self.p2:
            raise ToolkitError("p2 must be larger than p1", field="p2", value=(self.p1, self.p2))


class SgbmMatcher:
    """`cv2.StereoSGBM` in its three-way mode. Its disparities are multiples of 1/16 pixel."""

    def __init__(self, options: SgbmOptions | None = None) -> None:
        self.options = options or SgbmOptions()

    def match(self, left: Image, right: Image) -> Disparity:
        """See `StereoMatcher`."""
        check_pair(left, right)
        o = self.options
        matcher = cv2.StereoSGBM.create(
            minDisparity=o.min_disparity,
            numDisparities=o.disparities,
            blockSize=o.block_px,
            P1=o.p1 * o.block_px**2,
            P2=o.p2 * o.block_px**2,
            disp12MaxDiff=o.left_right_px,
            uniquenessRatio=o.uniqueness_percent,
            speckleWindowSize=o.speckle_px,
            speckleRange=o.speckle_step_px,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )
        found = matcher.compute(left, right).astype(np.float32) / 16
        return np.where(found >= o.min_disparity, found, 0).astype(np.float32)


def sgbm_matcher(**options: Any) -> SgbmMatcher:
    """The plug-in: options of `SgbmOptions` as keywords."""
    return SgbmMatcher(SgbmOptions(**options))


class LocalMatcher:
    """Census or ZNCC, summed over a box; winner takes all, with checks and a sub-pixel fit.

    Pixels have no disparity if the winner is not unique, if the right image's winner differs, at
    the ends of the disparity range, and in small patches. Real depth cameras leave similar holes on
    surfaces that do not show the projected pattern.
    """

    def __init__(self, options: LocalMatcherOptions | None = None) -> None:
        self.options = options or LocalMatcherOptions()

    def match(self, left: Image, right: Image) -> Disparity:
        """See `StereoMatcher`.

        Raises:
            ToolkitError: not a pair of 8-bit grey images of one size, or the package of the chosen
                backend is not installed.
        """
        check_pair(left, right)
        options = self.options
        if options.backend is Backend.NUMBA:
            from sensors.stereo import numba_backend

            return numba_backend.match(left, right, options, options.threads or usable_cores())
        try:
            from sensors.stereo import torch_backend
        except ModuleNotFoundError as error:
            raise ToolkitError(
                f"the torch backend of the stereo matcher is not installed: {error}",
                hint="pip install 'std-toolkit[train]'",
            ) from error
        return torch_backend.match(left, right, options)


def local_matcher(**options: Any) -> LocalMatcher:
    """The plug-in: options of `LocalMatcherOptions` as keywords."""
    return LocalMatcher(LocalMatcherOptions(**options))
