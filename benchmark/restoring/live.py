"""`std-restore live`: restore the depth of a connected camera, frame by frame."""

import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.evaluation.depth_panels import restored_strip
from benchmark.published.citations import write_citations
from benchmark.restoring.options import LiveOptions
from benchmark.restoring.outputs import (
    RECORD,
    paths_of,
    record_of,
    setup_of,
    write_frame,
    write_intrinsics,
)
from benchmark.restoring.recordings import INTRINSICS, FrameFiles
from benchmark.restoring.restorer import RestoredFrame, Restorer
from std_toolkit.cameras import CAMERAS, CameraRequest, LiveCamera, LiveFrame
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, Undistortion
from std_toolkit.html.preview import PreviewPage, asked_token, encoded
from std_toolkit.io.atomic import check_vacant, write_bytes_atomic
from std_toolkit.io.documents import write_document
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.jobs.live import StatusLine, stopped_by_signal
from std_toolkit.log import logger

_UNIT_M = 0.001
_POLL_S = 0.1


@dataclass
class LiveReport:
    """Outcome of a live run.

    Attributes:
        camera: name of the device.
        received: number of frames that the camera sent.
        restored: number of frames that were restored; the newest is always next.
        skipped: number of frames that could not be restored.
        seconds: from the first frame to the last.
    """

    camera: str
    received: int = 0
    restored: int = 0
    skipped: int = 0
    seconds: float = 0.0


class _Newest:
    """The newest frame of a camera, which is read in a thread of its own."""

    def __init__(self, camera: LiveCamera) -> None:
        self.received = 0
        self.ended = False
        self._frame: LiveFrame | None = None
        self._error: BaseException | None = None
        self._there = threading.Condition()
        self._thread = threading.Thread(target=self._read, args=(camera,), daemon=True)
        self._thread.start()

    def _read(self, camera: LiveCamera) -> None:
        try:
            for frame in camera.frames():
                with self._there:
                    self._frame = frame
                    self.received += 1
                    self._there.notify()
        except BaseException as error:  # raised again in the main thread
            self._error = error
        with self._there:
            self.ended = True
            self._there.notify()

    def take(self) -> LiveFrame | None:
        """The newest frame that was not taken yet; None if there is none for a moment.

        Raises:
            ToolkitError: the camera failed.
        """
        with self._there:
            if self._frame is None and not self.ended:
                self._there.wait(_POLL_S)
            frame, self._frame = self._frame, None
        if frame is None and self._error is not None:
            raise self._error
        return frame


def restore_live(options: LiveOptions) -> LiveReport:
    """Restore frames of a camera until Ctrl-C, its end, or `options.frames`.

    Raises:
        ToolkitError: no such camera or method, the camera fails, or a folder or port is taken.
    """
    restorer = Restorer.of(options.choice, device=options.device, backend=options.backend)
    if options.out is not None:
        check_vacant(options.out)
    with stopped_by_signal() as stop, ExitStack() as parts:
        page = None
        if options.web is not None:
            page = parts.enter_context(PreviewPage(options.web, asked_token(options.token)))
            print(f"preview: {page.address}", file=sys.stderr)
        request = CameraRequest(
            serial=options.serial, size=options.camera_size, fps=options.fps, stop=stop
        )
        camera = CAMERAS.get(options.camera)(request)
        parts.callback(camera.close)
        undistortion = Undistortion.of(camera.camera)
        images = camera.camera if undistortion is None else undistortion.camera
        if undistortion is not None:
            logger.info("%s", undistortion)
        report = LiveReport(camera.name)
        writer = None if options.out is None else _Writer(options, restorer, images)
        status = StatusLine()
        parts.callback(status.end)
        newest = _Newest(camera)
        started = None
        while not stop() and (options.frames is None or report.restored < options.frames):
            frame = newest.take()
            if frame is None:
                if newest.ended:
                    break
                continue
            started = started or time.monotonic()
            if undistortion is not None:
                color: Any = undistortion.image(frame.color)
                depth: Any = undistortion.depth(frame.depth)
                frame = LiveFrame(color, depth, frame.timestamp)
            try:
                restored = restorer.restore_view(frame.color, frame.depth, images)
            except ToolkitError as error:
                if error.field == "--max-error":  # so does every frame
                    raise
                report.skipped += 1
                logger.warning("a frame is skipped: %s", error)
                continue
            report.restored += 1
            report.received = newest.received
            report.seconds = time.monotonic() - started
            if writer is not None:
                writer.write(report.restored - 1, frame, restored)
            status.show(_line(report))
            if page is not None or options.preview is not None:
                strip = restored_strip(
                    frame.color, frame.depth, restored.depth, restored.confidence
                )
                picture = encoded(strip)
                if page is not None:
                    page.show(picture)
                if options.preview is not None:
                    write_bytes_atomic(options.preview, picture)
        report.received = newest.received
        if writer is not None and report.restored:
            writer.finish(report)
    if not report.restored:
        raise ToolkitError("the camera sent no frame that could be restored", value=report.camera)
    return report


def _line(report: LiveReport) -> str:
    rate = report.restored / report.seconds if report.seconds > 0 else 0.0
    return f"{report.restored} frames restored, {rate:.1f} a second, {report.received} received"


class _Writer:
    """Keeps the images of the camera in `recording/`, and what is restored beside it."""

    def __init__(self, options: LiveOptions, restorer: Restorer, camera: Camera) -> None:
        assert options.out is not None
        self.out: Path = options.out
        self.camera = camera
        self.setup = setup_of(options.choice, restorer, "png", options.points, options.pictures)
        write_intrinsics(self.out / "recording" / INTRINSICS, camera)

    def write(self, number: int, frame: LiveFrame, restored: RestoredFrame) -> None:
        """Write the images of a frame.

        Raises:
            ToolkitError: the disk is full.
        """
        name = f"{number:06d}"
        recording = self.out / "recording"
        files = FrameFiles(
            name,
            recording / "color" / f"{name}.jpg",
            recording / "depth" / f"{name}.png",
            self.camera,
            _UNIT_M,
        )
        write_color(files.color, frame.color)
        write_depth_png16(files.depth, frame.depth, scale=_UNIT_M)
        paths = paths_of(self.out, files, "png")
        write_frame(paths, files, frame.color, frame.depth, restored, self.setup)

    def finish(self, report: LiveReport) -> None:
        """Write the record and the citations."""
        write_citations(self.out, [self.setup.method])
        write_document(self.out / RECORD, record_of(self.setup, report.camera, report.restored))
