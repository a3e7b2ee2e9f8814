"""Average recall of instance-level poses, as the BOP Challenge ranks methods."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.pose.matching import greedy
from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]

# Of VSD; of diameters for MSSD; of the image's width times 100 / 640 pixels for MSPD.
THETAS = np.linspace(0.05, 0.5, 10)

MSPD_PIXELS = np.linspace(5.0, 50.0, 10)

MSPD_WIDTH = 640.0


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of the estimates of one object in one image, against all its true poses there.

    An error that was not asked for, or cannot be had, is None.

    Attributes:
        scene_id, obj_id: where.
        vsd: (E, G, T) by estimate (the most confident first), true pose and tolerance.
        mssd: (E, G) metres.
        mspd: (E, G) pixels.
        valid: (G,) true poses that are to be found; the others are as if they were not there.
        diameter_m: of the object.
        width: of the image, pixels.
    """

    scene_id: int
    obj_id: int
    vsd: Floats | None
    mssd: Floats | None
    mspd: Floats | None
    valid: NDArray[np.bool_]
    diameter_m: float
    width: int


@dataclass(frozen=True)
class BopScores:
    """Average recalls in [0, 1].

    Attributes:
        vsd, mssd, mspd: by error, over its thresholds (and tolerances); NaN if not scored.
        targets: true poses that were to be found.
        seconds_per_image: mean over images; None where a time is missing.
    """

    vsd: float
    mssd: float
    mspd: float
    targets: int
    seconds_per_image: float | None = None

    @property
    def ar(self) -> float:
        """Mean of the three; NaN if one is missing."""
        return (self.vsd + self.mssd + self.mspd) / 3


def average_recalls(
    errors: Sequence[PoseErrors], *, seconds_per_image: float | None = None
) -> BopScores:
    """Average recalls over images.

    Under each threshold the estimates of an object in an image go, the most confident first, to the
    true pose with the least error that is left, if that is below the threshold.

    Args:
        errors: of each object and image where there is something to find.
        seconds_per_image: kept in the result.

    Returns:
        The recalls.

    Raises:
        ToolkitError: nothing to find.

    >>> one = np.full((1, 1), 0.012)
    >>> valid = np.array([True])
    >>> found = PoseErrors(1, 1, np.zeros((1, 1, 10)), one, one * 0, valid, 0.1, 640)
    >>> scores = average_recalls([found])  # 0.12 of the diameter: right from 0.15 on
    >>> scores.vsd, scores.mssd, scores.mspd
    (1.0, 0.8, 1.0)
    """
    found = [found_of(e) for e in errors]
    targets = [int(e.valid.sum()) for e in errors]
    return mean_recalls(found, targets, seconds_per_image=seconds_per_image)


def found_of(errors: PoseErrors) -> Floats:
    """Mean number of true poses found over the thresholds of each error.

    Args:
        errors: of one object in one image.

    Returns:
        (3,) by VSD, MSSD and MSPD; NaN if not scored.

    >>> one, valid = np.full((1, 1), 0.012), np.array([True])
    >>> found_of(PoseErrors(1, 1, np.zeros((1, 1, 10)), one, one * 0, valid, 0.1, 640)).tolist()
    [1.0, 0.8, 1.0]
    """
    pairs = (
        # (1, T, E, G) against (10, 1, 1, 1)
        (None if errors.vsd is None else np.moveaxis(errors.vsd, 2, 0)[None], THETAS),
        (_two_more(errors.mssd), THETAS * errors.diameter_m),
        (_two_more(errors.mspd), MSPD_PIXELS * errors.width / MSPD_WIDTH),
    )
    return np.array([_right(error, thresholds, errors.valid) for error, thresholds in pairs])


def _two_more(error: Floats | None) -> Floats | None:
    return None if error is None else error[None, None]


def mean_recalls(
    found: Iterable[Floats], targets: Sequence[int], *, seconds_per_image: float | None = None
) -> BopScores:
    """Average recalls over images.

    Args:
        found: of each object and image, as `found_of` gives it.
        targets: how many true poses there were to be found.
        seconds_per_image: kept in the result.

    Returns:
        The recalls.

    Raises:
        ToolkitError: nothing to find.

    >>> mean_recalls([np.array([1.0, 0.5, 1.0])], [2]).mssd
    0.25
    """
    if not sum(targets):
        raise ToolkitError("there is no true pose to be found")
    sums = np.zeros(3)
    for each in found:  # one after the other: numpy would sum in another order
        sums += each
    vsd_ar, mssd_ar, mspd_ar = (sums / sum(targets)).tolist()
    return BopScores(vsd_ar, mssd_ar, mspd_ar, sum(targets), seconds_per_image)


def _right(error: Floats | None, thresholds: Floats, valid: NDArray[np.bool_]) -> float:
    """Mean number of valid true poses found, over thresholds and tolerances."""
    if error is None:
        return float("nan")
    within = (error < thresholds.reshape(-1, 1, 1, 1)) & valid
    shape = (-1, *error.shape[2:])
    if 0 in error.shape:
        return 0.0
    gain = np.broadcast_to(-error, within.shape).reshape(shape)
    matched = greedy(gain, within.reshape(shape))
    return float((matched >= 0).sum(axis=1).mean())
