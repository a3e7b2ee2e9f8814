"""A small DREDS split whose poses can be told exactly, and pose methods with known behaviour."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmark.evaluation.depth_choice import DepthChoice
from benchmark.evaluation.tasks.pose import PoseRun
from benchmark.methods.pose.ground_truth import GroundTruthNOCS
from benchmark.methods.protocol import Estimated, PoseView, Restored, View
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.pose import PosePrediction
from std_toolkit.jobs import JobOptions
from tests.dreds_on_disk import BALLS, TABLE_M, write_dreds_scene, write_equal

SPLIT = "dreds-catknown-test"
SERIAL = JobOptions(engine="serial", progress=False)
SIZE = (96, 54)


def write_pose_split(root: Path, scenes: int = 2, frames: int = 2, *, cad: bool = True) -> Path:
    """Scenes "1", "2", ... below `root`.

    Raw depth is that of the table where the ball is of glass, in a noisy way: most of its points
    lie on the table behind it.
    """
    for i in range(scenes):
        folder = root / "DREDS-CatKnown" / "test" / str(i + 1)
        drawn = write_dreds_scene(folder, frames=frames, label_size=SIZE, color_size=SIZE, seed=i)
        for j, frame in enumerate(drawn):
            rng = np.random.default_rng([i, j])
            through = (frame.mask == 1) & (rng.random(frame.mask.shape) < 0.9)
            raw = np.where(through, TABLE_M + rng.normal(0, 0.01, through.shape), frame.raw)
            write_equal(folder / f"{j:04d}_simDepthImage.exr", raw.astype(np.float32))
    if cad:
        for ball in BALLS:
            path = root / "cad_model" / "syn_test" / ball.category / ball.model / "bbox.txt"
            path.parent.mkdir(parents=True)
            path.write_text("0.5 0.5 0.5\n-0.5 -0.5 -0.5\n")
    return root


def a_pose_run(
    root: Path, out: Path, depth: str | DepthChoice = "raw", **changes: object
) -> PoseRun:
    run = PoseRun(
        split=SPLIT,
        root=root,
        method="gt-nocs",
        options=MethodOptions(),
        depth=DepthChoice(name=depth) if isinstance(depth, str) else depth,
        label="gt-nocs",
        out=out,
        batch_size=2,
    )
    return replace(run, **changes)  # type: ignore[arg-type]


class Finding:
    """Finds a bottle of 30 cm, 60 cm away, in every view."""

    input_size: tuple[int, int] | None = (40, 30)
    needs_truth = False

    def __init__(self, options: MethodOptions) -> None:
        self.settings = options.settings

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        RT = np.diag([0.3, 0.3, 0.3, 1.0])
        RT[2, 3] = 0.6
        size = np.full(3, 1 / np.sqrt(3))
        one = PosePrediction([1], RT[None], size[None], [0.5])  # type: ignore[arg-type]
        return [Estimated(one) for _ in views]


class Looking(Finding):
    """Leaves a line in a file: the mean of the depth that it looks at, and of that it fits to."""

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        with Path(self.settings["log"]).open("a") as log:
            log.writelines(f"{v.sensor.mean():.4f} {v.depth.mean():.4f}\n" for v in views)
        return super().estimate(views)


class FailsAtSome(GroundTruthNOCS):
    """Fails at any batch with a view whose colour begins with an even number."""

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        if any(view.color[0, 0, 0] % 2 == 0 for view in views):
            raise ValueError("cannot stand this frame")
        return super().estimate(views)


class DiesOnce(Finding):
    """Kills its process at the second batch, the first time that it gets there."""

    calls = 0

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        type(self).calls += 1
        mark = Path(self.settings["mark"])
        if type(self).calls == 2 and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().estimate(views)


class Small:
    """Says what the sensor says, at a smaller size, and trusts it."""

    input_size: tuple[int, int] | None = (32, 18)
    needs_mask = False

    def __init__(self, options: MethodOptions) -> None: ...

    def restore(self, views: Sequence[View]) -> list[Restored]:
        return [Restored(v.depth, np.ones(v.depth.shape, np.float32)) for v in views]
