"""A video as photos: sharp frames, spread evenly over what the camera saw."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import digest_file, write_document
from std_toolkit.io.images import write_color
from std_toolkit.jobs.artefact import Artefact, Record
from std_toolkit.log import logger
from std_toolkit.poses.features import FrameMeasure, choose_keyframes, measure_image

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm")
# Photos that a video is sampled into, and the smallest number that still helps.
PHOTOS = 60
# Frames that are measured, at most: of a long video every second, third, ... one.
_MEASURED = 1500


def is_video(path: Path) -> bool:
    """Whether a path is a video file by its suffix."""
    return path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()


def sample_video(path: Path, work: Path, *, count: int = PHOTOS) -> Path:
    """Write about `count` frames of a video as PNG files; returns their folder.

    The motion of the image between two frames is about the same everywhere, and each is the
    sharpest around its place. A video that was sampled before is not read again.

    Args:
        path: the video.
        work: receives the folder.
        count: number of frames.

    Raises:
        ToolkitError: the video cannot be read.
    """
    folder = work / "video"
    video = {"video": digest_file(path)}
    artefact = Artefact(folder, "frames of the video", video, {"count": count, "format": 1})
    done = folder / "frames.json"
    if artefact.find(done, Record, logging.INFO) is not None:
        return folder
    step = max(1, -(-_length(path) // _MEASURED))
    measures: list[FrameMeasure] = []
    numbers: list[int] = []
    previous: NDArray[np.uint8] | None = None
    for number, image in _frames(path, step):
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        measure, previous = measure_image(grey, previous)
        measures.append(measure)
        numbers.append(number)
    if len(numbers) < 2:
        raise ToolkitError("the video has no frames that can be read", path=path)
    chosen = {numbers[i] for i in spread(measures, count)}
    folder.mkdir(parents=True, exist_ok=True)
    done.unlink(missing_ok=True)
    for old in folder.glob("*.png"):
        old.unlink()
    for number, image in _frames(path, step):
        if number in chosen:
            rgb = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            write_color(folder / f"{number:06d}.png", np.asarray(rgb, np.uint8))
    write_document(done, artefact.record(folder.glob("*.png")))
    logger.info("%s: %d of %d frames are used", path.name, len(chosen), numbers[-1] + 1)
    return folder


def spread(measures: list[FrameMeasure], count: int) -> list[int]:
    """Indices of about `count` sharp frames at equal motion; all, if there are no more."""
    if len(measures) <= count:
        return list(range(len(measures)))
    # A cut or a lost track counts as much as a large step, not as the whole way.
    usual = float(np.median([m.motion for m in measures[1:]]))
    limited = [
        FrameMeasure(sharpness=m.sharpness, motion=min(m.motion, max(10 * usual, 1e-4)))
        for m in measures
    ]
    low, high = 0.0, sum(m.motion for m in limited[1:])
    chosen = list(range(len(measures)))
    for _ in range(20):
        middle = (low + high) / 2
        found = choose_keyframes(limited, motion=middle, max_gap=len(measures))
        if len(found) > count:
            low = middle
        else:
            high, chosen = middle, found
    return chosen


def _length(path: Path) -> int:
    """Number of frames that the video's header says."""
    return max(1, int(_opened(path).get(cv2.CAP_PROP_FRAME_COUNT)))


def _frames(path: Path, step: int) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Number and BGR image of every `step`-th frame."""
    capture = _opened(path)
    number = 0
    while capture.grab():
        if number % step == 0:
            good, image = capture.retrieve()
            if good:
                yield number, np.asarray(image, np.uint8)
        number += 1


def _opened(path: Path) -> Any:
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise ToolkitError(
            "the video cannot be read", path=path,
            hint="convert it to .mp4 with H.264, or give a folder of photos",
        )  # fmt: skip
    return capture
