"""Errors of a result file on a data set, image by image."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.bop.bop_dataset import BopDataset, BopImage, BopTarget
from benchmark.metrics.bop.bop_detection import (
    Detections,
    DetectionScores,
    detection_scores,
    most_estimates,
)
from benchmark.metrics.bop.bop_errors import DELTA_M, TAUS, see, vsd
from benchmark.metrics.bop.bop_file import BopEstimate
from benchmark.metrics.bop.bop_model import BopModel
from benchmark.metrics.bop.bop_recall import BopScores, PoseErrors, average_recalls
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.rendering.choose import get_renderer

Floats = NDArray[np.float64]
BopError = Literal["vsd", "mssd", "mspd"]
BOP_ERRORS: tuple[BopError, ...] = get_args(BopError)


@dataclass(frozen=True, eq=False)
class ObjectErrors:
    """Errors of all estimates of one object in one image.

    Attributes:
        target: of the estimates that count for its target; None if it is none.
        detections: of the estimates that count in detection; None if the image does not.
    """

    target: PoseErrors | None
    detections: Detections | None


class BopScorer:
    """Errors of a result file, image by image.

    Attributes:
        images: scenes and images with something to find, in order.
        errors_wanted: the errors that are computed.

    Raises:
        ToolkitError: an estimate of a scene that is not there.
    """

    def __init__(
        self,
        dataset: BopDataset,
        estimates: Iterable[BopEstimate],
        *,
        renderer: str = "raycast",
        errors: Sequence[BopError] = BOP_ERRORS,
        delta_m: float = DELTA_M,
    ) -> None:
        self.dataset = dataset
        self.errors_wanted = tuple(errors)
        self._renderer = get_renderer(renderer)
        self._delta_m = delta_m
        self._model = lru_cache(maxsize=None)(dataset.model)
        self._targets: dict[tuple[int, int], dict[int, BopTarget]] = defaultdict(dict)
        for target in dataset.targets:
            self._targets[target.scene_id, target.im_id][target.obj_id] = target
        self._detected = set(dataset.images)
        self.images = sorted(self._detected | set(self._targets))
        self._estimates = self._by_object(estimates)

    def _by_object(
        self, estimates: Iterable[BopEstimate]
    ) -> dict[tuple[int, int], dict[int, list[tuple[BopEstimate, bool]]]]:
        """Estimates by image and object, the most confident first, and whether they are among the
        most confident of their image."""
        by_image: dict[tuple[int, int], list[BopEstimate]] = defaultdict(list)
        for e in estimates:
            if (
                e.scene_id not in self.dataset.scenes
                and not self.dataset.folder(e.scene_id).is_dir()
            ):
                known = ", ".join(str(s) for s in sorted(self.dataset.scenes)[:5])
                raise ToolkitError(
                    "results of a scene that the data set lacks",
                    field="scene_id",
                    value=e.scene_id,
                    hint=f"there are scenes {known}",
                )
            by_image[e.scene_id, e.im_id].append(e)
        most = most_estimates(self.dataset.root.resolve().name)
        found: dict[tuple[int, int], dict[int, list[tuple[BopEstimate, bool]]]] = {}
        for image, rows in by_image.items():
            rows.sort(key=lambda e: -e.score)
            by_object: dict[int, list[tuple[BopEstimate, bool]]] = defaultdict(list)
            for rank, e in enumerate(rows):
                by_object[e.obj_id].append((e, rank < most))
            found[image] = by_object
        return found

    def objects(self, scene_id: int, im_id: int) -> list[int]:
        """Numbers of the objects that an image is scored for, in order."""
        shown = self.dataset.objects(scene_id, im_id) if (scene_id, im_id) in self._detected else []
        return sorted({*shown, *self._targets.get((scene_id, im_id), ())})

    def count(self, scene_id: int, im_id: int, obj_id: int) -> int:
        """Number of true poses that are to be found for the average recalls."""
        target = self._targets.get((scene_id, im_id), {}).get(obj_id)
        return 0 if target is None else target.inst_count

    def image(self, scene_id: int, im_id: int) -> BopImage:
        """Camera of an image, and its depth if VSD needs it."""
        with_depth = "vsd" in self.errors_wanted and (scene_id, im_id) in self._targets
        return self.dataset.image(scene_id, im_id, depth=with_depth)

    def errors(self, scene_id: int, im_id: int, obj_id: int, image: BopImage) -> ObjectErrors:
        """Errors of the estimates of an object.

        Raises:
            ToolkitError: a damaged model, or fewer true poses than the target says.
        """
        truths, shares = self.dataset.truths(scene_id, im_id, obj_id)
        target = self._targets.get((scene_id, im_id), {}).get(obj_id)
        mine = self._estimates.get((scene_id, im_id), {}).get(obj_id, [])
        # Both are the most confident ones of the object.
        top = 0 if target is None else min(len(mine), target.inst_count)
        detected = (scene_id, im_id) in self._detected
        dets = sum(among for _, among in mine) if detected else 0
        model = self._model(obj_id)
        poses = [e.T_cam_obj for e, _ in mine[: max(top, dets)]]
        spaces = model.distances.mssd(poses, truths) if "mssd" in self.errors_wanted else None
        pixels = None
        if "mspd" in self.errors_wanted:
            pixels = model.distances.mspd(poses, truths, image.project)
        recall = detection = None
        if target is not None:
            surfaces = self._surfaces(model, poses[:top], truths, image)
            recall = PoseErrors(
                scene_id,
                obj_id,
                surfaces,
                None if spaces is None else spaces[:top],
                None if pixels is None else pixels[:top],
                self.dataset.valid(target, shares),
                model.diameter_m,
                image.size[0],
            )
        if detected:
            detection = Detections(
                np.array([e.score for e, _ in mine[:dets]]),
                None if spaces is None else spaces[:dets],
                None if pixels is None else pixels[:dets],
                np.array(shares),
                model.diameter_m,
                image.size[0],
            )
        return ObjectErrors(recall, detection)

    def _surfaces(
        self, model: BopModel, poses: Sequence[SE3], truths: Sequence[SE3], image: BopImage
    ) -> Floats | None:
        """(E, G, T) VSD; None without depth."""
        depth, camera = image.depth, image.camera
        if "vsd" not in self.errors_wanted or depth is None or camera is None:
            return None
        found = np.zeros((len(poses), len(truths), len(TAUS)))
        # Without an estimate there is nothing to compare true poses with.
        seen = [
            see(self._renderer, camera, model.mesh, T, depth, delta_m=self._delta_m)
            for T in (*poses, *(truths if poses else ()))
        ]
        for i in range(len(poses)):
            for j in range(len(truths)):
                found[i, j] = vsd(seen[i], seen[len(poses) + j], model.diameter_m)
        return found


def score_bop(
    dataset: BopDataset,
    estimates: Sequence[BopEstimate],
    *,
    renderer: str = "raycast",
    errors: Sequence[BopError] = BOP_ERRORS,
) -> BopScores:
    """Average recalls of VSD, MSSD and MSPD, and their mean.

    Of each target, as many estimates count as there are instances to be found, the most confident
    ones; estimates of what is no target do not.

    Args:
        dataset: true poses, models and depth.
        estimates: of a result file.
        renderer: draws the models for VSD.
        errors: that are scored.

    Returns:
        The recalls; that of VSD is NaN without depth.

    Raises:
        ToolkitError: an estimate of a scene that is not there, or damaged data.

    >>> from benchmark.metrics.bop import open_bop, read_bop_results
    >>> score_bop(open_bop("lmo"), read_bop_results("mine_lmo-test.csv")).ar  # doctest: +SKIP
    0.71
    """
    found = [e.target for e in _all_errors(dataset, estimates, renderer, errors)]
    return average_recalls(
        [e for e in found if e is not None], seconds_per_image=seconds_per_image(estimates)
    )


def score_bop_detection(dataset: BopDataset, estimates: Sequence[BopEstimate]) -> DetectionScores:
    """Mean average precision of detection, as the BOP Challenge 2024 defines it.

    Args:
        dataset: true poses and models.
        estimates: of a result file; the 100 most confident ones of each image count.

    Returns:
        The precisions.

    Raises:
        ToolkitError: an estimate of a scene that is not there, or damaged data.

    >>> from benchmark.metrics.bop import open_bop, read_bop_results
    >>> dataset, estimates = open_bop("lmo"), read_bop_results("mine.csv")  # doctest: +SKIP
    >>> score_bop_detection(dataset, estimates).map  # doctest: +SKIP
    0.56
    """
    scorer = BopScorer(dataset, estimates, errors=("mssd", "mspd"))
    rows = []
    for place, (scene_id, im_id) in enumerate(scorer.images):
        image = scorer.image(scene_id, im_id)
        for obj_id in scorer.objects(scene_id, im_id):
            found = scorer.errors(scene_id, im_id, obj_id, image).detections
            if found is not None:
                rows.append((place, obj_id, found))
    return detection_scores(rows)


def _all_errors(
    dataset: BopDataset,
    estimates: Sequence[BopEstimate],
    renderer: str,
    errors: Sequence[BopError],
) -> list[ObjectErrors]:
    scorer = BopScorer(dataset, estimates, renderer=renderer, errors=errors)
    found: list[ObjectErrors] = []
    for scene_id, im_id in scorer.images:
        image = scorer.image(scene_id, im_id)
        objects = scorer.objects(scene_id, im_id)
        found += [scorer.errors(scene_id, im_id, obj_id, image) for obj_id in objects]
    return found


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
