"""A video of a restored recording: colour, raw and restored depth side by side."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.evaluation.depth_panels import DepthScale, range_of, restored_strip
from benchmark.restoring.outputs import FramePaths
from benchmark.restoring.recordings import FrameFiles
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.images import read_depth

VIDEO = "video.mp4"
# Frames whose depth sets the range of the colours, which must not change from frame to frame.
_SAMPLED = 9


def write_video(
    out: Path, done: Sequence[tuple[FrameFiles, FramePaths, float]], fps: float
) -> Path:
    """Write `video.mp4` of restored frames.

    Args:
        out: folder of the recording's results.
        done: frames with the paths and the unit of their results, in order.
        fps: frames per second.

    Raises:
        ToolkitError: an image cannot be read, or OpenCV cannot write MP4.
    """
    path = out / VIDEO
    samples = [_restored(*done[i][1:]) for i in _spread(len(done))]
    scale = range_of(np.concatenate([depth[depth > 0] for depth in samples]))
    with atomic_path(path) as temporary:
        _encode(temporary, done, fps, scale)
    return path


def _encode(
    path: Path,
    done: Sequence[tuple[FrameFiles, FramePaths, float]],
    fps: float,
    scale: DepthScale,
) -> None:
    writer = None
    size = (0, 0)
    for frame, paths, unit in done:
        color, raw = frame.read()
        strip = restored_strip(color, raw, _restored(paths, unit), scale=scale)
        # Encoders halve colour, so that both sides must be even.
        picture = strip[: strip.shape[0] // 2 * 2, : strip.shape[1] // 2 * 2]
        if writer is None:
            size = (picture.shape[1], picture.shape[0])
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, size)
            if not writer.isOpened():
                raise ToolkitError(
                    "OpenCV cannot write MP4 here", path=path, hint="leave out --video"
                )
        if (picture.shape[1], picture.shape[0]) != size:
            picture = np.asarray(cv2.resize(picture, size), np.uint8)
        writer.write(np.ascontiguousarray(picture[..., ::-1]))
    if writer is not None:
        writer.release()


def _restored(paths: FramePaths, unit: float) -> NDArray[np.float32]:
    return read_depth(paths.depth, scale=unit)


def _spread(count: int) -> list[int]:
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, _SAMPLED))})
