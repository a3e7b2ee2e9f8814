"""Restored depth kept on disk, for pose and grasping, and to be scored again."""

from __future__ import annotations

from pathlib import Path

from benchmark.data.saved import saved_depth_path
from benchmark.data.source import FrameKey
from benchmark.methods.protocol import Restored
from std_toolkit.io.exr import write_exr


def save_depth(folder: Path, split: str, key: FrameKey, restored: Restored) -> None:
    """Write restored depth as the data set keeps the sensor's: FOLDER/depth/SCENE/NAME + suffix.

    It has the size that the method answered at, three equal channels of float32 metres as the
    public data sets have them, and 0 where there is no answer.

    Raises:
        ToolkitError: the file cannot be written.
    """
    depth = restored.depth
    channel = depth.astype("float32")
    channel[~(channel > 0) | (channel == float("inf"))] = 0.0
    path = saved_depth_path(folder / "depth", split, key)
    write_exr(path, dict.fromkeys("RGB", channel))
