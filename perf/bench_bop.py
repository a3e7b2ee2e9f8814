"""Scoring of BOP's LM-O against a loop of the published formulas: `python perf/bench_bop.py`.

The loop takes all vertices of a model, and one symmetry transform after the other, as the field's
evaluation does. Its errors must equal ours. Processor time is reliable on a busy machine.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmark.metrics.bop import BopScorer, open_bop, read_bop_results
from std_toolkit.geometry import SE3

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(REPOSITORY / "tests" / "benchmark" / "metrics" / "bop"))

from lmo_set import RESULTS, write_lmo  # noqa: E402


def loop(points, symmetries, K, estimate: SE3, truth: SE3) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """MSSD and MSPD of one pair of poses."""

    def placed(R, t):  # type: ignore[no-untyped-def]
        return points @ R.T + t

    def projected(R, t):  # type: ignore[no-untyped-def]
        seen = K @ placed(R, t).T
        return (seen / seen[2])[:2].T

    spaces, pixels = [], []
    here, image = placed(estimate.R, estimate.t), projected(estimate.R, estimate.t)
    for S in symmetries:
        R, t = truth.R @ S.R, truth.R @ S.t + truth.t
        spaces.append(np.linalg.norm(here - placed(R, t), axis=1).max())
        pixels.append(np.linalg.norm(image - projected(R, t), axis=1).max())
    return min(spaces), min(pixels)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=REPOSITORY.parent / "shared/data/lmo_poses")
    source = parser.parse_args().data
    with tempfile.TemporaryDirectory() as folder:
        root = write_lmo(source, Path(folder) / "lmo")
        start = time.process_time()
        dataset, estimates = open_bop(root), read_bop_results(source / RESULTS)
        scorer = BopScorer(dataset, estimates, errors=("mssd", "mspd"))
        opened = time.process_time()
        models = {o: dataset.model(o) for o in {t.obj_id for t in dataset.targets}}
        scorer._model = models.__getitem__  # type: ignore[assignment]
        loaded = time.process_time()
        found = {}
        for image in scorer.images:
            picture = scorer.image(*image)
            for obj_id in scorer.objects(*image):
                found[*image, obj_id] = scorer.errors(*image, obj_id, picture).target
        scored = time.process_time()
        camera = dataset.image(2, 3).camera
        assert camera is not None
        for e in estimates:
            distances = models[e.obj_id].distances
            symmetries = distances.symmetry.transforms(315)
            (truth, *_), _ = dataset.truths(e.scene_id, e.im_id, e.obj_id)
            wanted = loop(distances.vertices.T, symmetries, camera.K, e.T_cam_obj, truth)
            errors = found[e.scene_id, e.im_id, e.obj_id]
            np.testing.assert_allclose([errors.mssd[0, 0], errors.mspd[0, 0]], wanted, atol=1e-9)
        looped = time.process_time()
    print(f"documents and results {opened - start:.2f} s, models {loaded - opened:.2f} s")
    print(f"errors of {len(estimates)} estimates {scored - loaded:.2f} s")
    ratio = (looped - scored) / (scored - loaded)
    print(f"the loop {looped - scored:.2f} s, {ratio:.1f} times as long")


if __name__ == "__main__":
    main()
