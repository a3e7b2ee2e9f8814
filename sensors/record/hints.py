"""What to do better while recording, told from single images and from one to the next."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np

from sensors.record.frames import CapturedFrame, Image8
from sensors.record.view_change import ViewChange

# Images are looked at in this width: a few milliseconds each.
WIDTH = 320
_BLACK, _WHITE = 8, 250
_CLIPPED = 0.10
# Sharpness below this share of the running median is blur.
_BLURRED = 0.5
_REMEMBERED = 60
# Motion during the exposure, in pixels of the full image, that costs features.
_SMEAR_PX = 2.0
_LITTLE_DEPTH = 0.5


@dataclass(frozen=True)
class Hints:
    """Measures of one frame.

    Attributes:
        black, white: share of pixels that are underexposed, and saturated in any channel.
        sharpness: variance of the Laplacian, over the median of the last frames.
        smear_px: motion during the exposure, pixels of the full image; None if either is unknown.
        depth: share of depth pixels that hold a measurement; None without depth.
        views: different views so far; see `ViewChange`.
        overlap: share of the present view that was in the last one that counted.
        broken: places where the images lost touch with those before.
    """

    black: float
    white: float
    sharpness: float
    smear_px: float | None
    depth: float
    views: int
    overlap: float
    broken: int
    advice: list[str] = field(default_factory=list)

    def line(self) -> str:
        """One line for the terminal."""
        parts = [
            f"dark {self.black:.0%} bright {self.white:.0%}",
            f"sharp {self.sharpness:.2f}",
            f"depth {self.depth:.0%}",
            f"views {self.views}",
        ]
        return "  ".join(parts) + (f"  << {'; '.join(self.advice)}" if self.advice else "")


class HintMaker:
    """Looks at frames as they come, not necessarily at all of them."""

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self._sharpness: deque[float] = deque(maxlen=_REMEMBERED)
        self._views = ViewChange()
        self._last_time: float | None = None

    def look(self, frame: CapturedFrame) -> Hints:
        """Measures of a frame, and advice where one of them is bad."""
        small = shrunk(frame.color)
        grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
        black, white = exposure_shares(small)
        ratio = self._sharpness_ratio(sharpness(np.asarray(grey, dtype=np.uint8)))
        change = self._views.look(np.asarray(grey, dtype=np.uint8))
        smear = self._smear(frame, change.shift_px * frame.color.shape[1] / WIDTH)
        depth = float(np.count_nonzero(frame.depth[::4, ::4])) / frame.depth[::4, ::4].size
        advice = []
        if white > _CLIPPED:
            advice.append("too bright: shorten the exposure")
        if black > _CLIPPED and black > white:
            advice.append("too dark: more light or a longer exposure")
        if ratio < _BLURRED or (smear is not None and smear > _SMEAR_PX):
            advice.append("blurred: move slower")
        if change.lost:
            advice.append("lost touch: go back and move slower")
        if depth < _LITTLE_DEPTH:
            advice.append("little depth: too near, too far or too dark")
        return Hints(
            black=black,
            white=white,
            sharpness=ratio,
            smear_px=smear,
            depth=depth,
            views=change.views,
            overlap=change.overlap,
            broken=change.broken,
            advice=advice,
        )

    def _sharpness_ratio(self, value: float) -> float:
        self._sharpness.append(value)
        middle = float(np.median(self._sharpness))
        return value / middle if middle > 0 else 1.0

    def _smear(self, frame: CapturedFrame, shift_px: float) -> float | None:
        before, self._last_time = self._last_time, frame.timestamp
        if before is None or frame.exposure_s is None or not 0 < frame.timestamp - before < 1:
            return None
        return shift_px * frame.exposure_s / (frame.timestamp - before)


def shrunk(image: Image8) -> Image8:
    """The image at `WIDTH`; areas are averaged."""
    height = max(1, round(image.shape[0] * WIDTH / image.shape[1]))
    return np.asarray(cv2.resize(image, (WIDTH, height), interpolation=cv2.INTER_AREA), np.uint8)


def exposure_shares(image: Image8) -> tuple[float, float]:
    """Shares of pixels with all channels near 0, and with any channel near 255."""
    black = (image.max(axis=2) <= _BLACK).mean()
    white = (image.max(axis=2) >= _WHITE).mean()
    return float(black), float(white)


def sharpness(grey: Image8) -> float:
    """Variance of the Laplacian, of an 8-bit image."""
    return float(np.var(cv2.Laplacian(grey, cv2.CV_32F)))
