"""User interface while recording: the status line, the keys, the preview image and its page."""

import sys
import threading
from collections.abc import Callable

import cv2
import numpy as np

from sensors.record.hints import Hints
from sensors.record.recording_document import CapturedFrame, Image8

WIDTH = 640

_LINE_PX = 22

# Depth at which the colour scale ends.
_FAR_M = 2.0


def preview_picture(
    frame: CapturedFrame, hints: Hints | None, status: str, unit_m: float
) -> Image8:
    """(H, W, 3) RGB: colour and depth side by side, hints below.

    Args:
        status: state of the recording, such as the number of frames.
        unit_m: of the frame's depth.
    """
    color = _resized(frame.color, cv2.INTER_AREA)
    share = np.minimum(frame.depth * np.float32(unit_m) / _FAR_M, 1)
    mapped = cv2.applyColorMap((255 - 230 * share).astype(np.uint8), cv2.COLORMAP_TURBO)
    mapped[frame.depth == 0] = 0
    depth = cv2.resize(
        mapped[..., ::-1].astype(np.uint8), color.shape[1::-1], interpolation=cv2.INTER_NEAREST
    )
    lines = [status, *([] if hints is None else [hints.line()])]
    footer = np.zeros((_LINE_PX * len(lines) + 8, 2 * WIDTH, 3), dtype=np.uint8)
    for i, line in enumerate(lines):
        bad = i > 0 and hints is not None and bool(hints.advice)
        cv2.putText(
            footer, line, (8, _LINE_PX * (i + 1) - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.5,
            (255, 170, 60) if bad else (230, 230, 230), 1, cv2.LINE_AA,
        )  # fmt: skip
    return np.concatenate([np.concatenate([color, np.asarray(depth, np.uint8)], axis=1), footer])


def _resized(image: Image8, interpolation: int) -> Image8:
    height = max(1, round(image.shape[0] * WIDTH / image.shape[1]))
    return np.asarray(cv2.resize(image, (WIDTH, height), interpolation=interpolation), np.uint8)


def enter_pressed() -> Callable[[], bool]:
    """Return a function that reports whether Enter was pressed since. End of input counts."""
    pressed = threading.Event()

    def read() -> None:
        sys.stdin.readline()
        pressed.set()

    threading.Thread(target=read, name="enter", daemon=True).start()
    return pressed.is_set
