"""A video becomes photos: sharp, spread over the motion, and made once."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.scanning.photos.video import is_video, sample_video

_FRAMES, _STILL, _SIZE = 90, 30, (320, 240)


def write_video(path: Path) -> None:
    """The camera rests for 30 frames, then moves; every third moving frame is sharp."""
    rng = np.random.default_rng(0)
    wide = cv2.resize(rng.integers(0, 255, (60, 300, 3), np.uint8), (1200, 240))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, _SIZE)
    for i in range(_FRAMES):
        x = 10 * max(0, i - _STILL)
        frame = wide[:, x : x + _SIZE[0]]
        if i >= _STILL and i % 3:
            frame = cv2.blur(frame, (7, 1))
        writer.write(np.ascontiguousarray(frame))
    writer.release()


def test_frames_are_sharp_and_follow_the_motion(tmp_path: Path) -> None:
    path = tmp_path / "walk.avi"
    write_video(path)
    assert is_video(path)
    folder = sample_video(path, tmp_path / "work", count=12)
    numbers = [int(p.stem) for p in sorted(folder.glob("*.png"))]
    assert 8 <= len(numbers) <= 12
    moving = [n for n in numbers if n > _STILL]
    assert len(moving) >= len(numbers) - 2
    # The last frame is taken as it is.
    assert sum(n % 3 == 0 for n in moving[:-1]) >= 0.8 * (len(moving) - 1)
    assert max(np.diff(moving)) <= 15
    first = cv2.imread(str(folder / f"{numbers[0]:06d}.png"))
    assert first.shape == (240, 320, 3)


def test_a_video_is_sampled_once(tmp_path: Path) -> None:
    path = tmp_path / "walk.avi"
    write_video(path)
    folder = sample_video(path, tmp_path / "work", count=10)
    times = {p: p.stat().st_mtime_ns for p in folder.iterdir()}
    sample_video(path, tmp_path / "work", count=10)
    assert {p: p.stat().st_mtime_ns for p in folder.iterdir()} == times
    again = sample_video(path, tmp_path / "work", count=6)
    assert len(list(again.glob("*.png"))) <= 6


def test_a_file_that_is_no_video_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cup.mp4"
    path.write_bytes(b"not a video")
    with pytest.raises(ToolkitError, match="the video cannot be read"):
        sample_video(path, tmp_path / "work")
