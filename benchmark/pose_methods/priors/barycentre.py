"""The mean shape of sets of points without a network: their barycentre in optimal transport.

Every point of the mean is paired with one point of each shape, such that the squared distances are
least in sum, and moves to the mean of its partners; again, until pairs no longer change. The mean
that decides is that of squared distances, so that thin parts which sit elsewhere in every shape
become blurred, as they do at the mean of embeddings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float32]


def barycentre(shapes: NDArray[np.floating], *, rounds: int = 4) -> Floats:
    """(p, 3) mean of shapes (n, p, 3).

    It begins with the shape that is nearest to all others by the distance of sorted coordinates
    along many directions, a cheap bound of the one that counts.

    Args:
        rounds: at most; it ends earlier where no pair changes.

    Raises:
        ToolkitError: no shape.
    """
    points = np.asarray(shapes, dtype=np.float64)
    if points.ndim != 3 or not len(points):
        raise ToolkitError("needs shapes (n, p, 3)", value=points.shape)
    mean = points[_most_central(points)]
    before: NDArray[np.intp] | None = None
    for _ in range(rounds):
        pairs = np.stack([linear_sum_assignment(cdist(mean, s, "sqeuclidean"))[1] for s in points])
        if before is not None and (pairs == before).all():
            break
        mean = np.take_along_axis(points, pairs[..., None], axis=1).mean(axis=0)
        before = pairs
    return mean.astype(np.float32)


def _most_central(points: NDArray[np.float64], directions: int = 32) -> int:
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(3, directions))
    unit /= np.linalg.norm(unit, axis=0)
    sliced = np.sort(points @ unit, axis=1).reshape(len(points), -1)
    return int(cdist(sliced, sliced, "sqeuclidean").sum(axis=1).argmin())
