"""Files of one imported frame: checked, converted where needed, else copied or linked."""

import errno
import filecmp
import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, Undistortion
from std_toolkit.importers import foreign_files, importer
from std_toolkit.importers.depth_files import Missing, read_foreign_depth
from std_toolkit.io import exr, images
from std_toolkit.io.tiff import TIFF_SUFFIXES, read_tiff, tiff_size
from std_toolkit.options import LinkMode
from std_toolkit.scene import Frame


@dataclass(frozen=True)
class WrittenFrame:
    """Result of one frame: its row, and the median of its measured depth in metres."""

    frame: Frame
    depth_median_m: float | None
    has_depth: bool


def write_frame(
    frame: importer.SourceFrame,
    *,
    root: Path,
    cameras: dict[str, Camera],
    undistortions: dict[str, Undistortion],
    depth_scale: float | None,
    link: LinkMode,
    missing: Missing | None = None,
) -> WrittenFrame:
    """Check the images of a frame and write them into the scene.

    Args:
        frame: files to write.
        root: folder of the scene.
        cameras: of the recorded images.
        undistortions: by camera id, of those whose images are undistorted.
        depth_scale: metres per unit of the scene's 16-bit depth.
        link: "copy" images, or "hard"- or "sym"-link those that need no conversion.
        missing: which numbers of the depth are no measurement.

    Raises:
        ToolkitError: an image is damaged, has another size, or depth has no unit.
    """
    size = cameras[frame.camera].size
    lens = undistortions.get(frame.camera)
    color = _write_color(frame.color, root, size, link, lens)
    depth = None
    median: float | None = None
    if frame.depth is not None:
        depth, median = _write_depth(frame.depth, root, size, depth_scale, link, lens, missing)
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
    file: importer.SourceFile,
    root: Path,
    size: tuple[int, int],
    link: LinkMode,
    lens: Undistortion | None = None,
) -> str:
    is_tiff = file.source.suffix.lower() in TIFF_SUFFIXES
    if file.resize or lens is not None or is_tiff:
        target = file.target + ".png"
        wanted = None if file.resize else size
        image: Any = (
            _grey_tiff(file.source, wanted)
            if is_tiff
            else images.read_color(file.source, size=wanted)
        )
        if file.resize:
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        if lens is not None:
            image = lens.image(image)
        images.write_color(root / target, image)
        return target
    # Decode once, so that a damaged image is found now and not in a later step.
    images.read_color(file.source, size=size)
    target = file.target + file.source.suffix.lower()
    place_file(file.source, root / target, link)
    return target


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) of a PNG, JPEG, EXR or TIFF from its header.

    Raises:
        ToolkitError: it is none of them, or damaged.
    """
    return tiff_size(path) if path.suffix.lower() in TIFF_SUFFIXES else images.image_size(path)


def _grey_tiff(path: Path, size: tuple[int, int] | None) -> Any:
    """(H, W, 3) of a TIFF of 8 bits, in which BOP's data set ITODD has its grey images."""
    grey = read_tiff(path)
    if grey.dtype != np.uint8:
        raise ToolkitError("colour must be 8-bit", path=path, value=str(grey.dtype))
    if size is not None and (grey.shape[1], grey.shape[0]) != size:
        raise ToolkitError(
            f"image size differs from that of the camera, {size[0]}x{size[1]}", path=path,
            value=f"{grey.shape[1]}x{grey.shape[0]}",
        )  # fmt: skip
    return np.repeat(grey[..., None], 3, axis=2)


def _write_depth(
    file: importer.SourceFile,
    root: Path,
    size: tuple[int, int],
    scene_scale: float | None,
    link: LinkMode,
    lens: Undistortion | None = None,
    missing: Missing | None = None,
) -> tuple[str, float | None]:
    if missing is not None:  # files of one recording may have several units
        missing = replace(missing, unit=file.depth_scale)
    depth = read_foreign_depth(file.source, size=size, missing=missing, two_bytes=file.two_bytes)
    values: Any = depth.values if lens is None else lens.depth(depth.values)
    unit = 1.0 if missing is None else missing.float_unit
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
        if depth.converted or lens is not None:
            images.write_png(root / target, values)
        else:
            place_file(file.source, root / target, link)
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
        depth = read_foreign_depth(file.source, size=own)
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
        place_file(file.source, target, link)


def place_file(source: Path, target: Path, link: LinkMode) -> None:
    """Copy or link a file to a new place; where hard links cannot be, they are symbolic.

    Raises:
        ToolkitError: the copy differs from its source.
    """
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
        if not filecmp.cmp(source, target, shallow=False):
            raise ToolkitError("the copy differs from its source", path=source, hint="disk full?")
        with target.open("rb") as file:
            os.fsync(file.fileno())
