"""The import step: selects the importer, reads, writes the scene completely or not at all."""

from __future__ import annotations

import errno
import os
import shutil
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.importers import foreign_files, importer
from std_toolkit.importers.ros_importer import is_ros_recording
from std_toolkit.io import atomic, exr, images
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.log import logger
from std_toolkit.options import ImportRequest, KnownCameras, LinkMode, PoseOptions
from std_toolkit.scene import CameraModel, Frame, Frames, ObjectTable, Scene, SceneInfo
from std_toolkit.scene.document import check_name, check_relative

# Below this number of frames, starting worker processes costs more than it saves.
_SERIAL_BELOW = 48

# Beyond the range of every RGB-D sensor.
_FARTHEST_FRAME_M = 30.0


@dataclass(frozen=True)
class WrittenFrame:
    """Result of one frame: its row, and the median of its measured depth in metres."""

    frame: Frame
    depth_median_m: float | None
    has_depth: bool


def write_recording(
    recording: importer.Recording,
    out: Path,
    *,
    name: str,
    link: LinkMode = "copy",
    options: JobOptions | None = None,
    known: KnownCameras | None = None,
) -> Scene:
    """Make the scene `out` from a recording.

    Args:
        name: name of the scene.
        link: "copy" images, or "hard"- or "sym"-link those that need no conversion.
        options: where the frames are processed.
        known: camera poses from elsewhere, which are checked and added.

    Raises:
        ToolkitError: an image is damaged or has the wrong size, depth is in another unit, or
            `out` exists. No files remain.
    """
    _check_frames(recording)
    info = SceneInfo(
        name=name,
        cameras=recording.cameras,
        depth_scale=recording.depth_scale,
        depth_correction=recording.depth_correction,
        source=recording.source,
    )
    if options is None and len(recording.frames) < _SERIAL_BELOW:
        options = JobOptions(engine="serial")
    with atomic.new_folder(out) as staging:
        job = partial(
            _write_frame,
            root=staging,
            cameras=recording.cameras,
            depth_scale=recording.depth_scale,
            link=link,
        )
        report = run_jobs(
            job, recording.frames, name="import", key=lambda f: f.name, options=options
        )
        report.raise_if_failed()
        _check_depth_unit(recording, list(report.results.values()))
        _write_models(recording, staging)
        # Opening the scene validates the importer's poses and labels against the tables.
        scene = Scene.create(
            staging,
            info,
            Frames(frames=[w.frame for w in report.results.values()]),
            ObjectTable(
                models=[m.model for m in recording.models], objects=list(recording.objects)
            ),
        )
        if recording.poses is not None:
            scene.save_poses(recording.poses)
        if recording.labels is not None:
            scene.save_labels(recording.labels)
        checked = Scene.open(staging)
        _ = checked.poses, checked.labels
        if known is not None and (known.cameras is not None or known.hand_eye is not None):
            _add_known_poses(checked, known, options)
    for note in recording.notes:
        logger.warning("%s", note)
    return Scene.open(out)


def _add_known_poses(scene: Scene, known: KnownCameras, options: JobOptions | None) -> None:
    from std_toolkit.poses.pose_step import estimate_poses

    if scene.poses is not None:
        raise ToolkitError(
            "the recording has camera poses of its own",
            field="--cameras",
            value=str(known.cameras),
            hint="import it without --cameras, then `std-curate poses SCENE --cameras FILE`",
        )
    estimate_poses(scene, PoseOptions(known=known), jobs=options)


def _check_frames(recording: importer.Recording) -> None:
    """Check frames and names, which come from foreign files, before anything is written.

    Raises:
        ToolkitError: no frames, a name or path outside the scene, or a duplicate.
    """
    if not recording.frames:
        raise ToolkitError("the recording has no frames")
    seen: set[str] = set()
    for i, frame in enumerate(recording.frames):
        check_name(frame.name, field=f"frames[{i}].name")
        if frame.name in seen:
            raise ToolkitError("appears twice", field=f"frames[{i}].name", value=frame.name)
        seen.add(frame.name)
        if frame.camera not in recording.cameras:
            raise ToolkitError("no such camera", field=f"frames[{i}].camera", value=frame.camera)
        for file in (frame.color, frame.depth, *frame.reference):
            if file is not None:
                check_relative(file.target, field=f"frames[{i}]")


def _write_frame(
    frame: importer.SourceFrame,
    *,
    root: Path,
    cameras: dict[str, CameraModel],
    depth_scale: float | None,
    link: LinkMode,
) -> WrittenFrame:
    camera = cameras[frame.camera]
    size = (camera.width, camera.height)
    color = _write_color(frame.color, root, size, link)
    depth = None
    median: float | None = None
    if frame.depth is not None:
        depth, median = _write_depth(frame.depth, root, size, depth_scale, link)
    for extra in frame.reference:
        _write_reference(extra, root, size, link)
    row = Frame(
        id=frame.id,
        name=frame.name,
        color=color,
        depth=depth,
        camera=frame.camera,
        timestamp=frame.timestamp,
    )
    return WrittenFrame(row, median, depth is not None)


def _write_color(
    file: importer.SourceFile, root: Path, size: tuple[int, int], link: LinkMode
) -> str:
    if file.resize:
        target = file.target + ".png"
        image = cv2.resize(images.read_color(file.source), size, interpolation=cv2.INTER_AREA)
        images.write_color(root / target, image)  # type: ignore[arg-type]
        return target
    # Decode once, so that a damaged image is found now and not in a later step.
    images.read_color(file.source, size=size)
    target = file.target + file.source.suffix.lower()
    _place(file.source, root / target, link)
    return target


