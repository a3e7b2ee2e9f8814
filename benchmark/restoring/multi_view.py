"""`std-restore SCENE --multi-view`: all frames are restored alone, then fused, both resumable.

`single/` has the frames that are restored alone, as a run without the option writes them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.restoring.outputs import (
    FramePaths,
    FrameRecord,
    RestoreSetup,
    paths_of,
    read_frame,
    write_frame,
)
from benchmark.restoring.recordings import FrameFiles, RecordingFiles
from benchmark.restoring.restorer import FINDER, RestoredFrame
from benchmark.restoring.view_fusion import Fused, FusionSettings, ViewFusion
from benchmark.restoring.visual_hull import PosedView
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Undistortion, pixel_rays
from std_toolkit.io.documents import digest_of
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.jobs.runner import JobReport
from std_toolkit.log import logger

SINGLE = "single"  # folder of the frames that are restored alone


def check_poses(recording: RecordingFiles) -> None:
    """Check that views of a recording can be fused.

    Raises:
        ToolkitError: fewer than two of its frames have camera poses.
    """
    posed = sum(frame.T_world_cam is not None for frame in recording.frames)
    if posed < 2 <= len(recording.frames) or posed == 0:
        raise ToolkitError(
            "has no camera poses" if posed == 0 else "has a camera pose of one frame alone",
            path=recording.source,
            field="--multi-view",
            hint="make a scene of it (`std-curate import`), find its poses (`std-curate poses "
            "SCENE`), and restore that scene; or leave out --multi-view",
        )
    if posed < len(recording.frames):
        logger.warning(
            "%s: %d of %d frames have no camera pose and stay as they are restored alone",
            recording.source, len(recording.frames) - posed, len(recording.frames),
        )  # fmt: skip


def check_answer(restored: RestoredFrame) -> None:
    """Check that the answers of a method can be fused.

    Raises:
        ToolkitError: it gives no spread, or nothing tells where glass and metal are.
    """
    if restored.spread is None or restored.clear is None:
        raise ToolkitError(
            "the method does not say "
            + ("how far off its answers are" if restored.spread is None else "where glass is"),
            field="--multi-view",
            hint=f"--method {FINDER} says both",
        )


@dataclass(frozen=True, eq=False)
class FrameToFuse:
    """A frame of a recording that is restored alone."""

    recording: str
    frame: FrameFiles
    paths: FramePaths
    single: FramePaths
    record: FrameRecord

    def __str__(self) -> str:
        return f"{self.recording}/{self.frame.name}"

    def posed(self, restored: RestoredFrame) -> PosedView:
        """The frame as a view of a pinhole."""
        camera, T_world_cam = self.frame.camera, self.frame.T_world_cam
        spread, clear = restored.spread, restored.clear
        assert T_world_cam is not None and spread is not None and clear is not None
        depth, kept, seen = restored.depth, ~restored.changed & (restored.depth > 0), None
        if camera.is_distorted:
            pinhole = Undistortion(camera, camera.without_distortion())
            depth, spread, clear = (_float(pinhole.depth(m)) for m in (depth, spread, clear))
            kept = pinhole.depth(kept).astype(bool)
            seen = pinhole.depth(np.ones(kept.shape, bool)).astype(bool)
            camera = pinhole.camera
        return PosedView(self.frame.name, camera, T_world_cam, depth, spread, clear, kept, seen)

    def filed(self, restored: RestoredFrame, fused: Fused) -> RestoredFrame:
        """The answer of the fusion through the lens of the frame; the rest stays to the bit."""
        assert restored.spread is not None and restored.clear is not None
        depth, spread, where = fused.depth, fused.spread, fused.fused
        camera = self.frame.camera
        if camera.is_distorted:
            c = camera.without_distortion()
            rays = np.nan_to_num(pixel_rays(camera), nan=-10.0)
            u, v = (
                np.clip(np.rint(f * rays[..., a] + o).astype(int), 0, n - 1)
                for a, f, o, n in ((0, c.fx, c.cx, c.width), (1, c.fy, c.cy, c.height))
            )
            kept = ~restored.changed & (restored.depth > 0)  # rounding may take a neighbour's
            depth, spread, where = depth[v, u], spread[v, u], where[v, u] & ~kept
        depth = np.where(where, depth, restored.depth)
        spread = np.where(where, spread, restored.spread)
        return replace(restored, depth=depth, spread=spread)


@dataclass
class RecordingFusion:
    """The fusion of a recording, made when the first frame needs it."""

    items: Sequence[FrameToFuse] = field(repr=False)

    @cached_property
    def made(self) -> ViewFusion:
        posed = [item for item in self.items if item.frame.T_world_cam is not None]
        most = FusionSettings.current().most_views
        chosen = sorted({round(i) for i in np.linspace(0, len(posed) - 1, min(len(posed), most))})
        return ViewFusion([item.posed(_single(item)) for item in (posed[i] for i in chosen)])


def fuse_recording(
    recording: RecordingFiles,
    records: Mapping[str, FrameRecord],
    folders: tuple[Path, Path],
    setup: RestoreSetup,
    jobs: JobOptions,
) -> JobReport[FrameRecord]:
    """Fuse all frames of a recording and write them; those that are done are kept.

    Args:
        recording: its frames.
        records: of the frames that are restored alone, by name.
        folders: of these frames, and of the results.
        setup: of the results.
        jobs: whether progress is shown; the work is done in this process.

    Returns:
        Records and failures by `recording/frame`.
    """
    done = [frame for frame in recording.frames if frame.name in records]
    poses = [None if f.T_world_cam is None else f.T_world_cam.flat() for f in done]
    digest = digest_of([records[f.name].outputs for f in done], poses, versioned=False)
    more = {"single frames or camera poses": digest}
    items = [
        FrameToFuse(
            recording.name,
            frame,
            replace(paths_of(folders[1], frame, setup.depth_format), more=more),
            paths_of(folders[0], frame, setup.depth_format),
            records[frame.name],
        )
        for frame in done
    ]
    work = partial(_fuse_item, fusion=RecordingFusion(items), setup=setup)
    return run_jobs(work, items, name="fuse", options=replace(jobs, engine="serial", workers=None))


def _fuse_item(item: FrameToFuse, *, fusion: RecordingFusion, setup: RestoreSetup) -> FrameRecord:
    artefact = item.paths.artefact(item.frame)
    if (record := artefact.find(item.paths.record, FrameRecord)) is not None:
        return record
    color, sensor = item.frame.read()
    restored = _single(item)
    if item.frame.T_world_cam is not None:
        restored = item.filed(restored, fusion.made.fuse(item.posed(restored)))
    if setup.max_error_m is not None:
        assert restored.spread is not None
        too_far = restored.spread > setup.max_error_m
        restored = replace(restored, depth=np.where(too_far, np.float32(0), restored.depth))
    return write_frame(item.paths, item.frame, color, sensor, restored, setup)


def _float(values: NDArray[Any]) -> Floats:
    return np.asarray(values, np.float32)


def _single(item: FrameToFuse) -> RestoredFrame:
    """A frame that was restored alone."""
    restored = read_frame(item.single, item.record)
    check_answer(restored)
    return restored
