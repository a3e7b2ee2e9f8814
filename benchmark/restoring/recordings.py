"""Frames of a recording: scenes, folders of images, data sets, files of ROS and librealsense."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.restoring.kept_scenes import imported_scene, unpacked_scene
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, Undistortion
from std_toolkit.geometry.se3 import SE3
from std_toolkit.importers.depth_files import DEPTH_SUFFIXES, Missing, read_foreign_depth
from std_toolkit.importers.depth_survey import (
    DepthFile,
    UnitOrigin,
    given_marks,
    survey_depth,
    with_unit_asked,
)
from std_toolkit.importers.foreign_files import is_ros_recording
from std_toolkit.importers.importer import (
    Recording,
    SourceFile,
    detect_format,
    read_recording,
)
from std_toolkit.importers.intrinsics import parse_distortion, read_intrinsics, with_distortion
from std_toolkit.importers.options import ImageOptions, ImportRequest, check_depth_numbers
from std_toolkit.io.images import COLOR_SUFFIXES, image_size, read_color
from std_toolkit.log import logger
from std_toolkit.scene.document import safe_name

# Read beside color/ and depth/ if no --intrinsics are given.
INTRINSICS = "intrinsics.json"
_OF_LIBREALSENSE = (".bag", ".db3")


@dataclass(frozen=True)
class FrameFiles:
    """Files of a frame.

    Attributes:
        name: of the frame, usable as the name of a file.
        color, depth: images; `color` is resized to the camera's size if `resize`.
        camera: intrinsics at the size of `depth`.
        scale: metres per unit of a 16-bit depth image.
        correction: factor of the depth, from a calibration.
        undistortion: of both images to `camera`, if they are recorded through another lens.
        missing: which numbers of the depth are no measurement.
        two_bytes: whether the depth may have two bytes in colours.
        T_world_cam: pose of the camera, metres; None if nobody knows it.
    """

    name: str
    color: Path
    depth: Path
    camera: Camera
    scale: float | None
    correction: float = 1.0
    resize: bool = False
    undistortion: Undistortion | None = None
    missing: Missing = field(default_factory=Missing)
    two_bytes: bool = False
    T_world_cam: SE3 | None = None

    def read(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Read (h, w, 3) RGB and (h, w) metres, 0 where the sensor measured nothing.

        Raises:
            ToolkitError: a file is missing, damaged or of another size.
        """
        size = self.camera.size
        color = read_color(self.color, size=None if self.resize else size)
        if self.resize and (color.shape[1], color.shape[0]) != size:
            color = cv2.resize(color, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
        missing = replace(self.missing, unit=self.scale)
        stored = read_foreign_depth(
            self.depth, size=size, missing=missing, two_bytes=self.two_bytes
        ).values
        unit = (missing.unit_of(stored) or 1.0) * self.correction
        depth = stored.astype(np.float32)
        if self.undistortion is not None:
            color = self.undistortion.image(color)  # type: ignore[assignment]
            depth = self.undistortion.depth(depth)  # type: ignore[assignment]
        return color, depth * np.float32(unit)

    @property
    def unit(self) -> float:
        """Metres per number in a 16-bit depth image."""
        return (self.scale or 1.0) * self.correction

    @property
    def is_png(self) -> bool:
        return self.depth.suffix.lower() == ".png"


@dataclass(frozen=True)
class RecordingFiles:
    """A recording.

    Attributes:
        name: of its folder of results, where there are several.
        source: as the user gave it.
        frames: in the order of recording.
        unit_origin: who states the unit of depth.
    """

    name: str
    source: str
    frames: tuple[FrameFiles, ...]
    unit_origin: UnitOrigin = "format"


def open_recordings(
    sources: Sequence[Path], images: ImageOptions, out: Path
) -> list[RecordingFiles]:
    """Find the frames of all recordings.

    Args:
        sources: folders and files; none if `images` names colour and depth.
        images: where and how images are read.
        out: folder of results; files of librealsense are unpacked there.

    Raises:
        ToolkitError: a recording is missing, incomplete or has no depth, or two have one name.
    """
    check_depth_numbers(images)
    if not sources:
        found = [_undistorted(_images(images), images)]
    elif (images.color or images.depth) and not all(map(is_ros_recording, sources)):
        raise ToolkitError(
            "give either SOURCES or --color and --depth", field="--color", hint="not both"
        )
    else:
        found = [_recording(source, images, out) for source in sources]
    for recording in found:
        if not recording.frames:
            raise ToolkitError("no frame has sensor depth", path=recording.source)
    found = [_surveyed(recording, images) for recording in found]
    names = [recording.name for recording in found]
    if twice := next((n for i, n in enumerate(names) if n in names[:i]), None):
        raise ToolkitError(
            "two recordings have this name", value=twice, hint="restore them one by one"
        )
    return found


def _recording(source: Path, images: ImageOptions, out: Path) -> RecordingFiles:
    if not source.exists():
        raise ToolkitError("no such file or folder", path=source)
    if is_ros_recording(source):
        return _of_scene(imported_scene(source, images, out), source)  # undistorted by the import
    return _undistorted(_folder_or_file(source, images, out), images)


def _folder_or_file(source: Path, images: ImageOptions, out: Path) -> RecordingFiles:
    if source.is_file() and source.suffix.lower() in _OF_LIBREALSENSE:
        _refuse_options(images, source)
        return _of_scene(unpacked_scene(source, out), source)
    if source.is_file():
        raise ToolkitError(
            "not a recording that std-restore reads",
            path=source,
            hint=".mcap, .bag, .db3, or folders; one image: --color FILE --depth FILE",
        )
    if (source / "scene.json").is_file():
        _refuse_options(images, source)
        return _of_scene(source, source)
    name = safe_name(source.resolve().name)
    if (source / "color").is_dir() and (source / "depth").is_dir():
        folders = replace(images, color=str(source / "color"), depth=str(source / "depth"))
        if images.intrinsics is None and (source / INTRINSICS).is_file():
            folders = replace(folders, intrinsics=str(source / INTRINSICS))
        return replace(_images(folders), name=name, source=str(source))
    if any(list(source.glob(f"*/{kind}"))[:1] for kind in ("scene.json", "color")):
        raise ToolkitError(
            "holds recordings and is none itself", path=source, hint=f"give them: {source}/*"
        )
    try:
        kind = detect_format(source)
    except ToolkitError as error:
        raise ToolkitError(
            "no recording here: neither a scene.json nor the folders color/ and depth/",
            path=source,
            hint="for other names give --color DIR --depth DIR --intrinsics FILE",
        ) from error
    request = ImportRequest(source=source, name=name, **vars(images))
    return _files(read_recording(kind, request), name, str(source))


def _images(images: ImageOptions) -> RecordingFiles:
    """Separate images; an image by its name, or a folder, or a pattern."""
    assert images.color is not None and images.depth is not None
    color, depth = Path(images.color), Path(images.depth)
    name = safe_name(color.resolve().parent.name or "images")
    if color.is_file() or depth.is_file():
        pair, origin = _pair(color, depth, images)
        return RecordingFiles(name, images.color, (pair,), origin)
    request = ImportRequest(source=color, name=name, **vars(images))
    return _files(read_recording("folder", request), name, images.color)


def _pair(color: Path, depth: Path, images: ImageOptions) -> tuple[FrameFiles, UnitOrigin]:
    """The frame of two images, and who states the unit of its depth."""
    for path, kinds in ((color, COLOR_SUFFIXES), (depth, DEPTH_SUFFIXES)):
        if not path.is_file():
            raise ToolkitError(
                "no such image", path=path, hint="--color and --depth: both images, or both folders"
            )
        if path.suffix.lower() not in kinds:
            raise ToolkitError("not an image of this kind", path=path, hint=", ".join(kinds))
    if images.intrinsics is None:
        raise ToolkitError(
            "colour images need intrinsics",
            path=color,
            hint="give --intrinsics FILE or --intrinsics fx,fy,cx,cy",
        )
    size = image_size(color)
    intrinsics = with_distortion(
        read_intrinsics(images.intrinsics, size=size, camera=images.camera), images.distortion
    )
    frame = FrameFiles(
        safe_name(color.stem),
        color,
        depth,
        intrinsics.camera(size, path=images.intrinsics, off_centre=images.off_centre),
        images.depth_scale or intrinsics.depth_scale or 0.001,
        images.depth_correction,
    )
    return frame, "guess" if intrinsics.depth_scale is None else "file"


def _undistorted(recording: RecordingFiles, images: ImageOptions) -> RecordingFiles:
    """The recording with the undistortion that each camera needs; see `Undistortion.of`.

    Coefficients that the user gives are taken out of the images, at the same focal length.

    Raises:
        ToolkitError: no such pinhole, or several cameras that need it.
    """
    found = {f.camera: Undistortion.of(f.camera, images.undistort_fov) for f in recording.frames}
    if images.distortion is not None:
        for camera in [c for c, undistortion in found.items() if undistortion is None]:
            found[camera] = _undistortion(camera, recording.source, images.distortion)
    needed = [undistortion for undistortion in found.values() if undistortion is not None]
    if not needed:
        return recording
    if len(found) > 1:
        raise ToolkitError(
            "images of several cameras with distortion cannot be undistorted in one folder",
            path=recording.source,
            value=[f"{u.recorded.width}x{u.recorded.height}" for u in needed],
            hint="restore the images of each camera as a recording of its own",
        )
    logger.info("%s: %s", recording.source, needed[0])
    frames = (replace(f, camera=needed[0].camera, undistortion=needed[0]) for f in recording.frames)
    return replace(recording, frames=tuple(frames))


def _undistortion(camera: Camera, source: str, given: str) -> Undistortion | None:
    """The undistortion of images through a lens whose coefficients the user gives."""
    wanted, known = (_significant(k) for k in (parse_distortion(given), camera.distortion))
    if wanted != known:
        raise ToolkitError(
            "is not the lens of this recording's camera",
            path=source,
            field="--distortion",
            value=given,
            hint=f"it has its own: {','.join(f'{k:g}' for k in known) or 'without distortion'}",
        )
    return Undistortion(camera, camera.without_distortion()) if known else None


def _significant(coefficients: Sequence[float]) -> tuple[float, ...]:
    """Coefficients without the zeros at the end."""
    last = max((i for i, k in enumerate(coefficients) if k), default=-1)
    return tuple(float(k) for k in coefficients[: last + 1])


def _files(recording: Recording, name: str, source: str) -> RecordingFiles:
    def frame(title: str, color: SourceFile, depth: SourceFile, camera: Camera) -> FrameFiles:
        scale, correction = depth.depth_scale, recording.depth_correction
        return FrameFiles(
            title, color.source, depth.source, camera, scale, correction, color.resize,
            two_bytes=depth.two_bytes,
        )  # fmt: skip

    return RecordingFiles(
        name,
        source,
        tuple(
            frame(f.name, f.color, f.depth, recording.cameras[f.camera])
            for f in recording.frames
            if f.depth is not None
        ),
        recording.unit_origin,
    )


def _of_scene(root: Path, source: Path) -> RecordingFiles:
    from std_toolkit.scene.scene import Scene

    scene = Scene.open(root)
    info = scene.info
    lost = [f.name for f in scene.frames if f.depth is None]
    if lost and len(lost) < len(scene.frames):
        logger.warning("%s: %d frames without depth are left out", source, len(lost))
    return RecordingFiles(
        safe_name(source.resolve().stem if source.is_file() else source.resolve().name),
        str(source),
        tuple(
            FrameFiles(
                f.name,
                scene.color_path(f),
                root / f.depth,
                scene.camera(f),
                info.depth_scale,
                info.depth_correction,
                T_world_cam=scene.T_world_cam(f.id),
            )
            for f in scene.frames
            if f.depth is not None
        ),
    )


def _refuse_options(images: ImageOptions, source: Path) -> None:
    """Refuse options of images for a recording that says the same itself.

    Raises:
        ToolkitError: names the first one that was given.
    """
    plain = ImageOptions()
    for name in ("intrinsics", "depth_scale", "depth_correction"):
        if getattr(images, name) != getattr(plain, name):
            raise ToolkitError(
                "the recording has its own", path=source, field=f"--{name.replace('_', '-')}",
                value=getattr(images, name), hint="leave it out",
            )  # fmt: skip


def _surveyed(recording: RecordingFiles, images: ImageOptions) -> RecordingFiles:
    """The recording with what means "no measurement", as `std-curate import` finds it.

    Raises:
        ToolkitError: the unit of the depth is implausible.
    """

    def looked(scale: float | None) -> RecordingFiles:
        frames = recording.frames
        if scale is not None:
            frames = tuple(replace(f, scale=scale) for f in frames)
        survey = survey_depth(
            [
                DepthFile(
                    f.depth,
                    f.undistortion.recorded.size if f.undistortion else f.camera.size,
                    f.scale,
                    f.two_bytes,
                )
                for f in frames
            ],
            origin="flag" if scale or images.depth_scale else recording.unit_origin,
            stated=scale or images.depth_scale,
            marks=given_marks(images.missing),
            correction=frames[0].correction,
        )
        survey.log(recording.source)
        return replace(recording, frames=tuple(replace(f, missing=survey.missing) for f in frames))

    return with_unit_asked(looked)
