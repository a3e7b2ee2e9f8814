"""Whether depth lies beside the colour image: steps of depth against edges of colour.

`std-curate check` measures this shift at the outlines of labelled objects. A recording to restore
has no labels: here all steps of depth of a few frames are laid over the edges of colour, and the
shift is taken at which they agree best.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.methods.depth.filling.filler import fill_nearest
from std_toolkit.arrays import Array, Floats
from std_toolkit.geometry.depth_maps import on_depth_step
from std_toolkit.settings import Settings, limit

_WIDTH = 320  # at which images are compared: steps of depth are some pixels wide anyway
_BORDER = 8  # px, where a shifted image has nothing

_TRIED = "three captures of a D415, five of a D435, shifted by 8 to 25 px and as recorded"


@dataclass(frozen=True, kw_only=True)
class AlignmentSettings(Settings):
    """When depth is said to lie beside colour."""

    reach: int = limit(24, unit="px of 320", source="a baseline of 50 mm at 0.5 m")
    """largest shift that is looked for"""
    beside: float = limit(3.0, unit="px of 320", source=_TRIED)
    """shifts up to this are the width of the steps of a depth camera"""
    clear: float = limit(0.4, source=_TRIED)
    """agreement at the best shift, in standard deviations of the edges of colour"""
    better: float = limit(1.15, source=_TRIED)
    """by how much that must exceed the agreement without a shift"""
    fewest: int = limit(800, source="outlines of three objects in a frame")
    """pixels on steps of depth, of all frames together"""


@dataclass(frozen=True)
class Beside:
    """A shift of depth against colour: positive if depth lies to the right and below, pixels."""

    x_px: float
    y_px: float


def depth_beside_color(
    frames: Iterable[tuple[NDArray[np.uint8], Floats]],
) -> Beside | None:
    """The shift of depth against colour that frames of one camera share.

    Args:
        frames: (H, W, 3) RGB and (H, W) metres, 0 where nothing was measured.

    Returns:
        None if there is no such shift, or if too few steps of depth tell.
    """
    limits = AlignmentSettings.current()
    total: Array | None = None
    count, width = 0.0, _WIDTH
    for color, depth in frames:
        found = _agreement(color, depth, limits.reach)
        if found is not None:
            total = found[0] if total is None else total + found[0]
            count, width = count + found[1], color.shape[1]
    if total is None or count < limits.fewest:
        return None
    mean, middle = total / count, limits.reach
    near = int(limits.beside)
    here = float(mean[middle - near : middle + near + 1, middle - near : middle + near + 1].max())
    row, column = np.unravel_index(int(mean.argmax()), mean.shape)
    x, y = middle - int(column), middle - int(row)
    best = float(mean.max())
    if max(abs(x), abs(y)) <= near or best < limits.clear or best < limits.better * here:
        return None
    return Beside(x * width / _WIDTH, y * width / _WIDTH)


def _agreement(color: NDArray[np.uint8], depth: Floats, reach: int) -> tuple[Array, float] | None:
    """Sums of the edges of colour under the steps of depth, moved by up to `reach` either way, and
    the number of these steps."""
    size = (_WIDTH, max(1, round(color.shape[0] * _WIDTH / color.shape[1])))
    small = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)
    if min(size) <= 2 * max(_BORDER, reach) or not (small > 0).any():
        return None
    filled = np.asarray(fill_nearest(small, small == 0), np.float32)
    whole = np.asarray(cv2.medianBlur(filled, 5), np.float32)
    steps = on_depth_step(whole)
    # The near side is where the object ends.
    steps &= whole <= 1.01 * cv2.erode(whole, np.ones((3, 3), np.uint8))
    inner = np.zeros_like(steps)
    inner[_BORDER:-_BORDER, _BORDER:-_BORDER] = True
    steps &= inner
    if not steps.any():
        return None
    grey = cv2.cvtColor(cv2.resize(color, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    grey = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1.0)
    edges = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    edges = np.minimum(edges, np.percentile(edges, 95))  # one bright line is no many edges
    spread = float(edges.std())
    if spread < 1e-6:
        return None
    edges = (edges - edges.mean()) / spread
    # A pixel moved out of the image agrees with nothing: 0 is the mean.
    padded = [side + 2 * reach for side in steps.shape]
    product = np.conj(np.fft.rfft2(steps, padded)) * np.fft.rfft2(edges, padded)
    sums = np.fft.irfft2(product, padded)
    at = np.arange(-reach, reach + 1)
    return np.asarray(sums[np.ix_(at, at)]), float(steps.sum())
