"""Mean average precision of 6D detection, as the BOP Challenges 2024 and 2025 rank methods.

Source: T. Hodan et al., "BOP Challenge 2024", and bop_toolkit's evaluation. All instances in an
image are to be found, and nobody says how many there are.

- An estimate is right if its error to a true pose of its object is below a threshold. The most
  confident estimate chooses first, the true pose with the least error.
- True poses of which less than a tenth is visible need not be found; estimates that are matched to
  them do not count.
- The precision is interpolated at 101 recalls, as in COCO, and averaged over thresholds and over
  objects that are visible in the images.
- Estimates of objects without any true pose in the image do not count.

The challenge of 2024 ranks by the mean of MSSD and MSPD, that of 2025 by MSSD alone: within shares
of the diameter, or within 2 to 20 mm.
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.bop.bop_recall import MSPD_PIXELS, MSPD_WIDTH, THETAS
from benchmark.metrics.pose.matching import greedy
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.bop_metadata import TARGET_VISIBLE

Floats = NDArray[np.float64]

RECALLS = np.linspace(0.0, 1.0, 101)

# Of MSSD, as bop_toolkit has them since 2025.
MSSD_MM = np.arange(2.0, 21.0, 2.0)
_MM = 1000.0

_WRONG, _RIGHT, _IGNORED = 0, 1, 2


def most_estimates(data: str) -> int:
    """Number of estimates of an image that count, the most confident ones.

    Args:
        data: BOP's short name of the data set.

    Returns:
        The number.

    >>> most_estimates("lmo"), most_estimates("xyzibd")
    (100, 200)
    """
    return 200 if data == "xyzibd" else 100


@dataclass(frozen=True, eq=False)
class Detections:
    """Estimates of one object in one image, against all its true poses there.

    Attributes:
        scores: (E,) confidences, falling.
        mssd: (E, G) metres; None if not scored.
        mspd: (E, G) pixels; None if not scored.
        visible: (G,) visible shares of the true poses.
        diameter_m: of the object.
        width: of the image, pixels.
    """

    scores: Floats
    mssd: Floats | None
    mspd: Floats | None
    visible: Floats
    diameter_m: float
    width: int

    def outcomes(self) -> NDArray[np.int8]:
        """(3, 10, E) wrong 0, right 1 or ignored 2, by error (MSSD, MSPD, MSSD in mm) and
        threshold."""
        shape = len(self.scores), len(self.visible)
        found = np.zeros((3, len(THETAS), shape[0]), dtype=np.int8)
        if 0 in shape:
            return found
        scaled = (
            (self.mssd, THETAS * self.diameter_m),
            (self.mspd, MSPD_PIXELS * self.width / MSPD_WIDTH),
            (None if self.mssd is None else _MM * self.mssd, MSSD_MM),
        )
        for kind, (errors, thresholds) in enumerate(scaled):
            if errors is None:
                continue
            within = errors < thresholds[:, None, None]
            matched = greedy(np.broadcast_to(-errors, within.shape), within)
            kinds = np.where(self.visible >= TARGET_VISIBLE, _RIGHT, _IGNORED)
            found[kind] = np.where(matched >= 0, kinds[matched], _WRONG)
        return found


@dataclass(frozen=True)
class DetectionScores:
    """Mean average precisions in [0, 1]; NaN if the error was not scored.

    Attributes:
        mssd, mspd, mssd_mm: by error, over thresholds and objects; the last over 2 to 20 mm.
        objects: the three by object.
        instances: true poses that were to be found, by object.
    """

    mssd: float
    mspd: float
    mssd_mm: float
    objects: dict[int, tuple[float, float, float]]
    instances: dict[int, int]

    @property
    def map(self) -> float:
        """Mean of MSSD and MSPD: the figure of 2024."""
        return (self.mssd + self.mspd) / 2


@dataclass(frozen=True, eq=False)
class _Ranked:
    """All estimates of an object, the most confident first.

    Attributes:
        image: (N,) of the estimates.
        outcomes: (U, N) the different ones.
        which: (3, 10) of them, by error and threshold.
        truths: (I,) number of true poses that are to be found, by image.
    """

    image: NDArray[np.int64]
    outcomes: NDArray[np.int8]
    which: NDArray[np.int64]
    truths: Floats

    def precision(self, weights: Floats) -> Floats | None:
        """(3,) average precisions, with each image as many times as it weighs; None without truth.

        Args:
            weights: (I,) of the images.
        """
        total = float(self.truths @ weights)
        if not total:
            return None
        each = weights[self.image]
        right = np.cumsum((self.outcomes == _RIGHT) * each, axis=-1)
        wrong = np.cumsum((self.outcomes == _WRONG) * each, axis=-1)
        recall = right / total
        precision = right / np.maximum(right + wrong, 1e-300)
        # At least this recall, at best this precision.
        best = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        best = np.concatenate([best, np.zeros((len(best), 1))], axis=1)
        found = [b[np.searchsorted(r, RECALLS)].mean() for r, b in zip(recall, best, strict=True)]
        return np.asarray(np.array(found)[self.which].mean(axis=1))


def detection_scores(rows: Iterable[tuple[int, int, Detections]]) -> DetectionScores:
    """Average precisions over images.

    Args:
        rows: image (any number), object and its estimates, in the order of the images, which
            decides among equal confidences.

    Returns:
        The scores.

    Raises:
        ToolkitError: nothing to find.

    >>> good, bad = np.full((1, 1), 0.001), np.full((1, 1), 0.2)
    >>> one = Detections(np.array([0.9]), good, good, np.array([1.0]), 0.1, 640)
    >>> other = Detections(np.array([0.5]), bad, bad * 1000, np.array([1.0]), 0.1, 640)
    >>> round(detection_scores([(0, 1, one), (1, 1, other)]).mssd, 3)  # one of two found
    0.505
    """
    rows = list(rows)
    images = sorted({image for image, *_ in rows})
    ranked = _rank(rows, images)
    found = {k: r.precision(np.ones(len(images))) for k, r in ranked.items()}
    known = {k: v for k, v in found.items() if v is not None}
    if not known:
        raise ToolkitError("there is no true pose to be found")
    scored = [
        any(getattr(d, name) is not None for *_, d in rows) for name in ("mssd", "mspd", "mssd")
    ]
    off = np.where(scored, 0.0, np.nan)
    mean = np.mean(list(known.values()), axis=0) + off
    return DetectionScores(
        float(mean[0]),
        float(mean[1]),
        float(mean[2]),
        {k: (x[0], x[1], x[2]) for k, v in sorted(known.items()) if (x := (v + off).tolist())},
        {k: int(ranked[k].truths.sum()) for k in sorted(known)},
    )


def detection_intervals(
    rows: Iterable[tuple[int, int, Detections]],
    *,
    samples: int = 500,
    seed: int = 0,
    level: float = 0.95,
) -> Floats:
    """Ends of the interval of the mean average precisions, from drawing images with replacement.

    Args:
        rows: as in `detection_scores`; the first number may also be that of the scene.
        samples: number of draws.
        seed: of the draws.
        level: share of the draws within the interval.

    Returns:
        (2, 4) low and high ends of MSSD, MSPD, MSSD in mm, and the mean of the first two; NaN with
        fewer than two images.

    >>> good = np.full((1, 1), 0.001)
    >>> one = Detections(np.array([0.9]), good, good, np.array([1.0]), 0.1, 640)
    >>> detection_intervals([(0, 1, one), (1, 1, one)]).tolist()
    [[1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]]
    """
    rows = list(rows)
    images = sorted({image for image, *_ in rows})
    if len(images) < 2:
        return np.full((2, 4), np.nan)
    ranked = _rank(rows, images)
    rng = np.random.default_rng(seed)
    drawn = []
    for _ in range(samples):
        chosen = rng.integers(0, len(images), len(images))
        weights = np.bincount(chosen, minlength=len(images)).astype(np.float64)
        found = [p for r in ranked.values() if (p := r.precision(weights)) is not None]
        if found:
            mean = np.mean(found, axis=0)
            drawn.append([*mean, mean[:2].mean()])
    ends = np.array([(1 - level) / 2, (1 + level) / 2])
    return np.asarray(np.quantile(np.array(drawn), ends, axis=0))


def _rank(given: list[tuple[int, int, Detections]], images: list[int]) -> dict[int, _Ranked]:
    place = {image: i for i, image in enumerate(images)}
    by_object: dict[int, list[tuple[int, Detections]]] = defaultdict(list)
    for image, obj_id, detections in given:
        by_object[obj_id].append((place[image], detections))
    ranked = {}
    for obj_id, each in sorted(by_object.items()):
        scores = np.concatenate([d.scores for _, d in each])
        places = np.concatenate([np.full(len(d.scores), i) for i, d in each]).astype(np.int64)
        outcomes = np.concatenate([d.outcomes() for _, d in each], axis=2)
        order = np.argsort(-scores, kind="stable")
        truths = np.zeros(len(images))
        for i, d in each:
            truths[i] += int((d.visible >= TARGET_VISIBLE).sum())
        kinds, thresholds, _ = outcomes.shape
        rows = outcomes[..., order].reshape(kinds * thresholds, -1 if len(order) else 0)
        different, which = np.unique(rows, axis=0, return_inverse=True)
        which = which.reshape(kinds, thresholds)
        ranked[obj_id] = _Ranked(places[order], different, which, truths)
    return ranked
