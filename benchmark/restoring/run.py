"""`std-restore`: restore all frames of recordings, in parallel, resumed after an interruption.

A video shows colour, raw and restored depth side by side.
"""

from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.evaluation.depth_panels import DepthScale, range_of, restored_strip
from benchmark.published.citations import write_citations
from benchmark.restoring.alignment import depth_beside_color
from benchmark.restoring.multi_view import SINGLE, check_answer, check_poses, fuse_recording
from benchmark.restoring.options import RestoreOptions
from benchmark.restoring.outputs import (
    RECORD,
    FramePaths,
    FrameRecord,
    RestoreSetup,
    paths_of,
    record_of,
    setup_of,
    write_frame,
    write_intrinsics,
)
from benchmark.restoring.recordings import (
    INTRINSICS,
    FrameFiles,
    RecordingFiles,
    open_recordings,
)
from benchmark.restoring.restorer import RestoredFrame, Restorer
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path, sweep_temporaries
from std_toolkit.io.images import read_depth
from std_toolkit.io.locks import hold_lock
from std_toolkit.jobs import run_jobs
from std_toolkit.jobs.artefact import begin, check_begun
from std_toolkit.log import logger
from std_toolkit.settings import Settings, limit

# Every process holds a network; more than this many gain little beside the disk.
_MOST_WORKERS = 8

_ALIGNED = 5  # frames of a recording whose depth is compared with their colour


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """What a user is warned of."""

    smooth_moved: float = limit(
        0.02, source="no glass: 0.8 to 1.1 % of right pixels in three recordings, 4.4 % in one"
    )
    """share of the smooth depth of a recording that a method moves"""


@dataclass(frozen=True)
class Item:
    """A frame to restore, and the folder of its recording's results."""

    recording: str
    frame: FrameFiles
    out: Path

    def __str__(self) -> str:
        return f"{self.recording}/{self.frame.name}"


@dataclass
class RestoreReport:
    """Outcome of a run.

    Attributes:
        folders: of results, by recording.
        frames: records by recording and frame, in the order of recording.
        failed: error lines by `recording/frame`.
    """

    folders: dict[str, Path] = field(default_factory=dict)
    frames: dict[str, dict[str, FrameRecord]] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def shares(self, recording: str) -> dict[str, float]:
        """Mean shares of pixels over the frames of a recording; see `FrameRecord`."""
        rows = list(self.frames[recording].values())
        names = ("measured", "kept", "filled", "replaced", "empty")
        return {n: sum(getattr(r, n) for r in rows) / len(rows) for n in names} if rows else {}

    def smooth_moved(self, recording: str) -> float:
        """Share of the smooth depth of a recording that was moved; 0 without any."""
        rows = self.frames[recording].values()
        whole = sum(row.smooth for row in rows)
        return sum(row.smooth * row.smooth_moved for row in rows) / whole if whole else 0.0

    def warnings(self) -> list[str]:
        """A line on each recording of whose smooth depth too much is replaced."""
        found = []
        for name, out in self.folders.items():
            share = self.smooth_moved(name)
            if share > RunSettings.current().smooth_moved:
                found.append(
                    f"{out}: {share:.1%} of the smooth depth that the sensor measured is replaced; "
                    "glass may stand there: look at changed/. `--method nearest` fills holes alone"
                )
        return found

    def lines(self) -> list[str]:
        """A line on each recording, for the terminal."""
        found = []
        for name, out in self.folders.items():
            shares = self.shares(name)
            told = ", ".join(f"{100 * shares[key]:.1f} % {key}" for key in list(shares)[1:])
            text = f"{len(self.frames[name])} frames; of the pixels {told}"
            found.append(f"{out}: {text if shares else 'no frame restored'}")
        return found

    def records(self) -> list[dict[str, Any]]:
        """The same, for JSON."""
        return [
            {
                "recording": name,
                "out": str(out),
                "frames": len(self.frames[name]),
                "failed": [k for k in self.failed if k.startswith(f"{name}/")],
                "smooth_moved": round(self.smooth_moved(name), 6),
                **self.shares(name),
            }
            for name, out in self.folders.items()
        ]


