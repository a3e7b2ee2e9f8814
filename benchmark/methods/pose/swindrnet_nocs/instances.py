"""Objects of an image from the classes of its pixels."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmark.methods.pose.segmented import Segmented
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import (
    BACKGROUND_CLASS,
    SwinNOCSConfig,
)
from std_toolkit.errors import ToolkitError

_OTHER = 0  # objects of no class


def segments_of(
    chances: NDArray[np.float32],
    config: SwinNOCSConfig,
    middles: NDArray[np.float32] | None = None,
) -> Segmented:
    """The objects of an image, best first; a score is the mean chance of the object's pixels.

    Args:
        chances: (9, h, w) of each class at each pixel.
        config: what counts as an object.
        middles: (2, h, w) how far the middle of each pixel's object is away, x and y in pixels.

    Raises:
        ToolkitError: objects are told apart by middles, and there are none.
    """
    if config.instances == "middle":
        if middles is None:
            raise ToolkitError(
                "the network does not say where the middles of objects are",
                field="instances",
                value="middle",
                hint="choose class or piece, or --set trunk=swindrnet",
            )
        found = _by_middles(chances, middles, config)
    else:
        found = _by_classes(chances, config)
    return found.of(np.argsort(-found.scores, kind="stable"))


def _by_classes(chances: NDArray[np.float32], config: SwinNOCSConfig) -> Segmented:
    """What has one class is an object, or each piece of it."""
    best = chances.argmax(axis=0)
    classes: list[int] = []
    masks: list[NDArray[np.bool_]] = []
    for class_id in range(1, BACKGROUND_CLASS):
        pieces = _pieces(best == class_id, config.instances)
        some = [mask for mask in pieces if mask.sum() >= config.least_pixels]
        classes += [class_id] * len(some)
        masks += some
    scores = [float(chances[k][mask].mean()) for k, mask in zip(classes, masks, strict=True)]
    return Segmented(
        np.array(classes, np.int64),
        np.array(scores, np.float64),
        np.array(masks, bool).reshape(-1, *best.shape),
    )


def _pieces(mask: NDArray[np.bool_], instances: str) -> list[NDArray[np.bool_]]:
    if instances == "class" or not mask.any():
        return [mask] if mask.any() else []
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    return [labels == number for number in range(1, count)]


def _by_middles(
    chances: NDArray[np.float32], middles: NDArray[np.float32], config: SwinNOCSConfig
) -> Segmented:
    """What points to one middle is an object.

    Its pixels choose the class together: a few that look like another one do not split an object.
    """
    labels = grouped(chances.argmax(axis=0) != BACKGROUND_CLASS, middles, config.apart)
    masks = [labels == number for number in range(labels.max() + 1)]
    masks = [mask for mask in masks if mask.sum() >= config.least_pixels]
    means = np.array([chances[:BACKGROUND_CLASS, mask].mean(axis=1) for mask in masks], float)
    means = means.reshape(-1, BACKGROUND_CLASS)
    means /= means.sum(axis=1, keepdims=True).clip(1e-9)
    known = means[:, _OTHER + 1 :]
    found = Segmented(
        known.argmax(axis=1).astype(np.int64) + 1 if len(known) else np.zeros(0, np.int64),
        known.max(axis=1, initial=0.0),
        np.array(masks, bool).reshape(-1, *labels.shape),
        means,
    )
    return found.of(means[:, _OTHER] < config.other)


def grouped(
    there: NDArray[np.bool_], middles: NDArray[np.float32], apart: float
) -> NDArray[np.int64]:
    """Which object the pixels of objects belong to.

    Every pixel votes for the place it points to. Objects are the places with more votes around them
    than any other within `apart`; a pixel belongs to the one nearest to its vote.

    Args:
        there: (h, w) pixels of objects.
        middles: (2, h, w) x and y from a pixel to the middle of its object, pixels.
        apart: least distance of two middles, pixels.

    Returns:
        (h, w) numbers from 0; -1 where there is no object.
    """
    labels = np.full(there.shape, -1, np.int64)
    rows, columns = np.nonzero(there)
    if not len(rows):
        return labels
    h, w = there.shape
    x = np.clip(columns + middles[0, rows, columns], 0, w - 1)
    y = np.clip(rows + middles[1, rows, columns], 0, h - 1)
    votes = np.zeros((h, w), np.float32)
    np.add.at(votes, (np.rint(y).astype(int), np.rint(x).astype(int)), 1)
    votes = np.asarray(cv2.GaussianBlur(votes, (0, 0), apart / 3), np.float32)
    side = 2 * round(apart) + 1
    around = cv2.dilate(votes, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    peaks = np.argwhere((votes == around) & (votes > 0))
    _, nearest = cKDTree(peaks).query(np.stack([y, x], axis=1))
    labels[rows, columns] = nearest
    return labels
