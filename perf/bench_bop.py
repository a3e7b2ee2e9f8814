"""Scoring of BOP's LM-O against a loop of the published formulas: `python perf/bench_bop.py`.

A round model follows, whose turns the loop samples 315 times. The loop takes all vertices of a
model, and one symmetry transform after the other, as the field's evaluation does. Its errors must
equal ours on LM-O. Processor time is reliable on a busy machine.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh

from benchmark.metrics.bop import (
    BopScorer,
    ModelDistances,
    open_bop,
    pinhole,
    read_bop_results,
)
from std_toolkit.geometry import SE3, Camera, Symmetry, so3_exp
from std_toolkit.geometry.mesh import hull_vertices

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


def round_model() -> None:
    """Print the time of a pair of poses of a fine cylinder."""
    mesh = trimesh.creation.cylinder(0.04, 0.12, sections=2000).subdivide()
    vertices = np.asarray(mesh.vertices)
    symmetry = Symmetry(continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),))
    camera, rng = Camera(640, 480, 572, 573, 325, 242), np.random.default_rng(0)
    pairs = []
    for _ in range(20):
        truth = SE3(so3_exp(rng.normal(0, 1, 3)), np.array([0.02, 0.01, 0.7]))
        off = SE3(truth.R @ so3_exp(rng.normal(0, 0.1, 3)), truth.t + rng.normal(0, 0.005, 3))
        pairs.append((off, truth))
    start = time.process_time()
    for pair in pairs[:3]:
        loop(vertices, symmetry.transforms(315), camera.K, *pair)
    looped = (time.process_time() - start) / 3
    for steps in (None, 315):
        model = ModelDistances(vertices, hull_vertices(mesh), symmetry, steps)
        start = time.process_time()
        for off, truth in pairs:
            model.mssd([off], [truth]), model.mspd([off], [truth], pinhole(camera))
        each = (time.process_time() - start) / len(pairs)
        name = "exact turn" if steps is None else f"{steps} turns"
        print(f"{name}: {1000 * each:.1f} ms a pair, the loop {looped / each:.1f} times as long")


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
        camera = dataset.image(2, 3).camera
        assert camera is not None
        models[1].distances.mspd([SE3.identity()], [SE3.identity()], pinhole(camera))  # compiles
        loaded = time.process_time()
        found = {}
        for image in scorer.images:
            picture = scorer.image(*image)
            for obj_id in scorer.objects(*image):
                found[*image, obj_id] = scorer.errors(*image, obj_id, picture).target
        scored = time.process_time()
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
    round_model()


if __name__ == "__main__":
    main()
