"""A scene on disk that is complete at any time while it is recorded."""

from __future__ import annotations

import queue
import shutil
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np

from sensors.record import frame_files, frame_table, recording_document
from sensors.record.options import WriterOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import check_vacant, new_folder
from std_toolkit.io.locks import scene_lock
from std_toolkit.scene import Frames, Scene, SceneInfo

_CHECK_DISK_EVERY = 15


class SceneWriter:
    """Accepts frames and writes them as they arrive; use as a context manager.

    The scene appears with its first frame. From then on it is valid at any time and contains the
    finished frames.

    Args:
        out: of the scene.
        info: of the scene.
        document: recording.json; when a scene is resumed, the new sessions are appended to its own.
        drop: drop a frame if too many are waiting; otherwise wait.

    Attributes:
        dropped: number of dropped frames.
        taken: frames that are written or waiting.

    Raises:
        ToolkitError: `out` exists, or, to resume, no such scene or another camera.
    """

    def __init__(
        self,
        out: Path,
        info: SceneInfo,
        document: recording_document.RecordingDocument,
        options: WriterOptions,
        *,
        drop: bool,
    ) -> None:
        self.out = out
        self.dropped = 0
        self.taken = 0
        self._info = info
        self._document = document
        self._calibration: recording_document.Calibration = document.calibration()
        self._options = options
        self._drop = drop
        self._held = ExitStack()
        self._table: frame_table.FrameTable | None = None
        self._queue: queue.Queue[tuple[int, recording_document.CapturedFrame] | None] = queue.Queue(
            options.queue
        )
        self._threads: list[threading.Thread] = []
        self._error: Exception | None = None
        self._next = 0

    def __enter__(self) -> SceneWriter:
        check_free(self.out, self._options.keep_free_bytes)
        # Compile or load the code now, not when the first frames are waiting.
        _warm_up(self._calibration)
        if not self._options.resume:
            check_vacant(self.out)
            return self
        if not (self.out / "scene.json").is_file():
            raise ToolkitError(
                "there is no scene to resume", path=self.out, hint="leave out --resume"
            )
        self._held.enter_context(scene_lock(self.out, images=True))
        try:
            scene = frame_table.recovered(self.out)
            check_same_camera(scene.info, self._info, self.out)
            self._next = max((f.id for f in scene.frames), default=-1) + 1
            self._begin(frame_table.FrameTable(self.out, scene.frames))
        except BaseException:
            self._held.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        # Accepted frames are written however the recording ended.
        self.close()

    @property
    def first_frame(self) -> int:
        """Id of the first frame."""
        return self._next - self.taken

    @property
    def waiting(self) -> float:
        """Fill level of the queue, from 0 to 1."""
        return self._queue.qsize() / self._options.queue

    def offer(self, frame: recording_document.CapturedFrame) -> bool:
        """Accept a frame; False if it was dropped because the writer is too slow.

        Raises:
            ToolkitError: writing failed, or the disk is nearly full.
        """
        self._raise_error()
        if self.taken % _CHECK_DISK_EVERY == 0:
            check_free(self.out, self._options.keep_free_bytes)
        if self._table is None:
            self._create(frame)
            return True
        if self._drop:
            try:
                self._queue.put_nowait((self._next, frame))
            except queue.Full:
                self.dropped += 1
                return False
        else:
            self._wait_to_put((self._next, frame))
        self._next += 1
        self.taken += 1
        return True

    def close(
        self, finished: Callable[[], recording_document.RecordingDocument] | None = None
    ) -> None:
        """Write the accepted frames, then the current recording.json.

        Args:
            finished: returns the document with the counts of this session.

        Raises:
            ToolkitError: a file could not be written. Frames finished before are kept.
        """
        table, self._table = self._table, None
        if table is None:
            self._held.close()
            return
        for _ in self._threads:
            self._wait_to_put(None)
        for thread in self._threads:
            thread.join()
        try:
            if finished is not None and self._error is None:
                recording_document.write_recording(self.out, finished())
            table.close()
        finally:
            self._held.close()
        self._raise_error()

    def _wait_to_put(self, item: tuple[int, recording_document.CapturedFrame] | None) -> None:
        while True:
            if item is not None:
                self._raise_error()
            with suppress(queue.Full):
                self._queue.put(item, timeout=0.2)
                return

    def _create(self, frame: recording_document.CapturedFrame) -> None:
        """Create the scene with its first frame, atomically."""
        with new_folder(self.out) as staging:
            row = frame_files.write_frame(
                staging, self._next, frame, self._calibration, self._options.files
            )
            recording_document.write_recording(staging, self._document)
            Scene.create(staging, self._info, Frames(frames=[row]))
        self._held.enter_context(scene_lock(self.out, images=True))
        self._next += 1
        self.taken += 1
        self._begin(frame_table.FrameTable(self.out, [row]), write=False)

    def _begin(self, table: frame_table.FrameTable, *, write: bool = True) -> None:
        if write:
            recording_document.write_recording(self.out, self._document)
        self._table = table
        for number in range(self._options.threads):
            thread = threading.Thread(
                target=self._work, args=(table,), name=f"writer {number}", daemon=True
            )
            thread.start()
            self._threads.append(thread)

    def _work(self, table: frame_table.FrameTable) -> None:
        while (item := self._queue.get()) is not None:
            if self._error is not None:
                continue  # empty the queue, so that no caller waits for room
            try:
                table.add(
                    frame_files.write_frame(self.out, *item, self._calibration, self._options.files)
                )
            except Exception as error:
                self._error = error

    def _raise_error(self) -> None:
        error = self._error or (None if self._table is None else self._table.error)
        if isinstance(error, ToolkitError | None):
            if error is not None:
                raise error
            return
        if isinstance(error, OSError):
            raise ToolkitError(
                f"cannot be written: {error.strerror or error}", path=self.out
            ) from error
        raise error


