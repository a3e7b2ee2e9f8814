"""A split of a data set: frames by number, read when asked for."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from typing import NamedTuple, Protocol

from benchmark.data.frame import DepthFrame


class FrameKey(NamedTuple):
    """Which frame it is; `str(key)` is `DepthFrame.key`, unique within a split."""

    scene: str
    name: str

    def __str__(self) -> str:
        return f"{self.scene}/{self.name}"


class SceneFiles(NamedTuple):
    """What was found of a scene on disk.

    Attributes:
        scene: its name.
        folder: where it is.
        frames: how many frames it has.
        missing: file names that a frame needs and that are not there, by what they hold, such as
            "raw depth".
    """

    scene: str
    folder: str
    frames: int
    missing: dict[str, list[str]]


class DepthSource(Protocol):
    """Frames of a split. Sources can be pickled, so that worker processes can have them.

    They know their frames from the beginning and hold no image: memory does not grow with the
    number of frames that were read.
    """

    @property
    def name(self) -> str:
        """Of the split."""
        ...

    def __len__(self) -> int: ...

    def keys(self) -> list[FrameKey]:
        """Of all frames, in their order."""
        ...

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:
        """Read a frame.

        Args:
            index: from 0.
            sensor: also colour and raw depth. Without them `color` is (0, 0, 3) and `depth_raw`
                (0, 0): all that scoring of depth restored earlier needs takes a third of the time.
            nocs: also the NOCS map, where the data set has one.

        Raises:
            ToolkitError: a file is missing, damaged or contradicts another.
            IndexError: no such frame.
        """
        ...

    def files(self) -> Iterator[SceneFiles]:
        """What is there of every scene, for `check_split`."""
        ...


def names_digest(keys: Iterable[FrameKey]) -> str:
    """SHA-256 over the frames' names, in their order."""
    return hashlib.sha256("\n".join(map(str, keys)).encode()).hexdigest()


def iterate(
    source: DepthSource, *, start: int = 0, stop: int | None = None
) -> Iterator[DepthFrame]:
    """The frames one after the other; only one is held at a time."""
    for index in range(start, len(source) if stop is None else min(stop, len(source))):
        yield source.load(index)
