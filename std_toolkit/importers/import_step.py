"""The import step: selects the importer, reads, writes the scene completely or not at all."""

from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Undistortion
from std_toolkit.importers import foreign_files, importer
from std_toolkit.importers.depth_survey import DepthFile, DepthSurvey, given_marks, survey_depth
from std_toolkit.importers.frame_files import WrittenFrame, write_frame
from std_toolkit.importers.options import ImportRequest, check_depth_numbers
from std_toolkit.io import atomic
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.log import logger
from std_toolkit.options import KnownCameras, LinkMode, PoseOptions
from std_toolkit.scene import CameraModel, Frames, ObjectTable, Scene, SceneInfo
from std_toolkit.scene.document import check_name, check_relative
from std_toolkit.scene.model import RecordedLens

# Below this number of frames, starting worker processes costs more than it saves.
_SERIAL_BELOW = 48

# Lines on cameras; a recording of a phone may have a camera for each image.
_MOST_LINES = 8

# Beyond the range of every RGB-D sensor.
_FARTHEST_FRAME_M = 30.0


def write_recording(
    recording: importer.Recording,
    out: Path,
    *,
    name: str,
    link: LinkMode = "copy",
    options: JobOptions | None = None,
    known: KnownCameras | None = None,
    undistort_fov: float | None = None,
    depth_scale: float | None = None,
    missing: str | None = None,
) -> Scene:
    """Make the scene `out` from a recording.

    Images of lenses that scenes do not keep, such as fisheyes, are undistorted to a pinhole of the
    same size: colour bilinearly, depth by the nearest pixel.

    Args:
        name: name of the scene.
        link: "copy" images, or "hard"- or "sym"-link those that need no conversion.
        options: where the frames are processed.
        known: camera poses from elsewhere, which are checked and added.
        undistort_fov: horizontal field of view of the pinhole, degrees, which undistorts other
            lenses, too; None: see `Undistortion.of`.
        depth_scale: metres per number of the depth images, where the user states it.
        missing: numbers that mean no measurement, where the user states them.

    Raises:
        GuessedUnit: the unit of depth was guessed, and another is more plausible.
        ToolkitError: an image is damaged or has the wrong size, depth is in another unit, or
            `out` exists. No files remain.
    """
    _check_frames(recording)
    undistortions = _undistortions(recording, undistort_fov)
    cameras = {
        key: undistortions[key].camera if key in undistortions else camera
        for key, camera in recording.cameras.items()
    }
    info = SceneInfo(
        name=name,
        cameras={key: CameraModel.of(camera) for key, camera in cameras.items()},
        recorded_lenses={k: RecordedLens.of(u.recorded) for k, u in undistortions.items()}
        or msgspec.UNSET,
        depth_scale=recording.depth_scale,
        depth_correction=recording.depth_correction,
        source=recording.source,
    )
    if options is None and len(recording.frames) < _SERIAL_BELOW:
        options = JobOptions(engine="serial")
    survey = survey_recording(recording, stated=depth_scale, missing=missing)
    if survey is not None:
        survey.log()
    with atomic.new_folder(out) as staging:
        job = partial(
            write_frame,
            root=staging,
            cameras=recording.cameras,
            undistortions=undistortions,
            depth_scale=recording.depth_scale,
            link=link,
            missing=None if survey is None else survey.missing,
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


def _undistortions(recording: importer.Recording, fov_deg: float | None) -> dict[str, Undistortion]:
    """Undistortion of the images by camera id, for the cameras that need one.

    Raises:
        ToolkitError: no such pinhole, or maps of a ground truth that would have to be undistorted.
    """
    found = {
        key: undistortion
        for key, camera in recording.cameras.items()
        if (undistortion := Undistortion.of(camera, fov_deg)) is not None
    }
    for frame in recording.frames:
        if frame.camera in found and frame.reference:
            raise ToolkitError(
                "a recording with ground truth of its own cannot be undistorted",
                path=frame.reference[0].source,
                field=f"camera {frame.camera}",
                value=recording.cameras[frame.camera].model,
            )
    for key, undistortion in list(found.items())[:_MOST_LINES]:
        logger.info("camera %s: %s", key, undistortion)
    if len(found) > _MOST_LINES:
        logger.info("%d more cameras are undistorted", len(found) - _MOST_LINES)
    return found


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


def survey_recording(
    recording: importer.Recording, *, stated: float | None = None, missing: str | None = None
) -> DepthSurvey | None:
    """What the depth images of a recording say; None without depth.

    Raises:
        ToolkitError: as `survey_depth`.
    """
    files = [
        DepthFile(d.source, recording.cameras[f.camera].size, d.depth_scale, d.two_bytes)
        for f in recording.frames
        if (d := f.depth) is not None
    ]
    if not files:
        return None
    return survey_depth(
        files,
        origin="flag" if stated is not None else recording.unit_origin,
        stated=stated,
        marks=given_marks(missing),
        correction=recording.depth_correction,
        source=recording.depth_name or None,
    )


def _check_depth_unit(recording: importer.Recording, written: list[WrittenFrame]) -> None:
    sources = [f.depth.source for f in recording.frames if f.depth is not None]
    if not sources:
        return
    if all(w.depth_median_m is None for w in written):
        raise ToolkitError("no depth image has a measurement", path=sources[0].parent)
    for row in written if recording.unit_origin != "flag" else ():
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
    check_depth_numbers(request)
    if format_name is None:
        format_name = importer.format_of(request)
    with ExitStack() as stack:
        if importer.needs_workspace(format_name, request.source):
            workspace = stack.enter_context(atomic.temporary_folder(out))
            request = replace(request, workspace=workspace)
            # Files of the workspace may be taken; those of BOP may be links to the user's.
            link = "hard" if format_name == "ros" else "copy"
        recording = importer.read_recording(format_name, request)
        return write_recording(
            recording,
            out,
            name=request.name,
            link=link,
            options=options,
            known=request.known,
            undistort_fov=request.undistort_fov,
            depth_scale=request.depth_scale,
            missing=request.missing,
        )
