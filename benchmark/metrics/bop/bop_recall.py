"""Average recall of instance-level poses, as the BOP Challenge ranks methods."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.bop.bop_dataset import BopDataset, BopImage, BopModel, BopTarget
from benchmark.metrics.bop.bop_errors import TAUS, mspd, see, vsd
from benchmark.metrics.bop.bop_file import BopEstimate
from benchmark.metrics.pose.matching import greedy
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.symmetry import mssd
from std_toolkit.rendering.choose import get_renderer
from std_toolkit.rendering.renderer import Renderer

Floats = NDArray[np.float64]

# Of VSD; of diameters for MSSD; of the image's width times 100 / 640 pixels for MSPD.
THETAS = np.linspace(0.05, 0.5, 10)

MSPD_PIXELS = np.linspace(5.0, 50.0, 10)

MSPD_WIDTH = 640.0


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of the estimates of one object in one image, against all its true poses there.

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
    vsd: Floats
    mssd: Floats
    mspd: Floats
    valid: NDArray[np.bool_]
    diameter_m: float
    width: int


@dataclass(frozen=True)
class BopScores:
    """Average recalls in [0, 1].

    Attributes:
        vsd, mssd, mspd: by error, over its thresholds (and tolerances).
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
        """Mean of the three."""
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
        (3,) by VSD, MSSD and MSPD.

    >>> one, valid = np.full((1, 1), 0.012), np.array([True])
    >>> found_of(PoseErrors(1, 1, np.zeros((1, 1, 10)), one, one * 0, valid, 0.1, 640)).tolist()
    [1.0, 0.8, 1.0]
    """
    vsd = np.moveaxis(errors.vsd, 2, 0)[None]  # (1, T, E, G) against (10, 1, 1, 1)
    pairs = (
        (vsd, THETAS),
        (errors.mssd[None, None], THETAS * errors.diameter_m),
        (errors.mspd[None, None], MSPD_PIXELS * errors.width / MSPD_WIDTH),
    )
    return np.array([_right(error, thresholds, errors.valid) for error, thresholds in pairs])


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


def _right(error: Floats, thresholds: Floats, valid: NDArray[np.bool_]) -> float:
    """Mean number of valid true poses found, over thresholds and tolerances."""
    within = (error < thresholds.reshape(-1, 1, 1, 1)) & valid
    shape = (-1, *error.shape[2:])
    if 0 in error.shape:
        return 0.0
    gain = np.broadcast_to(-error, within.shape).reshape(shape)
    matched = greedy(gain, within.reshape(shape))
    return float((matched >= 0).sum(axis=1).mean())


def score_bop(
    dataset: BopDataset, estimates: Sequence[BopEstimate], *, renderer: str = "raycast"
) -> BopScores:
    """Average recalls of VSD, MSSD and MSPD, and their mean.

    Of each target, as many estimates count as there are instances to be found, the most confident
    ones; estimates of what is no target do not.

    Args:
        dataset: true poses, models and depth.
        estimates: of a result file.
        renderer: draws the models for VSD.

    Returns:
        The recalls.

    Raises:
        ToolkitError: an estimate of a scene that is not there, or damaged data.

    >>> from benchmark.metrics.bop.bop_dataset import open_bop
    >>> score_bop(open_bop("lmo"), read_bop_results("mine_lmo-test.csv")).ar  # doctest: +SKIP
    0.71
    """
    scorer = BopScorer(dataset, estimates, renderer=renderer)
    image = lru_cache(maxsize=1)(dataset.image)
    errors = [scorer.errors(t, image(t.scene_id, t.im_id)) for t in scorer.targets]
    return average_recalls(errors, seconds_per_image=seconds_per_image(estimates))


def seconds_per_image(estimates: Iterable[BopEstimate]) -> float | None:
    """Mean time of an image.

    Args:
        estimates: of a result file; the time of an image is in each of its rows, -1 if unknown.

    Returns:
        Seconds, or None where a time is missing.

    >>> seconds_per_image([]) is None
    True
    """
    times = {(e.scene_id, e.im_id): e.seconds for e in estimates}
    return float(np.mean(list(times.values()))) if times and min(times.values()) >= 0 else None


class BopScorer:
    """Errors of a result file, target by target.

    Attributes:
        targets: of the data set, by scene, image and object.

    Raises:
        ToolkitError: an estimate of a scene that is not there.
    """

    def __init__(
        self, dataset: BopDataset, estimates: Iterable[BopEstimate], *, renderer: str = "raycast"
    ) -> None:
        self.targets = sorted(dataset.targets, key=lambda t: (t.scene_id, t.im_id, t.obj_id))
        self._dataset = dataset
        self._renderer = get_renderer(renderer)
        self._model = lru_cache(maxsize=None)(dataset.model)
        self._estimates: dict[tuple[int, int, int], list[BopEstimate]] = defaultdict(list)
        for e in estimates:
            if e.scene_id not in dataset.scenes:
                known = ", ".join(str(s) for s in sorted(dataset.scenes)[:5])
                raise ToolkitError(
                    "results of a scene that the data set lacks",
                    field="scene_id",
                    value=e.scene_id,
                    hint=f"there are scenes {known}",
                )
            self._estimates[e.scene_id, e.im_id, e.obj_id].append(e)

    def errors(self, target: BopTarget, image: BopImage) -> PoseErrors:
        """Errors of the estimates that count for a target.

        Raises:
            ToolkitError: a damaged model, or fewer true poses than the target says.
        """
        mine = self._estimates[target.scene_id, target.im_id, target.obj_id]
        mine = sorted(mine, key=lambda e: -e.score)[: target.inst_count]
        model = self._model(target.obj_id)
        return _errors(self._dataset, target, mine, model, image, self._renderer)


def _errors(
    dataset: BopDataset,
    target: BopTarget,
    estimates: Sequence[BopEstimate],
    model: BopModel,
    image: BopImage,
    renderer: Renderer,
) -> PoseErrors:
    truths, valid = dataset.truths(target)
    camera = image.camera
    shape = (len(estimates), len(truths))
    surfaces, spaces, pixels = np.zeros((*shape, len(TAUS))), np.zeros(shape), np.zeros(shape)
    poses = [e.T_cam_obj for e in estimates]
    # Without an estimate there is nothing to compare true poses with.
    true_seen = [
        see(renderer, camera, model.mesh, T, image.depth) for T in (truths if poses else [])
    ]
    for i, pose in enumerate(poses):
        seen = see(renderer, camera, model.mesh, pose, image.depth)
        for j, truth in enumerate(truths):
            surfaces[i, j] = vsd(seen, true_seen[j], model.diameter_m)
            spaces[i, j] = mssd(pose, truth, model.hull, model.symmetry)
            pixels[i, j] = mspd(pose, truth, model.vertices, camera, model.symmetry)
    return PoseErrors(
        target.scene_id,
        target.obj_id,
        surfaces,
        spaces,
        pixels,
        valid,
        model.diameter_m,
        camera.width,
    )
