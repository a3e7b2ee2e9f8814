"""The figures of a result file on a BOP data set."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from benchmark.metrics.bop.dataset import BopDataset, BopImage, BopModel, BopTarget
from benchmark.metrics.bop.projection import mspd
from benchmark.metrics.bop.recall import BopScores, PoseErrors, average_recalls
from benchmark.metrics.bop.results import BopEstimate
from benchmark.metrics.bop.visible_surface import TAUS, see, vsd
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.pose_error import mssd
from std_toolkit.rendering.choose import get_renderer
from std_toolkit.rendering.protocol import Renderer


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

    >>> from benchmark.metrics.bop.dataset import open_bop
    >>> score_bop(open_bop("lmo"), read_bop_results("mine_lmo-test.csv")).ar  # doctest: +SKIP
    0.71
    """
    draw = get_renderer(renderer)
    by_target: dict[tuple[int, int, int], list[BopEstimate]] = defaultdict(list)
    times: dict[tuple[int, int], float] = {}
    for e in estimates:
        if e.scene_id not in dataset.scenes:
            known = ", ".join(str(s) for s in sorted(dataset.scenes)[:5])
            raise ToolkitError(
                "results of a scene that the data set lacks",
                field="scene_id",
                value=e.scene_id,
                hint=f"there are scenes {known}",
            )
        by_target[e.scene_id, e.im_id, e.obj_id].append(e)
        times[e.scene_id, e.im_id] = e.seconds
    model = lru_cache(maxsize=None)(dataset.model)
    image = lru_cache(maxsize=1)(dataset.image)
    errors = []
    for target in sorted(dataset.targets, key=lambda t: (t.scene_id, t.im_id, t.obj_id)):
        mine = by_target[target.scene_id, target.im_id, target.obj_id]
        mine = sorted(mine, key=lambda e: -e.score)[: target.inst_count]
        picture = image(target.scene_id, target.im_id)
        errors.append(_errors(dataset, target, mine, model(target.obj_id), picture, draw))
    known_times = bool(times) and min(times.values()) >= 0
    seconds = float(np.mean(list(times.values()))) if known_times else None
    return average_recalls(errors, seconds_per_image=seconds)


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
