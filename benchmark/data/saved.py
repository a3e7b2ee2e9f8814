"""A split whose raw depth is replaced by depth that a method restored and somebody saved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmark.data.frame import DepthFrame
from benchmark.data.source import DepthSource, FrameKey, SceneFiles
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import read_exr_channel

# Data sets by the beginning of their splits' names, and what they call raw depth.
_SUFFIXES = {
    "dreds": "_simDepthImage.exr",
    "std": "_depth_415.exr",
    "cleargrasp": "-transparent-depth-img.exr",
}
_OTHERS = "_depth.exr"


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
