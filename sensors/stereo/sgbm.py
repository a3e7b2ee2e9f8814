"""OpenCV's semi-global matcher: smooth, hence less like a depth camera on glass and metal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from sensors.stereo.matcher import Disparity, Image, check_pair
from std_toolkit.errors import ToolkitError


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
