"""Hints for the user while recording, from single images and from consecutive ones.

No camera poses are known while recording; overlap is estimated from images alone. Corners are
tracked from image to image. The overlap is the fraction of the corners of the last counted view
that are still tracked. When it falls below a limit, the current image counts as a new view. Views
are not compared with all earlier ones: a camera that returns to a place counts again.
"""

from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.record.recording_document import CapturedFrame, Image8
from std_toolkit.arrays import Floats, Mask

# Images are analysed at this width: a few milliseconds each.
WIDTH = 320

_BLACK, _WHITE = 8, 250

_CLIPPED = 0.10

# Sharpness below this fraction of the running median is blur.
_BLURRED = 0.5

_REMEMBERED = 60

# Motion during the exposure, in pixels of the full image, that loses features.
_SMEAR_PX = 2.0

_LITTLE_DEPTH = 0.5

Grey = NDArray[np.uint8]

# Structure from motion needs each point in several images: views overlap by about two thirds.
_NEW_VIEW = 0.65

# With fewer corners than this found again in the next image, tracking is lost.
_LOST = 0.25

_CORNERS = 200

_FEWEST = 20

# Forward-backward tracking error above which a corner is a wrong match.
_ROUND_TRIP_PX = 1.0


@dataclass(frozen=True)
class Hints:
    """Measures of one frame.

    Attributes:
        black, white: fraction of pixels that are underexposed, and saturated in any channel.
        sharpness: variance of the Laplacian, relative to the median of the last frames.
        smear_px: motion during the exposure, pixels of the full image; None if either is unknown.
        depth: fraction of depth pixels with a measurement; None without depth.
        views: number of views so far; see `ViewChange`.
        overlap: overlap with the last counted view.
        broken: number of times that tracking was lost.
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
    """Analyses frames as they arrive; frames may be skipped."""

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self._sharpness: deque[float] = deque(maxlen=_REMEMBERED)
        self._views = ViewChange()
        self._last_time: float | None = None

    def look(self, frame: CapturedFrame) -> Hints:
        """Measures of a frame, with advice for the bad ones."""
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
    """The image at `WIDTH`, resampled by area averaging."""
    height = max(1, round(image.shape[0] * WIDTH / image.shape[1]))
    return np.asarray(cv2.resize(image, (WIDTH, height), interpolation=cv2.INTER_AREA), np.uint8)


def exposure_shares(image: Image8) -> tuple[float, float]:
    """Fractions of pixels with all channels near 0, and with any channel near 255."""
    black = (image.max(axis=2) <= _BLACK).mean()
    white = (image.max(axis=2) >= _WHITE).mean()
    return float(black), float(white)


def sharpness(grey: Image8) -> float:
    """Variance of the Laplacian of an 8-bit image."""
    return float(np.var(cv2.Laplacian(grey, cv2.CV_32F)))


@dataclass(frozen=True)
class Change:
    """Result of tracking one image.

    Attributes:
        shift_px: median motion of the corners since the last image, pixels of that image size.
        overlap: fraction of the last counted view that is still visible.
        views: counted so far.
        lost: the overlap with the previous image is too small.
        broken: number of times that happened.
    """

    shift_px: float
    overlap: float
    views: int
    lost: bool
    broken: int


class ViewChange:
    """Tracks corners from image to image; all images have one size."""

    def __init__(self) -> None:
        self._last: Grey | None = None
        self._points = np.zeros((0, 1, 2), dtype=np.float32)
        self._of_view = np.zeros(0, dtype=bool)
        self._view_size = 0
        self._views = 0
        self._broken = 0

    def look(self, grey: Grey) -> Change:
        """Process the next image, (h, w) uint8."""
        last, self._last = self._last, grey
        if last is None or len(self._points) < _FEWEST:
            # Without texture no corner can be tracked: no view is counted and no motion is known.
            self._start(grey)
            return Change(0.0, 1.0, self._views, False, self._broken)
        before = len(self._points)
        moved, kept = _follow(last, grey, self._points)
        steps = np.linalg.norm((moved - self._points)[kept, 0], axis=1)
        shift = float(np.median(steps)) if len(steps) else 0.0
        self._points, self._of_view = moved[kept], self._of_view[kept]
        if kept.sum() < _LOST * before:
            self._broken += 1
            self._start(grey)
            return Change(shift, 0.0, self._views, True, self._broken)
        overlap = float(self._of_view.sum()) / max(1, self._view_size)
        if overlap < _NEW_VIEW:
            self._start(grey)
        elif len(self._points) < 0.8 * _CORNERS:
            self._fill(grey)
        return Change(shift, overlap, self._views, False, self._broken)

    def _start(self, grey: Grey) -> None:
        """Count the image as a view."""
        self._points = _corners(grey, np.zeros((0, 1, 2), dtype=np.float32), _CORNERS)
        self._of_view = np.ones(len(self._points), dtype=bool)
        self._view_size = len(self._points)
        if len(self._points) >= _FEWEST:
            self._views += 1

    def _fill(self, grey: Grey) -> None:
        """Add corners in newly visible regions."""
        fresh = _corners(grey, self._points, _CORNERS - len(self._points))
        self._points = np.concatenate([self._points, fresh])
        self._of_view = np.concatenate([self._of_view, np.zeros(len(fresh), dtype=bool)])


def _corners(grey: Grey, known: Floats, count: int) -> Floats:
    """(N, 1, 2) corners away from the known ones."""
    free = np.full(grey.shape, 255, dtype=np.uint8)
    for x, y in known[:, 0]:
        cv2.circle(free, (round(float(x)), round(float(y))), 8, 0, -1)
    if count <= 0:
        return np.zeros((0, 1, 2), dtype=np.float32)
    found = cv2.goodFeaturesToTrack(grey, count, 0.01, 8, mask=free)
    empty = np.zeros((0, 1, 2), dtype=np.float32)
    return empty if found is None else np.asarray(found, dtype=np.float32)


def _follow(last: Grey, grey: Grey, points: Floats) -> tuple[Floats, Mask]:
    """New positions of the points, and which of them are reliable."""
    there, seen, _ = cv2.calcOpticalFlowPyrLK(last, grey, points, np.empty_like(points))
    back, seen_back, _ = cv2.calcOpticalFlowPyrLK(grey, last, there, np.empty_like(points))
    error = np.linalg.norm((back - points)[:, 0], axis=1)
    inside = ((there[:, 0] >= 0) & (there[:, 0] < [grey.shape[1], grey.shape[0]])).all(axis=1)
    good = (seen[:, 0] > 0) & (seen_back[:, 0] > 0) & (error < _ROUND_TRIP_PX) & inside
    return np.asarray(there, dtype=np.float32), good
