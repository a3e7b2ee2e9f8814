"""Splits of data sets: frames by number, the registry of names, saved restored depth.

A split of a data set: frames by number, read when asked for.

A split whose raw depth is replaced by depth that a method restored and somebody saved.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from benchmark.data.frame import DepthFrame
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import read_exr_channel
from std_toolkit.plugins import Registry

# Data sets by the beginning of their splits' names, and what they call raw depth.
_SUFFIXES = {
    "dreds": "_simDepthImage.exr",
    "std": "_depth_415.exr",
    "cleargrasp": "-transparent-depth-img.exr",
}

_OTHERS = "_depth.exr"


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


@dataclass(frozen=True)
class Published:
    """How many frames someone says that a split has.

    Attributes:
        source: who says so.
        scenes: how many scenes, where that is said.
        of_more: what is counted together, where it is more than the split.
    """

    source: str
    frames: int
    scenes: int | None = None
    of_more: str = ""


@dataclass(frozen=True)
class Split:
    """A named part of a data set.

    Attributes:
        name: as on the command line.
        about: what it is, in a line.
        layout: where its files are expected, for a user who has none yet.
        open: makes the source of a root folder; it may search below it.
        page: address of the data set's page.
        download: addresses of the files.
        published: frame counts of papers and pages. They need not agree.
    """

    name: str
    about: str
    layout: str
    open: Callable[[Path], DepthSource]
    page: str = ""
    download: tuple[str, ...] = ()
    published: tuple[Published, ...] = ()


_MODULE = "benchmark.data.known_splits"

splits: Registry[Split] = Registry(
    "std_toolkit.splits",
    {
        "dreds-catknown-train": f"{_MODULE}:DREDS_CATKNOWN_TRAIN",
        "dreds-catknown-val": f"{_MODULE}:DREDS_CATKNOWN_VAL",
        "dreds-catknown-test": f"{_MODULE}:DREDS_CATKNOWN_TEST",
        "dreds-catnovel": f"{_MODULE}:DREDS_CATNOVEL",
        "std-catknown": f"{_MODULE}:STD_CATKNOWN",
        "std-catnovel": f"{_MODULE}:STD_CATNOVEL",
        "cleargrasp-real-known": f"{_MODULE}:CLEARGRASP_REAL_KNOWN",
        "cleargrasp-real-novel": f"{_MODULE}:CLEARGRASP_REAL_NOVEL",
        "cleargrasp-synthetic": f"{_MODULE}:CLEARGRASP_SYNTHETIC",
        "scenes": f"{_MODULE}:SCENES",
        "std-export": f"{_MODULE}:STD_EXPORT",
    },
)


def get_split(name: str) -> Split:
    """A split by its name, or by `package.module:SPLIT`.

    Raises:
        ToolkitError: no such split; the known ones are named.
    """
    split = splits.get(name)
    if not isinstance(split, Split):
        raise ToolkitError("is no benchmark.data.splits.Split", field="split", value=name)
    return split


def open_split(name: str, root: Path | str) -> DepthSource:
    """The frames of a split below a folder; see `Place` for how tolerant the search is.

    Raises:
        ToolkitError: no such split, no such folder, or nothing of the split below it.
    """
    split = get_split(name)
    root = Path(root)
    if not root.is_dir():
        raise ToolkitError("no such folder", path=root, hint=where_to_get(split))
    return split.open(root)


def where_to_get(split: Split) -> str:
    """What to do about a split that is not there."""
    text = f"{split.name} is expected as {split.layout}"
    return f"{text}; download: {split.page}" if split.page else text


def saved_depth_path(folder: Path, split: str, key: FrameKey) -> Path:
    """Where the restored depth of a frame lies: FOLDER/SCENE/NAME and the data set's suffix."""
    suffix = _SUFFIXES.get(split.partition("-")[0], _OTHERS)
    return folder / key.scene / f"{key.name}{suffix}"


@dataclass(frozen=True)
class WithSavedDepth:
    """See `DepthSource`: the frames of `source` with the depth of `folder` for the sensor's.

    Raises:
        ToolkitError: there is no such folder.
    """

    source: DepthSource
    folder: Path

    def __post_init__(self) -> None:
        if not self.folder.is_dir():
            raise ToolkitError("no such folder of saved depth", path=self.folder)

    @property
    def name(self) -> str:
        return self.source.name

    def __len__(self) -> int:
        return len(self.source)

    def keys(self) -> list[FrameKey]:
        return self.source.keys()

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:
        """See `DepthSource`."""
        frame = self.source.load(index, sensor=sensor, nocs=nocs)
        path = saved_depth_path(self.folder, self.name, FrameKey(frame.scene, frame.name))
        depth = read_exr_channel(path).astype(np.float32)
        depth[~(np.isfinite(depth) & (depth > 0))] = 0
        return replace(frame, depth_raw=depth)

    def files(self) -> Iterator[SceneFiles]:
        """See `DepthSource`."""
        return self.source.files()
