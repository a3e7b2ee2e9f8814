"""Where environment maps come from: a folder of the user's, or made procedurally."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from sensors.lighting.environment import EnvironmentMap
from sensors.lighting.folder import EnvironmentFolder, Split
from sensors.lighting.studio import studio_map

STUDIOS = 100
"""Number of different procedural maps; the last quarter of them is for testing."""
TRAIN_STUDIOS = 76


@runtime_checkable
class EnvironmentSource(Protocol):
    """Something to draw environment maps from."""

    def draw(self, rng: np.random.Generator) -> EnvironmentMap:
        """A map at random; the same state of `rng` gives the same map."""
        ...


class StudioSource:
    """Procedural maps; training and testing have different ones.

    Args:
        split: which of them to draw from.
    """

    def __init__(self, *, split: Split = "train") -> None:
        numbers = {
            "train": range(TRAIN_STUDIOS),
            "test": range(TRAIN_STUDIOS, STUDIOS),
            "all": range(STUDIOS),
        }
        self.seeds = numbers[split]

    def draw(self, rng: np.random.Generator) -> EnvironmentMap:
        """See `EnvironmentSource.draw`."""
        return _kept(self.seeds[int(rng.integers(len(self.seeds)))])


@lru_cache(maxsize=8)
def _kept(seed: int) -> EnvironmentMap:
    return studio_map(seed)


def environment_source(
    folder: Path | str | None = None, *, split: Split = "train"
) -> EnvironmentSource:
    """The folder's maps, or procedural ones where no folder is given.

    Raises:
        ToolkitError: see `EnvironmentFolder`.
    """
    return StudioSource(split=split) if folder is None else EnvironmentFolder(folder, split=split)
