"""One recording, from the first image to the last written frame."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from sensors.record import device_source, recording_document, scene_writer
from sensors.record.calibration import compare
from sensors.record.hints import HintMaker, Hints
from sensors.record.options import SessionOptions
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger
from std_toolkit.scene.model import SceneInfo

# Interval of the hints by the frames' clock; recording itself has priority.
_LOOK_S = 0.12
_BUSY = 0.5


@dataclass
class Progress:
    """State of a recording, passed to the watcher with every frame.

    Attributes:
        written: frames accepted by the writer.
        seconds: time between the first and the last frame.
        dropped: sets of images for which the writer or its queue had no room.
        lost: images that the camera counted but that never arrived, of the worst stream.
        hints: the last ones, or None before the first.
        recording: false while exposure settles and before the user starts the recording.
    """

    written: int = 0
    seconds: float = 0.0
    dropped: int = 0
    lost: int = 0
    hints: Hints | None = None
    recording: bool = False

    def line(self) -> str:
        """One line for the terminal."""
        state = "recording" if self.recording else "waiting  "
        text = f"{state} {self.written} frames {self.seconds:.1f} s, {self.dropped} dropped"
        return text if self.hints is None else f"{text}  {self.hints.line()}"


Watcher = Callable[[recording_document.CapturedFrame, Progress], None]


def record(
    out: Path,
    source: device_source.DeviceSource,
    options: SessionOptions,
    *,
    aligned_by: str,
    origin: str,
    settings: dict[str, str],
    started: Callable[[], bool] = lambda: True,
    on_start: Callable[[recording_document.CapturedFrame], dict[str, str]] = lambda _: {},
    watch: Watcher = lambda _frame, _progress: None,
) -> recording_document.Session:
    """Record to `out` until the source ends or a limit is reached.

    Args:
        aligned_by: "toolkit" or "librealsense".
        origin: "camera", or the name of the file.
        settings: of the camera, for recording.json.
        started: called while nothing is recorded yet; returns whether to begin.
        on_start: called with the last image before recording; the result is added to `settings`.
        watch: called with every analysed frame.

    Raises:
        ToolkitError: the source or the writer fails. The scene keeps the frames finished so far.
    """
    document = _document(out, source, options, aligned_by, origin, settings)
    info = SceneInfo(
        name=options.name,
        cameras={"color": document.color},
        depth_scale=document.depth_unit_m,
        source=f"record:{origin}",
    )
    progress, look = Progress(), _Observation(HintMaker(source.fps), watch)
    clock = _Clock()
    writer = scene_writer.SceneWriter(out, info, document, options.writer, drop=source.live)
    with writer:
        session = document.sessions[-1]
        session = msgspec.structs.replace(session, first_frame=writer.first_frame)

        def finished(ended: bool = True) -> recording_document.RecordingDocument:
            nonlocal session
            session = _counted(session, source, writer, clock, ended)
            return msgspec.structs.replace(document, sessions=[*document.sessions[:-1], session])

        try:
            seen = 0
            for number, frame in enumerate(source.frames()):
                progress.dropped = writer.dropped + source.given_up
                progress.lost = max(count.lost for count in source.counts.values())
                if not progress.recording:
                    if number < (options.warm_up or 0) or not started():
                        look(frame, progress, busy=False)
                        continue
                    progress.recording = True
                    session = msgspec.structs.replace(
                        session, settings={**session.settings, **on_start(frame)}
                    )
                seen += 1
                if (seen - 1) % options.every:
                    continue
                if options.seconds is not None and clock.would_be(frame) > options.seconds:
                    break
                if writer.offer(frame):
                    clock.tick(frame)
                progress.written, progress.seconds = writer.taken, clock.seconds
                look(frame, progress, busy=source.live and writer.waiting > _BUSY)
                if options.frames is not None and writer.taken >= options.frames:
                    break
        finally:
            source.close()
            writer.close(finished)
    if not writer.taken:
        raise ToolkitError(
            "nothing was recorded: no frame had both colour and depth",
            path=out,
            hint="; ".join(f"{name}: {c.arrived} images" for name, c in source.counts.items()),
        )
    return session


class _Clock:
    """Times of the first and the last accepted frame."""

    def __init__(self) -> None:
        self._first: float | None = None
        self.seconds = 0.0

    def would_be(self, frame: recording_document.CapturedFrame) -> float:
        return 0.0 if self._first is None else frame.timestamp - self._first

    def tick(self, frame: recording_document.CapturedFrame) -> None:
        self.seconds = self.would_be(frame)
        if self._first is None:
            self._first = frame.timestamp


class _Observation:
    """Analyses some of the frames."""

    def __init__(self, hints: HintMaker, watch: Watcher) -> None:
        self._hints = hints
        self._watch = watch
        self._last = float("-inf")

    def __call__(
        self, frame: recording_document.CapturedFrame, progress: Progress, *, busy: bool
    ) -> None:
        if busy or 0 <= frame.timestamp - self._last < _LOOK_S:
            return
        self._last = frame.timestamp
        progress.hints = self._hints.look(frame)
        self._watch(frame, progress)


def _document(
    out: Path,
    source: device_source.DeviceSource,
    options: SessionOptions,
    aligned_by: str,
    origin: str,
    settings: dict[str, str],
) -> recording_document.RecordingDocument:
    calibration = source.calibration
    notes = [*calibration.notes, *compare(source.info, calibration, options.sensor)]
    for note in notes:
        logger.warning("%s", note)
    session = recording_document.Session(
        version=__version__, source=origin, first_frame=0, settings=settings
    )
    document = recording_document.RecordingDocument(
        device=recording_document.device_document(source.info),
        color=calibration.color,
        depth=calibration.depth,
        infrared=calibration.infrared,
        T_color_depth=calibration.T_color_depth.flat(),
        depth_unit_m=calibration.depth_unit_m,
        baseline_m=calibration.baseline_m,
        aligned_by="librealsense" if aligned_by == "librealsense" else "toolkit",
        kept=options.writer.files.kept,
        notes=notes,
        sessions=[session],
    )
    if not options.writer.resume or not (out / "scene.json").is_file():
        return document
    known = recording_document.read_recording(out)
    if known.aligned_by != document.aligned_by or known.kept != document.kept:
        raise ToolkitError(
            f"the scene was recorded with depth aligned by {known.aligned_by} and "
            f"{', '.join(known.kept) or 'no further maps'} kept",
            path=out,
            hint="give the same options",
        )
    return msgspec.structs.replace(document, notes=notes, sessions=[*known.sessions, session])


def _counted(
    session: recording_document.Session,
    source: device_source.DeviceSource,
    writer: scene_writer.SceneWriter,
    clock: _Clock,
    ended: bool,
) -> recording_document.Session:
    return msgspec.structs.replace(
        session,
        ended=ended,
        frames=writer.taken,
        seconds=max(0.0, round(clock.seconds, 6)),
        dropped=writer.dropped + source.given_up,
        lost={name: c.lost for name, c in source.counts.items()},
        single={name: c.single for name, c in source.counts.items()},
    )


def rate(began: float, frames: int) -> float:
    """Frames per second since `began` (of time.monotonic)."""
    return frames / max(1e-9, time.monotonic() - began)