def restore_recordings(options: RestoreOptions) -> RestoreReport:
    """Restore all frames; those that are done and whose images are the same are skipped.

    Raises:
        ToolkitError: a recording or the method cannot be used, or the folder of results belongs to
            other options or another process. A frame that fails is in the report.
    """
    # Workers on other machines have other working folders.
    options = _absolute(options)
    recordings = open_recordings(options.sources, options.images, options.out)
    if options.multi_view:
        for recording in recordings:
            check_poses(recording)
    # What is left out depends on the spread after the fusion.
    alone = replace(options.choice, max_error_m=None) if options.multi_view else options.choice
    # Made once here, so that a wrong option is reported once and before anything is written.
    restorer = Restorer.of(alone, device=options.device, backend=options.backend)
    setup = msgspec.structs.replace(
        setup_of(options.choice, restorer, options.depth_format, options.points, options.pictures),
        multi_view=options.multi_view,
    )
    of_single = setup
    if options.multi_view:
        plain = {"points": False, "pictures": False, "max_error_m": None, "multi_view": False}
        of_single = msgspec.structs.replace(setup, **plain)
    weights = restorer.options.weights
    graph = weights is not None and weights.suffix == ".onnx"
    if options.multi_view or graph or alone.max_error_m is not None:
        # Somebody else's graph may fail, or run on without end: once, before all frames do.
        answer = _try_first(restorer, recordings[0].frames[0])
        if options.multi_view and answer is not None:
            check_answer(answer)
    del restorer
    for recording in recordings:
        _warn_of_shift(recording)
    report = RestoreReport()
    with ExitStack() as locks:
        folders = {}
        for recording in recordings:
            out = options.out / recording.name if len(recordings) > 1 else options.out
            _begin(out, setup, recording, locks)
            report.folders[recording.name] = folders[recording.name] = out
            if options.multi_view:
                folders[recording.name] = out / SINGLE
                _begin(out / SINGLE, of_single, recording, locks)
        items = [
            Item(recording.name, frame, folders[recording.name])
            for recording in recordings
            for frame in recording.frames
        ]
        jobs = options.jobs
        if jobs.workers is None and jobs.engine == "local":
            jobs = replace(jobs, workers=min(jobs.worker_count, _MOST_WORKERS))
        choice = (alone, options.device, options.backend)
        done = run_jobs(
            partial(restore_item, choice=choice, setup=of_single),
            items,
            name="restore",
            options=jobs,
        )
        report.failed = dict(done.failed)
        for recording in recordings:
            name = recording.name
            records = {
                item.frame.name: record
                for item in items
                if item.recording == name and (record := done.results.get(str(item))) is not None
            }
            if options.multi_view and records:
                both = (folders[name], report.folders[name])
                fused = fuse_recording(recording, records, both, setup, jobs)
                report.failed |= fused.failed
                records = {
                    frame: fused.results[f"{name}/{frame}"]
                    for frame in records
                    if f"{name}/{frame}" in fused.results
                }
            report.frames[name] = records
    for line in report.warnings():
        logger.warning("%s", line)
    for out in report.folders.values():
        write_citations(out, [setup.method])
    if options.video is not None:
        for recording in recordings:
            _write_video(report, recording, setup, options.video)
    return report


def _warn_of_shift(recording: RecordingFiles) -> None:
    """Say so if depth lies beside colour in a few frames that can be read."""
    step = max(1, len(recording.frames) // _ALIGNED)
    read = []
    for frame in recording.frames[::step][:_ALIGNED]:
        with suppress(ToolkitError):  # reported with its frame
            read.append(frame.read())
    if (beside := depth_beside_color(read)) is not None:
        logger.warning(
            "%s: depth lies beside colour, by about %.0f px in x and %.0f px in y; align depth to "
            "colour, and pair images of one time",
            recording.source, beside.x_px, beside.y_px,
        )  # fmt: skip


def _try_first(restorer: Restorer, frame: FrameFiles) -> RestoredFrame | None:
    """Restore a frame and write nothing; None if its images cannot be restored.

    Raises:
        ToolkitError: the network fails, or takes too long.
    """
    try:
        color, sensor = frame.read()
    except ToolkitError:
        return None  # reported with its frame
    return restorer.restore_view(color, sensor, frame.camera) if (sensor > 0).any() else None


def _write_video(
    report: RestoreReport, recording: RecordingFiles, setup: RestoreSetup, fps: float
) -> None:
    out, records = report.folders[recording.name], report.frames[recording.name]
    done = [
        (frame, paths_of(out, frame, setup.depth_format), records[frame.name].unit)
        for frame in recording.frames
        if frame.name in records
    ]
    if done:
        write_video(out, done, fps)


def restore_item(item: Item, *, choice: tuple[Any, ...], setup: RestoreSetup) -> FrameRecord:
    """Restore a frame, or return its record if it is done.

    Raises:
        ToolkitError: its images cannot be read, or the method fails.
    """
    paths = paths_of(item.out, item.frame, setup.depth_format)
    if (record := paths.artefact(item.frame).find(paths.record, FrameRecord)) is not None:
        return record
    color, sensor = item.frame.read()
    restored = _restorer(choice).restore_view(color, sensor, item.frame.camera)
    return write_frame(paths, item.frame, color, sensor, restored, setup)


_kept: dict[str, Restorer] = {}


def _restorer(choice: tuple[Any, ...]) -> Restorer:
    """The restorer of this process."""
    key = repr(choice)
    if key not in _kept:
        _kept.clear()
        method, device, backend = choice
        _kept[key] = Restorer.of(method, device=device, backend=backend)
    return _kept[key]


def _absolute(options: RestoreOptions) -> RestoreOptions:
    choice, images = options.choice, options.images
    file, colon, name = choice.method.rpartition(":")
    of_file = bool(colon) and file.endswith(".py")
    return replace(
        options,
        sources=tuple(source.absolute() for source in options.sources),
        out=options.out.absolute(),
        choice=replace(
            choice,
            method=f"{Path(file).absolute()}:{name}" if of_file else choice.method,
            weights=choice.weights and choice.weights.absolute(),
        ),
        images=replace(
            images,
            color=images.color and str(Path(images.color).absolute()),
            depth=images.depth and str(Path(images.depth).absolute()),
        ),
    )


def _begin(out: Path, setup: RestoreSetup, recording: RecordingFiles, locks: ExitStack) -> None:
    """Lock the folder of a recording's results and write its record, or compare with it."""
    record = record_of(setup, recording.source, len(recording.frames))
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ToolkitError(f"cannot make the folder: {error.strerror}", path=out) from error
    hint, beside = "choose another --out", ("recordings",)
    check_begun(out / RECORD, hint=hint, beside=beside)
    locks.enter_context(hold_lock(out, "lock", doing="writing to"))
    begin(
        out / RECORD,
        record,
        within=["setup"],
        what="these results were",
        hint=hint,
        beside=beside,
    )
    if recording.frames[0].undistortion is not None:
        write_intrinsics(out / INTRINSICS, recording.frames[0].camera)
    sweep_temporaries(out)


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
