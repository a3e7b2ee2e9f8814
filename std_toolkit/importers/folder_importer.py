"""A folder of colour images, and one of aligned depth images, with intrinsics from flags."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.foreign_files import DEPTH_SUFFIXES
from std_toolkit.importers.importer import ImportRequest, Recording, SourceFile, SourceFrame
from std_toolkit.importers.intrinsics import parse_distortion, read_intrinsics
from std_toolkit.importers.pairing import (
    frame_names,
    list_images,
    pair,
    warn_about_gaps,
)
from std_toolkit.io.images import COLOR_SUFFIXES, image_size
from std_toolkit.scene.model import CameraModel

# What RealSense, Kinect and most data sets write; `check_unit` finds out where it is wrong.
DEFAULT_DEPTH_SCALE = 0.001


class FolderImporter:
    """Separate images. Frames are sorted naturally; ids count from 0 in that order."""

    def recognises(self, source: Path) -> bool:  # noqa: ARG002 - any folder could be one
        return False

    def read(self, request: ImportRequest) -> Recording:
        """See `Importer`.

        Raises:
            ToolkitError: images are missing or of different sizes, names do not pair, or the
                intrinsics do not fit.
        """
        where = request.color or str(request.source)
        if request.intrinsics is None:
            raise ToolkitError(
                "colour images need intrinsics",
                path=where,
                hint="give --intrinsics FILE or --intrinsics fx,fy,cx,cy",
            )
        shared = request.depth is not None and _same_folder(where, request.depth)
        color = list_images(where, COLOR_SUFFIXES, role="color", shared=shared)
        depth: dict[str, Path] = {}
        if request.depth is not None:
            depth = list_images(request.depth, DEPTH_SUFFIXES, role="depth", shared=shared)
            depth = pair(color, depth, skip_unpaired=request.skip_unpaired)
            color = {k: p for k, p in color.items() if k in depth}
        size = _common_size(color)
        camera = _camera(request, request.intrinsics, size)
        names = frame_names(list(color))
        warn_about_gaps(list(color))
        scale = request.depth_scale or DEFAULT_DEPTH_SCALE
        frames = tuple(
            SourceFrame(
                id=i,
                name=names[key],
                color=SourceFile(source=path, target=f"color/{names[key]}", kind="color"),
                depth=SourceFile(
                    source=depth[key],
                    target=f"depth/{names[key]}",
                    kind="depth",
                    depth_scale=scale,
                )
                if key in depth
                else None,
            )
            for i, (key, path) in enumerate(color.items())
        )
        has_units = any(p.suffix.lower() == ".png" for p in depth.values())
        return Recording(
            source="import:folder",
            cameras={"color": camera},
            frames=frames,
            depth_scale=scale if has_units else None,
            depth_correction=request.depth_correction,
        )


def _same_folder(color: str, depth: str) -> bool:
    # Patterns choose by themselves.
    return (
        not any(c in color + depth for c in "*?[")
        and Path(color).resolve() == Path(depth).resolve()
    )


def _common_size(color: dict[str, Path]) -> tuple[int, int]:
    first = next(iter(color.values()))
    size = image_size(first)
    for path in color.values():
        if (other := image_size(path)) != size:
            raise ToolkitError(
                f"colour images differ in size: {first.name} is {size[0]}x{size[1]}",
                path=path,
                value=f"{other[0]}x{other[1]}",
                hint="one recording has one camera; import them as separate scenes",
            )
    return size


def _camera(request: ImportRequest, given: str, size: tuple[int, int]) -> CameraModel:
    intrinsics = read_intrinsics(given, size=size)
    if request.distortion is not None:
        intrinsics = replace(intrinsics, distortion=parse_distortion(request.distortion))
    return CameraModel.of(intrinsics.camera(size, path=given, off_centre=request.off_centre))


FOLDER = FolderImporter()
