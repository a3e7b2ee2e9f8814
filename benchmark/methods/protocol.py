"""What a depth restorer is to the benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera


@dataclass(frozen=True)
class View:
    """What a restorer may see of a frame; colour and depth have the camera's size.

    Attributes:
        color: (h, w, 3) uint8 RGB.
        depth: (h, w) float32 metres, 0 where the sensor measured nothing.
        camera: intrinsics at this size (fx and fy differ where the aspect is squeezed).
        mask: (h, w) bool pixels that a method with `needs_mask` may doubt, such as those of
            transparent objects; None otherwise.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    camera: Camera
    mask: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Restored:
    """What a restorer makes of a view.

    Attributes:
        depth: (h, w) float32 metres at the size of the view. What is not finite or not positive
            counts as no answer.
        confidence: (h, w) float32 in [0, 1], trust in the sensor's depth, of methods that have it.
    """

    depth: NDArray[np.float32]
    confidence: NDArray[np.float32] | None = None


class Restorer(Protocol):
    """A method that makes depth whole.

    Attributes:
        input_size: (width, height) that it works at, or None for any: it is then given the size
            of the ground truth (of the protocol, where that has one).
        needs_mask: whether it must be told which pixels to doubt.
    """

    input_size: tuple[int, int] | None
    needs_mask: bool

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """Restore a batch; the answers in the order of the views, each of its view's size."""
        ...
