"""Which frames go into which step: a function of the seed and the step's number alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from torch.utils.data import Sampler

from std_toolkit.errors import ToolkitError


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
    >>> sorted([*order.batch_of(0), *order.batch_of(1)])
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