def _write_depth(
    file: importer.SourceFile,
    root: Path,
    size: tuple[int, int],
    scene_scale: float | None,
    link: LinkMode,
) -> tuple[str, float | None]:
    depth = foreign_files.read_foreign_depth(file.source, size=size)
    values: Any = depth.values
    unit = 1.0
    if values.dtype == np.uint16:
        if file.depth_scale is None:
            raise ToolkitError(
                "16-bit depth needs its unit", path=file.source, hint="give --depth-scale"
            )
        unit = file.depth_scale
    measured = values[values > 0]
    median = float(np.median(measured)) * unit if measured.size else None
    if values.dtype == np.uint16 and unit == scene_scale:
        target = file.target + ".png"
        if depth.converted:
            images.write_png(root / target, values)
        else:
            _place(file.source, root / target, link)
    else:
        # Another unit than the scene's would require rounding; EXR avoids it.
        target = file.target + ".exr"
        metres = values if unit == 1.0 else values.astype(np.float32) * np.float32(unit)
        exr.write_exr(root / target, {"Y": metres})
    return target, median


def _write_reference(
    file: importer.SourceFile, root: Path, size: tuple[int, int], link: LinkMode
) -> None:
    target = root / (file.target + file.source.suffix.lower())
    if file.kind == "color":
        _write_color(file, root, size, link)
    elif file.kind == "depth":
        own = size if file.same_size else images.image_size(file.source)
        depth = foreign_files.read_foreign_depth(file.source, size=own)
        metres = depth.values
        if metres.dtype == np.uint16:
            metres = metres.astype(np.float32) * np.float32(file.depth_scale or 0.001)
        exr.write_exr(target.with_suffix(".exr"), {"Y": metres})
    elif file.kind == "mask":
        mask = foreign_files.read_mask_source(file.source, size=size if file.same_size else None)
        if file.binary:
            mask = (mask > 0).astype(np.uint8)
        if file.background is not None:
            mask = np.where(mask == file.background, np.zeros((), mask.dtype), mask)
        images.write_png(target.with_suffix(".png"), mask)
    else:
        if file.source.suffix.lower() == ".png":
            images.read_png(file.source, size=size if file.same_size else None)
        _place(file.source, target, link)


def _place(source: Path, target: Path, link: LinkMode) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    source = source.resolve()
    if link == "hard":
        try:
            target.hardlink_to(source)
        except OSError as error:
            if error.errno not in (errno.EXDEV, errno.EPERM, errno.EMLINK, errno.EACCES):
                raise
            target.symlink_to(source)
    elif link == "sym":
        target.symlink_to(source)
    else:
        shutil.copyfile(source, target)
        with target.open("rb") as file:
            os.fsync(file.fileno())


def _check_depth_unit(recording: importer.Recording, written: list[WrittenFrame]) -> None:
    medians = [w.depth_median_m for w in written if w.depth_median_m is not None]
    sources = [f.depth.source for f in recording.frames if f.depth is not None]
    if not sources:
        return
    if not medians:
        raise ToolkitError("no depth image has a measurement", path=sources[0].parent)
    foreign_files.check_unit(
        float(np.median(medians)),
        path=sources[0].parent,
        depth_scale=recording.depth_scale,
        by_flag=recording.source == "import:folder",
    )
    for row in written:
        if row.depth_median_m is not None and row.depth_median_m > _FARTHEST_FRAME_M:
            raise ToolkitError(
                "the median depth of one frame is implausible: is it in another unit?",
                field=f"frame {row.frame.name}",
                value=f"{row.depth_median_m:.4g} m",
            )
    empty = [w.frame.name for w in written if w.has_depth and w.depth_median_m is None]
    if empty:
        logger.warning("depth is empty in %d frames: %s", len(empty), ", ".join(empty[:5]))


def _write_models(recording: importer.Recording, root: Path) -> None:
    for model in recording.models:
        foreign_files.write_mesh(root / model.model.mesh, model.mesh)


def import_recording(
    request: ImportRequest,
    out: Path | str,
    *,
    format_name: str | None = None,
    link: LinkMode = "copy",
    options: JobOptions | None = None,
) -> Scene:
    """Import a recording as the new scene `out`.

    Args:
        request: recording to read.
        out: scene folder; must not exist or be empty. It is created when all files are written.
        format_name: name of the importer; None detects it from the layout, and reads separate
            colour images as "folder".
        link: see `write_recording`.
        options: where the frames are processed.

    Raises:
        ToolkitError: the recording or the flags are wrong; no files remain.
    """
    out = Path(out)
    atomic.check_vacant(out)
    if request.depth_scale is not None and not 0 < request.depth_scale <= 1:
        raise ToolkitError(
            "must be metres per unit of the depth images, above 0 and at most 1",
            field="--depth-scale",
            value=request.depth_scale,
            hint="millimetres: 0.001",
        )
    if not 0.8 < request.depth_correction < 1.25:
        raise ToolkitError(
            "must be between 0.8 and 1.25",
            field="--depth-correction",
            value=request.depth_correction,
            hint="give a calibrated factor such as 0.98; --depth-scale sets the unit",
        )
    if format_name is None:
        separate = request.color is not None and not is_ros_recording(request.source)
        format_name = "folder" if separate else importer.detect_format(request.source)
    with ExitStack() as stack:
        if format_name == "ros":
            workspace = stack.enter_context(atomic.temporary_folder(out))
            request, link = replace(request, workspace=workspace), "hard"
        recording = importer.IMPORTERS.get(format_name).read(request)
        return write_recording(
            recording, out, name=request.name, link=link, options=options, known=request.known
        )