def check_free(out: Path, keep_bytes: int) -> None:
    """Raise if the disk has too little free space.

    Raises:
        ToolkitError: less than `keep_bytes` are free.
    """
    folder = next(p for p in (out.absolute(), *out.absolute().parents) if p.exists())
    free = shutil.disk_usage(folder).free
    if free < keep_bytes:
        raise ToolkitError(
            f"the disk is nearly full: {free / 1e9:.2f} GB are free",
            path=out,
            hint=f"free some, or lower --keep-free (now {keep_bytes / 1e9:.2f})",
        )


def check_same_camera(there: SceneInfo, new: SceneInfo, out: Path) -> None:
    """Raise if camera or image size differ: a frame's intrinsics are those of its scene.

    Raises:
        ToolkitError: intrinsics or the unit of depth differ.
    """
    for name, camera in new.cameras.items():
        known = there.cameras.get(name)
        if known is None or (known.width, known.height) != (camera.width, camera.height):
            raise ToolkitError(
                f"the scene was not recorded with {camera.width}x{camera.height} images",
                path=out,
                hint="record another scene",
            )
        old, now = ([c.fx, c.fy, c.cx, c.cy, *c.distortion] for c in (known, camera))
        if len(old) != len(now) or not np.allclose(old, now, atol=0.01, rtol=0):
            raise ToolkitError(
                "the scene was recorded with another camera, or calibrated since",
                path=out,
                hint="record another scene",
            )
    if there.depth_scale is None or not np.isclose(there.depth_scale, new.depth_scale or 0):
        raise ToolkitError(
            "the scene's depth has another unit",
            path=out,
            field="depth_scale",
            value=there.depth_scale,
            hint="record another scene",
        )


def _warm_up(calibration: recording_document.Calibration) -> None:
    empty = np.zeros((calibration.depth.height, calibration.depth.width), dtype=np.uint16)
    black = np.zeros((1, 1, 3), dtype=np.uint8)
    frame_files.aligned_units(
        recording_document.CapturedFrame(color=black, depth=empty, timestamp=0.0), calibration
    )
