"""Objects of an image by their pixels: what segmentation networks answer, pose methods ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import Instance
from benchmark.metrics.resize import resize_nearest
from benchmark.pose_methods.protocol import PoseView
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, eq=False)
class Segmented:
    """N objects of an image.

    Attributes:
        class_ids: (N,) int64, 1 bottle to 7 aeroplane.
        scores: (N,) float64 confidences in [0, 1].
        masks: (N, h, w) bool pixels of each; they may overlap.

    Raises:
        ToolkitError: arrays that do not belong together.
    """

    class_ids: NDArray[np.int64]
    scores: NDArray[np.float64]
    masks: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n = len(self.class_ids)
        if self.scores.shape != (n,) or self.masks.ndim != 3 or len(self.masks) != n:
            raise ToolkitError(
                f"classes, scores and masks of {n} objects do not belong together",
                value=(self.class_ids.shape, self.scores.shape, self.masks.shape),
            )

    def __len__(self) -> int:
        return len(self.class_ids)

    def resized(self, size: tuple[int, int]) -> Segmented:
        """The same at (width, height), by the nearest pixel."""
        if self.masks.shape[:0:-1] == size:
            return self
        masks = [resize_nearest(mask, size) for mask in self.masks]
        return Segmented(self.class_ids, self.scores, _stacked(masks, size[::-1]))


class Segmenter(Protocol):
    """Finds objects. The networks of `nocs` and `swindrnet-nocs` do; so can any other.

    Attributes:
        input_size: (width, height) that it works at, or None for any.
    """

    input_size: tuple[int, int] | None

    def segment(self, views: Sequence[PoseView]) -> list[Segmented]:
        """The objects of each of a batch of views, at the view's size, best first."""
        ...


def true_segments(mask: NDArray[np.uint8], instances: Sequence[Instance]) -> Segmented:
    """The objects of a frame's own mask, those of no class (0) left out; scores are 1.

    Args:
        mask: (h, w) instance ids.
        instances: the objects of `mask`.
    """
    there = [i for i in instances if i.class_id > 0 and (mask == i.mask_id).any()]
    return Segmented(
        np.array([i.class_id for i in there], np.int64),
        np.ones(len(there)),
        _stacked([mask == i.mask_id for i in there], mask.shape),
    )


def _stacked(masks: Sequence[NDArray[np.bool_]], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.stack(masks) if masks else np.zeros((0, *shape), bool)
