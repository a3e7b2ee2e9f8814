"""A small split on disk and methods with known behaviour, for tests of running."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from benchmark.data import provenance
from benchmark.data.splits import Published, get_split
from benchmark.evaluation.tasks.depth import Run
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from tests.dreds_on_disk import write_std_scene

SPLIT = "std-catknown"


def write_split(root: Path, scenes: int = 3, frames: int = 4) -> Path:
    """STD scenes "scene_0", ... below `root`."""
    for i in range(scenes):
        write_std_scene(root / "STD-CatKnown" / f"test_{i}", frames=frames, seed=i)
    return root


@contextmanager
def published_as(frames: int, scenes: int, name: str = SPLIT) -> Iterator[None]:
    """Let so many frames and scenes of a split be those that were published."""
    split = get_split(name)
    small = replace(split, published=(Published("paper", frames, scenes),))
    with patch.object(provenance, "get_split", lambda _: small):
        yield


def a_run(root: Path, out: Path, method: str = "nearest", **changes: object) -> Run:
    run = Run(
        split=SPLIT,
        root=root,
        method=method,
        options=MethodOptions(),
        protocol="strict",
        label=method.partition(":")[2] or method,
        out=out,
        batch_size=2,
        speed=False,
    )
    return replace(run, **changes)  # type: ignore[arg-type]


class Filling:
    """Answers 0.7 m everywhere."""

    input_size: tuple[int, int] | None = None
    needs_mask = False

    def __init__(self, options: MethodOptions) -> None:
        self.settings = options.settings

    def restore(self, views: Sequence[View]) -> list[Restored]:
        return [Restored(np.full(view.depth.shape, 0.7, np.float32)) for view in views]


class Trusting(Filling):
    """Trusts the sensor in the left half."""

    def restore(self, views: Sequence[View]) -> list[Restored]:
        trust = [np.zeros(view.depth.shape, np.float32) for view in views]
        for half in trust:
            half[:, : half.shape[1] // 2] = 1
        return [Restored(r.depth, t) for r, t in zip(super().restore(views), trust, strict=True)]


class HalfNaN(Filling):
    """Answers in the upper half only."""

    def restore(self, views: Sequence[View]) -> list[Restored]:
        answers = super().restore(views)
        for answer in answers:
            answer.depth[answer.depth.shape[0] // 2 :] = np.nan
        return answers


class AllNaN(Filling):
    """Answers with no number at all, as a network whose weights overflowed."""

    def restore(self, views: Sequence[View]) -> list[Restored]:
        return [Restored(np.full(v.depth.shape, np.nan, np.float32)) for v in views]


class FailsAtBright(Filling):
    """Fails at any batch that holds a view whose sensor depth begins with a certain value."""

    def restore(self, views: Sequence[View]) -> list[Restored]:
        wanted = float(self.settings["depth"])
        if any(abs(float(view.depth.max()) - wanted) < 1e-6 for view in views):
            raise ValueError("cannot stand this frame")
        return super().restore(views)


class DiesOnce(Filling):
    """Kills its process at the third batch, the first time that it gets there."""

    calls = 0

    def restore(self, views: Sequence[View]) -> list[Restored]:
        type(self).calls += 1
        mark = Path(self.settings["mark"])
        if type(self).calls == 3 and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().restore(views)


class Counting(Filling):
    """Leaves a line in a file for every view that it is given."""

    def restore(self, views: Sequence[View]) -> list[Restored]:
        with Path(self.settings["log"]).open("a") as log:
            log.writelines("view\n" for _ in views)
        return super().restore(views)


class WrongSize(Filling):
    """Answers at another size than it was asked."""

    def restore(self, views: Sequence[View]) -> list[Restored]:
        return [Restored(np.ones((3, 3), np.float32)) for _ in views]


class Swelling(Filling):
    """Fills every hole 5 cm too near, and paints the brightness of the colour onto the rest."""

    def restore(self, views: Sequence[View]) -> list[Restored]:
        answers = []
        for view in views:
            measured = view.depth > 0
            near = view.depth[measured].mean() - 0.05 if measured.any() else 0.5
            shade = 1e-3 * view.color.astype(np.float32).mean(axis=2)
            depth = np.where(measured, view.depth + shade, near).astype(np.float32)
            answers.append(Restored(depth, spread=np.full_like(depth, 3)))
        return answers


class Small(Filling):
    """Works at 32x18, trusts nothing and answers 0.7 m."""

    input_size = (32, 18)


class Failing(Filling):
    """Fails at every frame."""

    def restore(self, views: Sequence[View]) -> list[Restored]:
        raise ValueError(f"cannot stand {len(views)} frames")
