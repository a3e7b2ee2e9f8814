"""Frames of a device, connected or played back from a file."""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from sensors.record import calibration, realsense, recording_document, sdk_frames
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

# Images queued between librealsense's threads and ours: one second of four streams.
_BACKLOG = 120
# A camera that sends no image for this long is unplugged or hung.
SILENCE_S = 5.0
_POLL_S = 0.05
# Time for the last images of a file to arrive from librealsense's threads.
_SETTLE_S = 0.5


class DeviceSource:
    """Iterates over the sets of images of a device; use as a context manager.

    Args:
        streams: by name; colour and depth at least.
        playback: the device plays a file: no image may be dropped, and its end ends the iteration.
        align: align depth to colour with librealsense.
        stop: called between images; the iteration ends when it returns True.

    Attributes:
        calibration, info, fps: of the device.
        overrun: images per stream dropped because `_BACKLOG` others were waiting.

    Raises:
        ToolkitError: unusable calibration or image format.
    """

    def __init__(
        self,
        device: Any,
        streams: dict[str, realsense.Stream],
        *,
        playback: bool,
        align: bool = False,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.info = realsense.device_info(device)
        self.calibration = calibration.read_calibration(streams)
        self.fps = float(streams["color"].profile.fps() or 30)
        self.overrun: Counter[str] = Counter()
        self.live = not playback
        sdk_frames.check_formats({name: s.profile for name, s in streams.items()})
        self._device = device
        self._streams = streams
        self._stop = stop
        self._names = {_key(s.profile): name for name, s in streams.items()}
        self._images: queue.Queue[tuple[str, Any]] = queue.Queue(_BACKLOG)
        self._closing = threading.Event()
        self._running: list[Any] = []
        self._starter: threading.Thread | None = None
        self._failed: RuntimeError | None = None
        self._aligner = sdk_frames.SdkAligner() if align else None
        slowest = min(s.profile.fps() or 30 for s in streams.values())
        names = ["color", *(n for n in streams if n != "color")]
        self._pairing = sdk_frames.Pairing(names, 1000.0 / slowest)

    @property
    def counts(self) -> dict[str, sdk_frames.StreamCount]:
        """Counts of each stream's images so far; `lost` excludes those of `overrun`."""
        return {
            name: replace(count, lost=max(0, count.lost - self.overrun[name]))
            for name, count in self._pairing.counts.items()
        }

    @property
    def given_up(self) -> int:
        """Minimum number of sets of images lost to `overrun`."""
        return max(self.overrun.values(), default=0)

    def __enter__(self) -> DeviceSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def frames(self) -> Iterator[recording_document.CapturedFrame]:
        """Sets of images in order of arrival.

        Raises:
            ToolkitError: the device cannot be started, or stops sending.
        """
        try:
            self._start()
        except RuntimeError as error:
            self.close()
            raise ToolkitError(
                f"the camera does not start: {error}",
                hint="does another program use it? Is it on USB 3?",
            ) from error
        heard = time.monotonic()
        first = last = None
        while not self._stop():
            try:
                name, image = self._images.get(timeout=_POLL_S)
            except queue.Empty:
                if self.live and time.monotonic() - heard > SILENCE_S:
                    raise ToolkitError(
                        f"the camera sends nothing any more ({SILENCE_S:g} s)",
                        hint="was it unplugged? A shorter cable or another USB 3 port may help",
                    ) from None
                if not self.live and self._ended() and time.monotonic() - heard > _SETTLE_S:
                    break
                if self._failed is not None:
                    raise ToolkitError(f"cannot be played: {self._failed}") from self._failed
                continue
            heard = time.monotonic()
            first = image.get_timestamp() if first is None else first
            last = image.get_timestamp()
            yield from self._paired(name, image)
        if not self.live and not self._stop():
            self.close(drop=False)
            while not self._images.empty():
                name, image = self._images.get()
                last = image.get_timestamp()
                yield from self._paired(name, image)
            for images in self._pairing.finish():
                yield self._converted(images)
            self._check_length(first, last)

    def close(self, *, drop: bool = True) -> None:
        """Stop the device; discard the images in transit, or queue them."""
        if drop:
            self._closing.set()
        else:
            self._images.maxsize = 0  # room for the images that librealsense still holds
        for sensor in self._running:
            for end in (sensor.stop, sensor.close):
                with suppress(RuntimeError):  # unplugged, or at the end of the file
                    end()
        self._running.clear()
        self._closing.set()

    def _start(self) -> None:
        by_sensor: list[tuple[Any, list[Any]]] = []
        for stream in self._streams.values():
            for sensor, profiles in by_sensor:
                if sensor is stream.sensor or _same(sensor, stream.sensor):
                    profiles.append(stream.profile)
                    break
            else:
                by_sensor.append((stream.sensor, [stream.profile]))
        for sensor, profiles in by_sensor:
            sensor.open(profiles)
            self._running.append(sensor)
        if self.live:
            for sensor, _ in by_sensor:
                sensor.start(self._take)
            return
        # A file plays once the first sensor starts; images of the other sensors would be missed.
        self._device.pause()

        def play() -> None:
            try:
                for sensor, _ in by_sensor:
                    sensor.start(self._take)
                self._device.resume()
            except RuntimeError as error:
                self._failed = error

        # Returns once images were taken from the queue, which this thread does.
        self._starter = threading.Thread(target=play, daemon=True)
        self._starter.start()

    def _take(self, image: Any) -> None:
        """Called by librealsense's threads."""
        name = self._names.get(_key(image.get_profile()))
        if name is None or self._closing.is_set():
            return  # a software device also sends streams that are not open
        if self.live:
            image.keep()  # librealsense's own pool is small and drops images silently
            try:
                self._images.put_nowait((name, image))
            except queue.Full:
                self.overrun[name] += 1
            return
        while not self._closing.is_set():
            with suppress(queue.Full):
                self._images.put((name, image), timeout=_POLL_S)
                return

    def _ended(self) -> bool:
        if self._starter is None or self._starter.is_alive():
            return False
        return bool(
            self._device.current_status() == realsense.librealsense().playback_status.stopped
        )

    def _paired(self, name: str, image: Any) -> Iterator[recording_document.CapturedFrame]:
        number, time_ms = image.get_frame_number(), image.get_timestamp()
        for images in self._pairing.add(name, number, time_ms, image):
            yield self._converted(images)

    def _converted(self, images: dict[str, Any]) -> recording_document.CapturedFrame:
        color, depth = images["color"], images["depth"]
        return recording_document.CapturedFrame(
            color=sdk_frames.color_image(color),
            depth=sdk_frames.depth_image(depth),
            timestamp=color.get_timestamp() / 1000,
            aligned=None if self._aligner is None else self._aligner(depth, color),
            infrared={
                name: sdk_frames.grey_image(images[name])
                for name in realsense.INFRARED
                if name in images
            },
            exposure_s=sdk_frames.exposure(color),
        )

    def _check_length(self, first: float | None, last: float | None) -> None:
        reported_s = self._device.get_duration().total_seconds()
        played = 0.0 if first is None or last is None else (last - first) / 1000
        if reported_s > played + 1 and played < 0.9 * reported_s:
            logger.warning(
                "the file declares %.1f s, its images last %.1f s: it may be damaged",
                reported_s,
                played,
            )


def _key(profile: Any) -> tuple[str, int]:
    return str(profile.stream_type()), profile.stream_index()


def _same(a: Any, b: Any) -> bool:
    name = realsense.librealsense().camera_info.name
    return bool(a.get_info(name) == b.get_info(name))


def open_file(path: str) -> Any:
    """The playback device of a file that librealsense recorded.

    Raises:
        ToolkitError: not found, of another kind, or damaged.
    """
    if not Path(path).is_file():
        raise ToolkitError("file not found", path=path)
    if Path(path).suffix.lower() not in (".bag", ".db3"):
        raise ToolkitError("not a recording of librealsense", path=path, hint=".bag or .db3")
    try:
        device = realsense.librealsense().context().load_device(str(path))
        device.set_real_time(False)
    except RuntimeError as error:
        raise ToolkitError(
            f"cannot be read: {error}",
            path=path,
            hint="it is damaged or was cut short; `rosbag reindex` may repair a .bag",
        ) from error
    return device
