"""Keyframes: few sharp frames that cover the whole path of the camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

# Motion and sharpness are measured on images of about this width: enough for a median over some
# hundred points, and cheap beside the feature extraction.
SMALL_WIDTH = 400
_CORNERS = 300
_MIN_TRACKED_SHARE = 0.5


@dataclass(frozen=True, kw_only=True)
class FrameMeasure:
    """What the choice of keyframes rests on.

    Attributes:
        sharpness: variance of the Laplacian of the small image.
        motion: image motion since the previous frame, median over tracked corners, as a share of
            the image width; 1 where tracking failed.
    """

    sharpness: float
    motion: float


def measure_frames(paths: Sequence[Path]) -> list[FrameMeasure]:
    """Measure every frame against the one before it.

    Raises:
        ToolkitError: an image that cannot be read.
    """
    measures: list[FrameMeasure] = []
    previous: NDArray[np.uint8] | None = None
    for path in paths:
        image = _small_grey(path)
        sharpness = float(cv2.Laplacian(image, cv2.CV_32F).var())
        moved = 1.0 if previous is None else _motion(previous, image)
        measures.append(FrameMeasure(sharpness=sharpness, motion=moved))
        previous = image
    return measures


def choose_keyframes(measures: Sequence[FrameMeasure], *, motion: float, max_gap: int) -> list[int]:
    """Indices of the keyframes, rising.

    The path is cut where the motion since the last cut adds up to `motion` (or after `max_gap`
    frames). Around every cut the sharpest frame of the second half of its interval is taken:
    late enough for a new viewpoint, and never a blurred frame where a sharp one is near.

    Args:
        measures: one per frame, in recording order.
        motion: accumulated motion between keyframes, share of the image width.
        max_gap: most frames between keyframes.
    """
    if not measures:
        return []
    chosen = [0]
    start, moved = 0, 0.0
    for i in range(1, len(measures)):
        moved += measures[i].motion
        if moved < motion and i - start < max_gap:
            continue
        window = range(start + max(1, (i - start + 1) // 2), i + 1)
        best = max(window, key=lambda k: (measures[k].sharpness, k))
        chosen.append(best)
        moved = sum(m.motion for m in measures[best + 1 : i + 1])
        start = best
    last = len(measures) - 1
    if chosen[-1] != last:
        # The end of the path must be inside the map, else its frames hang on extrapolation.
        chosen.append(last)
    return chosen


def _small_grey(path: Path) -> NDArray[np.uint8]:
    # JPEG decodes at a fraction of the size for a fraction of the time.
    image = cv2.imread(str(path), cv2.IMREAD_REDUCED_GRAYSCALE_2)
    if image is None:
        raise ToolkitError("cannot decode the image", path=path)
    scale = SMALL_WIDTH / image.shape[1]
    if scale < 1:
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(image, dtype=np.uint8)


def _motion(previous: NDArray[np.uint8], image: NDArray[np.uint8]) -> float:
    if previous.shape != image.shape:
        return 1.0
    corners = cv2.goodFeaturesToTrack(previous, _CORNERS, 0.01, 7)
    if corners is None or len(corners) < 20:
        return 1.0
    moved, found, _ = cv2.calcOpticalFlowPyrLK(  # type: ignore[call-overload]
        previous, image, corners, None, winSize=(15, 15), maxLevel=4
    )
    kept = found.ravel() > 0
    if kept.mean() < _MIN_TRACKED_SHARE:
        return 1.0
    flow = np.linalg.norm((moved - corners).reshape(-1, 2)[kept], axis=1)
    return float(np.median(flow) / image.shape[1])
