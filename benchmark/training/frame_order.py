"""Training and validation frames by scene, and the order of training frames.

The frames of a scene are either all for training or all for validation.
"""

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from torch.utils.data import Sampler

from benchmark.training.packed_frames import PackedFrames
from std_toolkit.errors import ToolkitError

_NAMED = 3


class BatchOrder:
    """Batches of an endless row of epochs, each of which has every frame at most once.

    What is left at the end of an epoch and fills no batch is left out of that epoch.

    Args:
        frames: how many there are.
        batch: frames of a step.
        seed: another one, another order.

    Raises:
        ToolkitError: fewer frames than a batch takes.

    >>> order = BatchOrder(4, 2, seed=0)
    >>> sorted(int(i) for i in [*order.batch_of(0), *order.batch_of(1)])
    [0, 1, 2, 3]
    """

    def __init__(self, frames: int, batch: int, *, seed: int) -> None:
        if frames < batch:
            raise ToolkitError(
                f"too little data: {frames} frames do not fill a batch of {batch}",
                hint="pack more frames, or make --batch-size smaller",
            )
        self.frames, self.batch, self.seed = frames, batch, seed
        self._epoch, self._permutation = -1, np.empty(0, np.intp)

    @property
    def steps_per_epoch(self) -> int:
        return self.frames // self.batch

    def batch_of(self, step: int) -> NDArray[np.intp]:
        """Frames of a step, counted from 0."""
        epoch, place = divmod(step, self.steps_per_epoch)
        if epoch != self._epoch:
            rng = np.random.default_rng([self.seed, epoch])
            self._permutation, self._epoch = rng.permutation(self.frames), epoch
        return self._permutation[place * self.batch : (place + 1) * self.batch]


class Steps(Sampler[list[int]]):
    """The frames that one process reads, from the step where training stands for `steps` steps.

    Args:
        order: of all frames.
        begin: tells the step where training stands; asked whenever reading begins.
        steps: how many steps to read for, up to `end`.
        end: the step at which training ends.
        accumulate: parts of a step that go through the network one after the other.
        rank, world: number of this process, and of how many.

    Raises:
        ToolkitError: a batch cannot be parted so.
    """

    def __init__(
        self,
        order: BatchOrder,
        begin: Callable[[], int],
        *,
        steps: int,
        end: int,
        accumulate: int = 1,
        rank: int = 0,
        world: int = 1,
    ) -> None:
        if order.batch % (accumulate * world):
            raise ToolkitError(
                f"must be a multiple of {accumulate} x {world}, accumulated parts x processes",
                field="batch_size",
                value=order.batch,
            )
        self.order, self.begin, self.steps, self.end = order, begin, steps, end
        self.accumulate, self.rank, self.world = accumulate, rank, world

    def __len__(self) -> int:
        return self.steps * self.accumulate

    def __iter__(self) -> Iterator[list[int]]:
        begin = self.begin()
        parts = self.accumulate * self.world
        for step in range(begin, min(begin + self.steps, self.end)):
            frames = self.order.batch_of(step)
            for part in range(self.accumulate):
                yield frames[part * self.world + self.rank :: parts].tolist()


def hold_out(frames: PackedFrames, share: float, *, seed: int) -> tuple[list[int], list[int]]:
    """Frames to train on, and those of a share of the scenes, at least one, to judge by.

    Raises:
        ToolkitError: there is only one scene, or the share is none.
    """
    if not 0 < share < 1:
        raise ToolkitError("must be between 0 and 1", field="hold_out", value=share)
    scenes = _drawn(frames, range(len(frames)), f"{seed}")
    if len(scenes) < 2:
        raise ToolkitError(
            f"too little data: {len(scenes)} scene, of which none can be held out for validation",
            hint="pack more scenes, or give --validation",
        )
    held = set(scenes[: math.ceil(share * (len(scenes) - 1))])
    sides: tuple[list[int], list[int]] = ([], [])
    for i in range(len(frames)):
        sides[frames.scene(i) in held].append(i)
    return sides


def thinned(frames: PackedFrames, chosen: list[int], share: float, *, seed: int) -> list[int]:
    """Those of the chosen frames that are of a share of their scenes, at least of one.

    Of a smaller share come some of the scenes of a larger one.

    Raises:
        ToolkitError: the share is none.
    """
    if not 0 < share <= 1:
        raise ToolkitError("must lie above 0 and at most 1", field="share", value=share)
    if share == 1:
        return chosen
    scenes = _drawn(frames, chosen, f"share {seed}")
    kept = set(scenes[: max(1, round(share * len(scenes)))])
    return [i for i in chosen if frames.scene(i) in kept]


def check_no_leak(
    training: PackedFrames,
    of_training: Sequence[int],
    validation: PackedFrames,
    of_validation: Sequence[int],
) -> None:
    """Refuse scenes, and frames of equal pixels, that are on both sides.

    Raises:
        ToolkitError: which they are (the first few), and how many.
    """
    for what, of in (("scenes", _scene), ("frames", _digest)):
        known = {of(training, i): i for i in of_training}
        both = [i for i in of_validation if of(validation, i) in known]
        if both:
            listed = ", ".join(
                f"{validation.key(i)} = {training.key(known[of(validation, i)])}"
                for i in both[:_NAMED]
            )
            raise ToolkitError(
                f"{len(both)} frames of validation are of {what} that are trained on: {listed}",
                hint="validate on other scenes, or leave --validation away to hold some out",
            )


def frames_digest(frames: PackedFrames, chosen: Sequence[int]) -> str:
    """A hash over frames, in their order."""
    text = "\n".join(_digest(frames, i) for i in chosen)
    return hashlib.sha256(text.encode()).hexdigest()


def _drawn(frames: PackedFrames, chosen: Sequence[int], salt: str) -> list[str]:
    """Scenes of the chosen frames in an order drawn at random."""

    def draw(scene: str) -> str:
        # Of the scene's own name: a scene more changes no other's place by much.
        name = scene.rpartition(": ")[2]
        return hashlib.sha256(f"{salt} {name}".encode()).hexdigest()

    return sorted(sorted({frames.scene(i) for i in chosen}), key=draw)


def _scene(frames: PackedFrames, index: int) -> str:
    return frames.scene(index)  # of whatever kind the packs are


def _digest(frames: PackedFrames, index: int) -> str:
    return frames.frames[index].digest
