"""Frames of librealsense: pixel formats, pairing by time, and alignment by the SDK."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from sensors.record.realsense import librealsense
from sensors.record.recording_document import Image8, Units
from std_toolkit.errors import ToolkitError

# The pixel formats of most colour streams, and their conversion to RGB.
_TO_RGB = {
    "rgb8": None,
    "bgr8": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "yuyv": cv2.COLOR_YUV2RGB_YUYV,
    "uyvy": cv2.COLOR_YUV2RGB_UYVY,
}

# 0 is the camera's value for "no measurement"; this value is saturated.
_SATURATED = 65535


def check_formats(profiles: dict[str, Any]) -> None:
    """Check the image formats before the first image.

    Raises:
        ToolkitError: an unknown image format.
    """
    for name, profile in profiles.items():
        form = _format(profile)
        known = {"color": tuple(_TO_RGB), "depth": ("z16",)}.get(name, ("y8",))
        if form not in known:
            raise ToolkitError(
                "an image format that is not read",
                field=name,
                value=form,
                hint=f"known: {', '.join(known)}",
            )


def color_image(frame: Any) -> Image8:
    """(H, W, 3) RGB, a copy."""
    form = _format(frame.get_profile())
    data = np.asanyarray(frame.as_video_frame().get_data())
    conversion = _TO_RGB[form]
    if conversion is None:
        return np.array(data)
    if form in ("yuyv", "uyvy") and data.ndim == 2:  # 16 bits a pixel
        data = data.view(np.uint8).reshape(*data.shape, 2)
    return np.asarray(cv2.cvtColor(data, conversion), dtype=np.uint8)


def depth_image(frame: Any) -> Units:
    """(h, w) units, a copy; 0 = none."""
    units = np.array(np.asanyarray(frame.as_video_frame().get_data()), dtype=np.uint16)
    units[units == _SATURATED] = 0
    return units


def grey_image(frame: Any) -> Image8:
    """(h, w), a copy."""
    return np.array(np.asanyarray(frame.as_video_frame().get_data()), dtype=np.uint8)


def exposure(frame: Any) -> float | None:
    """Exposure time in seconds, or None."""
    kind = librealsense().frame_metadata_value.actual_exposure
    if not frame.supports_frame_metadata(kind):
        return None
    return float(frame.get_frame_metadata(kind)) * 1e-6 or None


def _format(profile: Any) -> str:
    return str(profile.format()).rsplit(".", 1)[-1].lower()


class SdkAligner:
    """`rs.align` on images that were paired here.

    It accepts only frame sets, which only a processing block can create.
    """

    def __init__(self) -> None:
        rs = librealsense()
        self._pair: list[Any] = []
        self._sets = rs.frame_queue(1, True)

        def join(_: Any, source: Any) -> None:
            source.frame_ready(source.allocate_composite_frame(self._pair))

        self._block = rs.processing_block(join)
        self._block.start(self._sets)
        self._align = rs.align(rs.stream.color)

    def __call__(self, depth: Any, color: Any) -> Units:
        """(H, W) units; librealsense keeps the z of the depth camera."""
        self._pair = [depth, color]
        self._block.invoke(depth)
        joined = self._sets.wait_for_frame(5000).as_frameset()
        self._pair = []
        return depth_image(self._align.process(joined).get_depth_frame())


@dataclass
class StreamCount:
    """Counts of a stream's images.

    Attributes:
        arrived: images.
        lost: frame numbers that the camera counted but that never arrived.
        single: images without a partner in the other streams.
    """

    arrived: int = 0
    lost: int = 0
    single: int = 0


@dataclass
class Pairing:
    """Sets of images, one of each stream, whose times differ by at most half a frame period.

    The first stream leads: each of its images is paired with the nearest one of every other stream.
    An image is taken as the nearest when a later one has arrived, or when it is at most a quarter
    of a period earlier than the leader. Images of one trigger are therefore emitted at once.

    Args:
        streams: names; the first leads.
        period_ms: frame period.
        period_ms: from frame to frame.
    """

    streams: Sequence[str]
    period_ms: float
    counts: dict[str, StreamCount] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.counts = {name: StreamCount() for name in self.streams}
        self._waiting: dict[str, deque[tuple[float, Any]]] = {n: deque() for n in self.streams}
        self._last: dict[str, tuple[int, float]] = {}

    def add(self, stream: str, number: int, time_ms: float, image: Any) -> Iterator[dict[str, Any]]:
        """Add an image; yields the sets that it completes, by stream name.

        Args:
            number: the camera's frame number, for counting losses.
            time_ms: milliseconds of a clock that all streams share.
        """
        count = self.counts[stream]
        count.arrived += 1
        if stream in self._last:
            number_before, time_before = self._last[stream]
            if time_ms <= time_before:  # duplicate or out of order
                count.single += 1
                return
            # A counter that restarts after a reset is not a loss.
            if number > number_before + 1:
                count.lost += number - number_before - 1
        self._last[stream] = (number, time_ms)
        self._waiting[stream].append((time_ms, image))
        yield from self._complete()

    def _complete(self) -> Iterator[dict[str, Any]]:
        leader, others = self.streams[0], self.streams[1:]
        while self._waiting[leader]:
            time_ms, image = self._waiting[leader][0]
            found: dict[str, Any] = {leader: image}
            for name in others:
                waiting = self._waiting[name]
                # The next image is at least as near to this leader: the first has no partner.
                while len(waiting) > 1 and abs(waiting[1][0] - time_ms) <= abs(
                    waiting[0][0] - time_ms
                ):
                    waiting.popleft()
                    self.counts[name].single += 1
                if waiting and waiting[0][0] < time_ms - self.period_ms / 2:
                    waiting.popleft()
                    self.counts[name].single += 1
                if not waiting:
                    if self._is_past(name, time_ms):
                        break
                    return  # its image has not arrived yet
                if waiting[0][0] > time_ms + self.period_ms / 2:
                    break
                if len(waiting) == 1 and waiting[0][0] < time_ms - self.period_ms / 4:
                    return  # a nearer one may arrive
                found[name] = waiting[0][1]
            self._waiting[leader].popleft()
            if len(found) < len(self.streams):
                self.counts[leader].single += 1
                continue
            for name in others:
                self._waiting[name].popleft()
            yield found

    def _is_past(self, name: str, time_ms: float) -> bool:
        """Whether a stream has passed this time, so that no image for it can arrive any more."""
        return name in self._last and self._last[name][1] >= time_ms + self.period_ms / 2

    def finish(self) -> Iterator[dict[str, Any]]:
        """Sets that were waiting for a nearer image; no more images arrive."""
        leader, others = self.streams[0], self.streams[1:]
        for time_ms, image in self._waiting[leader]:
            found = {leader: image}
            for name in others:
                near = [w for w in self._waiting[name] if abs(w[0] - time_ms) <= self.period_ms / 2]
                if near:
                    best = min(near, key=lambda w: abs(w[0] - time_ms))
                    self._waiting[name].remove(best)
                    found[name] = best[1]
            if len(found) == len(self.streams):
                yield found
            else:
                self.counts[leader].single += 1
        self._waiting[leader].clear()
        for name in others:
            self.counts[name].single += len(self._waiting[name])
            self._waiting[name].clear()
