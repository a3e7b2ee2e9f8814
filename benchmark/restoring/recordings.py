"""Frames of a recording: scenes, folders of images, data sets, files of ROS and librealsense."""

import logging
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, Undistortion
from std_toolkit.importers.foreign_files import (
    DEPTH_SUFFIXES,
    check_unit,
    is_ros_recording,
    read_foreign_depth,
)
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.importer import IMPORTERS, Recording, SourceFile, detect_format
from std_toolkit.importers.intrinsics import read_intrinsics, with_distortion
from std_toolkit.importers.options import ImageOptions, ImportRequest
from std_toolkit.io.atomic import hold_lock
from std_toolkit.io.documents import digest_file, digest_files, digest_of, write_document
from std_toolkit.io.images import COLOR_SUFFIXES, image_size, read_color
from std_toolkit.jobs.artefact import Artefact, Record
from std_toolkit.log import logger
from std_toolkit.scene.document import safe_name

# Read beside color/ and depth/ if no --intrinsics are given.
INTRINSICS = "intrinsics.json"
_OF_LIBREALSENSE = (".bag", ".db3")
# Frames whose unit of depth is checked before the work begins.
_CHECKED = 5


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
    """

    name: str
    color: Path
    depth: Path
    camera: Camera
    scale: float | None
    correction: float = 1.0
    resize: bool = False
    undistortion: Undistortion | None = None

    def read(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Read (h, w, 3) RGB and (h, w) metres, 0 where the sensor measured nothing.

        Raises:
            ToolkitError: a file is missing, damaged or of another size.
        """
        size = self.camera.size
        color = read_color(self.color, size=None if self.resize else size)
        if self.resize and (color.shape[1], color.shape[0]) != size:
            color = cv2.resize(color, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
        depth = read_foreign_depth(self.depth, size=size).values.astype(np.float32)
        if self.undistortion is not None:
            color = self.undistortion.image(color)  # type: ignore[assignment]
            depth = self.undistortion.depth(depth)  # type: ignore[assignment]
        return color, depth * np.float32(self.unit)

    @property
    def unit(self) -> float:
        """Metres per number in the depth image."""
        return (self.scale if self.is_png and self.scale else 1.0) * self.correction

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
    """

    name: str
    source: str
    frames: tuple[FrameFiles, ...]


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
    if not sources:
        found = [_undistorted(_images(images), images.undistort_fov)]
    elif (images.color or images.depth) and not all(map(is_ros_recording, sources)):
        raise ToolkitError(
            "give either SOURCES or --color and --depth", field="--color", hint="not both"
        )
    else:
        found = [_recording(source, images, out) for source in sources]
    for recording in found:
        if not recording.frames:
            raise ToolkitError("no frame has sensor depth", path=recording.source)
        _check_unit(recording)
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
        return _of_scene(_imported(source, images, out), source)  # undistorted by the import
    return _undistorted(_folder_or_file(source, images, out), images.undistort_fov)


def _folder_or_file(source: Path, images: ImageOptions, out: Path) -> RecordingFiles:
    if source.is_file() and source.suffix.lower() in _OF_LIBREALSENSE:
        _refuse_options(images, source)
        return _of_scene(_unpacked(source, out), source)
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
    return _files(IMPORTERS.get(kind).read(request), name, str(source))


def _images(images: ImageOptions) -> RecordingFiles:
    """Separate images; an image by its name, or a folder, or a pattern."""
    assert images.color is not None and images.depth is not None
    color, depth = Path(images.color), Path(images.depth)
    name = safe_name(color.resolve().parent.name or "images")
    if color.is_file() or depth.is_file():
        return RecordingFiles(name, images.color, (_pair(color, depth, images),))
    request = ImportRequest(source=color, name=name, **vars(images))
    return _files(IMPORTERS.get("folder").read(request), name, images.color)


def _pair(color: Path, depth: Path, images: ImageOptions) -> FrameFiles:
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
    intrinsics = with_distortion(read_intrinsics(images.intrinsics, size=size), images.distortion)
    return FrameFiles(
        safe_name(color.stem),
        color,
        depth,
        intrinsics.camera(size, path=images.intrinsics, off_centre=images.off_centre),
        images.depth_scale or 0.001,
        images.depth_correction,
    )


def _undistorted(recording: RecordingFiles, fov_deg: float | None) -> RecordingFiles:
    """The recording with the undistortion that each camera needs; see `Undistortion.of`.

    Raises:
        ToolkitError: no such pinhole, or several cameras that need it.
    """
    found = {f.camera: Undistortion.of(f.camera, fov_deg) for f in recording.frames}
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


def _files(recording: Recording, name: str, source: str) -> RecordingFiles:
    def frame(title: str, color: SourceFile, depth: SourceFile, camera: Camera) -> FrameFiles:
        scale, correction = depth.depth_scale, recording.depth_correction
        return FrameFiles(
            title, color.source, depth.source, camera, scale, correction, color.resize
        )

    return RecordingFiles(
        name,
        source,
        tuple(
            frame(f.name, f.color, f.depth, recording.cameras[f.camera])
            for f in recording.frames
            if f.depth is not None
        ),
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
            )
            for f in scene.frames
            if f.depth is not None
        ),
    )


def _imported(source: Path, images: ImageOptions, out: Path) -> Path:
    """The scene that `std-curate import` makes of a recording of ROS."""

    def make(scene: Path) -> None:
        request = ImportRequest(source=source, name=scene.name, **vars(images))
        import_recording(request, scene, format_name="ros")

    inputs = {"recording": _digest(source)}
    given = Path(images.intrinsics) if images.intrinsics else None
    if given is not None and given.is_file():
        inputs["intrinsics"] = digest_file(given)
    view = "" if images.undistort_fov is None else f"-fov{images.undistort_fov:g}"
    scene = out / "recordings" / safe_name(source.stem + view)
    return _kept_scene(scene, inputs, asdict(images), make)


def _unpacked(source: Path, out: Path) -> Path:
    """The scene that `std-record` makes of a file."""

    def make(scene: Path) -> None:
        unfinished = scene.with_name(f".{scene.name}.unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.parent.mkdir(parents=True, exist_ok=True)
        # A program of another package is called, not imported: the benchmark knows no camera.
        words = ["-m", "std_toolkit.cli.programs", "std-record"]
        words += [str(unfinished), "--name", scene.name, "--from"]
        done = subprocess.run(
            [sys.executable, *words, str(source)], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            shutil.rmtree(unfinished, ignore_errors=True)
            lines = [line for line in done.stderr.splitlines() if line.strip()]
            raise ToolkitError(
                f"std-record cannot read it: {lines[-1].removeprefix('error: ') if lines else ''}",
                path=source,
            )
        unfinished.rename(scene)

    scene = out / "recordings" / safe_name(source.stem)
    return _kept_scene(scene, {"recording": digest_file(source)}, {}, make)


def _kept_scene(
    scene: Path,
    inputs: Mapping[str, str],
    options: Mapping[str, Any],
    make: Callable[[Path], None],
) -> Path:
    """A scene made of a file, made again if the file or an option changed.

    Raises:
        ToolkitError: the file cannot be read, or the scene is another process's or a link.
    """
    out = scene.parent.parent
    out.mkdir(parents=True, exist_ok=True)
    with hold_lock(out, "recordings", doing="writing to", what="folder", wait=True):
        record = scene.with_name(f".{scene.name}.json")
        artefact = Artefact(scene, scene.name, inputs, options)
        if artefact.find(record, Record, logging.INFO) is None:
            record.unlink(missing_ok=True)
            shutil.rmtree(scene, ignore_errors=True)
            make(scene)
            made = [p for p in scene.rglob("*") if p.is_file() and ".std" not in p.parts]
            write_document(record, artefact.record(made))
    return scene


def _digest(source: Path) -> str:
    """Digest of a file, or of all files of a folder by their names."""
    if source.is_file():
        return digest_file(source)
    files = sorted(p for p in source.rglob("*") if p.is_file())
    return digest_of(digest_files(source, files), versioned=False)


def _refuse_options(images: ImageOptions, source: Path) -> None:
    """Refuse options of images for a recording that says the same itself.

    Raises:
        ToolkitError: names the first one that was given.
    """
    plain = ImageOptions()
    for name in ("intrinsics", "distortion", "depth_scale", "depth_correction"):
        if getattr(images, name) != getattr(plain, name):
            raise ToolkitError(
                "the recording has its own", path=source, field=f"--{name.replace('_', '-')}",
                value=getattr(images, name), hint="leave it out",
            )  # fmt: skip


def _check_unit(recording: RecordingFiles) -> None:
    """Check the unit of depth on a few frames that can be read.

    Raises:
        ToolkitError: their median depth is implausible.
    """
    step = max(1, len(recording.frames) // _CHECKED)
    for frame in recording.frames[::step][:_CHECKED]:
        try:
            depth = frame.read()[1]
        except ToolkitError:
            continue  # reported with its frame
        measured = depth[depth > 0]
        if len(measured) >= 100:
            scale = frame.scale if frame.is_png else None
            check_unit(float(np.median(measured)), path=frame.depth, depth_scale=scale)
            return
