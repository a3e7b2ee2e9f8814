"""The cameras of separate images: one for all, or those of a source that states one per image.

Phones focus and stabilise while they record: Record3D, ARKit, Polycam and Stray Scanner file
intrinsics for each image, and so may transforms.json.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit import errors, log
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.filed_cameras import camera_of_fields, chosen_camera, filed_cameras
from std_toolkit.geometry.filed_numbers import number
from std_toolkit.geometry.intrinsics import Intrinsics
from std_toolkit.importers.intrinsics import (
    coefficients_of_frames,
    read_intrinsics,
    with_distortion,
)
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.camera_documents import read_camera_document
from std_toolkit.io.regular import read_text
from std_toolkit.scene import Frame
from std_toolkit.scene.document import safe_name

# Images whose intrinsics agree to this share a camera of the scene; corners of a board are found
# to about 0.1 px.
_SAME_PX = 0.05
_LARGEST_PINCAM_BYTES = 4096
_SUFFIXES = (".json", ".pincam", ".yaml", ".yml", ".txt", ".npy")
_FRAME_NAMES = ("file_path", "name", "image", "file", "filename", "frame")


@dataclass(frozen=True, kw_only=True)
class FrameCameras:
    """The cameras of images.

    Attributes:
        cameras: by camera id; "color" is that of the first image.
        of: camera id of each image by its key; empty if all have the camera "color".
        depth_unit: metres per unit of depth images, if the source states it.
    """

    cameras: dict[str, Camera]
    of: dict[str, str] = field(default_factory=dict)
    depth_unit: float | None = None


@dataclass(frozen=True)
class _Rows:
    """Intrinsics of images, as a source lists them; without keys, in the order of the images."""

    path: Path
    lenses: list[Intrinsics | None]
    keys: list[str] | None = None


def frame_cameras(
    request: ImportRequest, frames: Sequence[Frame], keys: Sequence[str], size: tuple[int, int]
) -> FrameCameras:
    """The cameras that the flags and files of a request state.

    Args:
        request: with intrinsics, or with camera poses whose file has them.
        frames: the images, in order.
        keys: the key of each image.
        size: width and height of the images.

    Raises:
        ToolkitError: no intrinsics, or such as do not fit the images or belong to none of them.
    """
    given = request.intrinsics
    rows = _of_poses(request) if given is None else _of_intrinsics(request, frames, size)
    path = str(request.known.cameras) if given is None else given
    if rows is None or not _vary(rows.lenses):
        if given is not None and not Path(given).is_dir():
            found = read_intrinsics(given, size=size, camera=request.camera)
        else:
            assert rows is not None
            found = next(x for x in rows.lenses if x is not None)
            for note in found.notes:
                log.logger.info("%s", note)
        found = with_distortion(found, request.distortion)
        camera = found.camera(size, path=path, off_centre=request.off_centre)
        return FrameCameras(cameras={"color": camera}, depth_unit=found.depth_scale)
    lenses = [with_distortion(x, request.distortion) for x in _of_images(rows, frames)]
    cameras: dict[str, Camera] = {}
    known: dict[Camera, str] = {}
    ids, farthest, last = [], 0.0, ""
    for lens in lenses:
        camera = lens.camera(size, path=path, off_centre=request.off_centre)
        same = known.get(camera) or (last if last and _shift(cameras[last], camera) <= _SAME_PX
                                     else None)  # fmt: skip
        last = same or (f"color_{len(cameras)}" if cameras else "color")
        cameras.setdefault(last, camera)
        known[camera] = last
        ids.append(last)
        farthest = max(farthest, _shift(cameras["color"], camera))
    log.logger.info(
        "%s: the intrinsics change from image to image, by up to %.2g px at the border: %d cameras",
        rows.path, farthest, len(cameras),
    )  # fmt: skip
    return FrameCameras(
        cameras=cameras,
        of=dict(zip(keys, ids, strict=True)),
        depth_unit=next((x.depth_scale for x in lenses if x.depth_scale is not None), None),
    )


def _shift(one: Camera, other: Camera) -> float:
    """Pixels by which points at the border and in the centre move between two cameras."""
    w, h = one.size
    grid = np.array([(u, v) for v in (0, h / 2, h - 1) for u in (0, w / 2, w - 1)], dtype=float)
    moved = other.project(one.unproject(grid)) - grid
    return float(np.nanmax(np.linalg.norm(moved, axis=1), initial=0.0))


def _vary(lenses: Sequence[Intrinsics | None]) -> bool:
    return len({x for x in lenses if x is not None}) > 1


def _of_images(rows: _Rows, frames: Sequence[Frame]) -> list[Intrinsics]:
    """Intrinsics of each image; those of the nearest one where an image has none."""
    from std_toolkit.poses.camera_table import FiledCameras
    from std_toolkit.poses.frame_matching import match_frames

    keys = rows.keys
    if keys is None and len(rows.lenses) != len(frames):
        keys = [str(i) for i in range(len(rows.lenses))]
    listed = FiledCameras(
        path=rows.path,
        kind="intrinsics",
        matrices=np.tile(np.eye(4), (len(rows.lenses), 1, 1)),
        keys=keys,
        lost=frozenset(i for i, x in enumerate(rows.lenses) if x is None),
    )
    row = match_frames(listed, frames, what="intrinsics")
    have = np.array([i for i, f in enumerate(frames) if f.id in row])
    if len(have) < len(frames):
        log.logger.warning(
            "%s has no intrinsics of %d of %d images: those of the nearest image are taken",
            rows.path, len(frames) - len(have), len(frames), extra={"doctor": "guessed"},
        )  # fmt: skip
    nearest = [frames[int(have[np.abs(have - i).argmin()])].id for i in range(len(frames))]
    found = [rows.lenses[row[f]] for f in nearest]
    return [x for x in found if x is not None]


def _of_poses(request: ImportRequest) -> _Rows:
    """Intrinsics in the file of known cameras."""
    from std_toolkit.poses.camera_file import read_cameras

    path = request.known.cameras
    assert path is not None
    filed = read_cameras(path)
    if filed.lens_problem is not None:
        raise filed.lens_problem
    if not any(filed.lenses):
        raise errors.ToolkitError(
            "the file of camera poses has no intrinsics",
            path=path,
            hint="give --intrinsics FILE or --intrinsics fx,fy,cx,cy",
        )
    return _Rows(path, list(filed.lenses), filed.keys)


def _of_intrinsics(
    request: ImportRequest, frames: Sequence[Frame], size: tuple[int, int]
) -> _Rows | None:
    """Intrinsics of each image in a file or a folder; None if it states one camera."""
    assert request.intrinsics is not None
    path = Path(request.intrinsics)
    names = {Path(f.color).stem.lower() for f in frames} | {f.name.lower() for f in frames}
    if path.is_dir():
        found = [p for p in sorted(path.iterdir()) if p.suffix.lower() in _SUFFIXES]
        if not any(safe_name(p.stem).lower() in names for p in found):
            raise errors.ToolkitError(
                "no file of intrinsics in this folder has the name of an image",
                path=path, hint="give the file, or --intrinsics fx,fy,cx,cy",
            )  # fmt: skip
    elif not path.is_file():
        return None
    elif safe_name(path.stem).lower() in names:
        # Of one image: those of the others are beside it.
        beside = (p for p in path.parent.iterdir() if p.suffix == path.suffix)
        found = sorted(p for p in beside if safe_name(p.stem).lower() in names)
    else:
        return _in_document(path, size)
    found = [p for p in found if safe_name(p.stem).lower() in names]
    if len(found) == 1 and not path.is_dir():
        return None
    return _Rows(path, [_of_file(p, size, request.camera) for p in found], [p.stem for p in found])


def _of_file(path: Path, size: tuple[int, int], camera: str | None) -> Intrinsics:
    document: Any
    if path.suffix.lower() == ".pincam":
        words = read_text(path, "intrinsics file", _LARGEST_PINCAM_BYTES).split()
        document = dict(zip(("w", "h", "fx", "fy", "cx", "cy"), words, strict=False))
    else:
        document = read_camera_document(path, size)
    cameras = filed_cameras(document, path, size=size, wanted=camera)
    chosen = chosen_camera(cameras, path, camera)
    unit = None if chosen.depth_unit is None else chosen.depth_unit[0]
    return replace(chosen.intrinsics, depth_scale=unit, notes=(f"{path}: {chosen.lens}",))


def _in_document(path: Path, size: tuple[int, int]) -> _Rows | None:
    """Record3D's list of intrinsics, or frames that have their own; None for other documents."""
    if path.suffix.lower() not in (".json", ".yaml", ".yml"):
        return None
    document = read_camera_document(path, size)
    if not isinstance(document, Mapping):
        return None
    key, listed = coefficients_of_frames(document)
    if listed:
        base = chosen_camera(filed_cameras(document, path, size=size), path, None).intrinsics
        lenses = [_coefficients(x, base, path, f"{key}[{i}]") for i, x in enumerate(listed)]
        return _Rows(path, lenses)
    frames = document.get("frames")
    rows = [r for r in frames if isinstance(r, Mapping)] if isinstance(frames, list) else []
    keys = [str(next((r[k] for k in _FRAME_NAMES if k in r), "")) for r in rows]
    if not all(keys) or not any("fl_x" in r or "fx" in r for r in rows):
        return None
    outer = {k: v for k, v in document.items() if k != "frames"}
    lenses = []
    for i, row in enumerate(rows):
        found = camera_of_fields({**outer, **row}, path, name=f"frames[{i}]", size=size)
        lenses.append(replace(found.intrinsics, notes=(f"{path}: {found.lens}",)))
    return _Rows(path, lenses, keys)


def _coefficients(row: Any, base: Intrinsics, path: Path, at: str) -> Intrinsics | None:
    """fx, fy, cx, cy of an image; None where it has none."""
    if row is None or row == []:
        return None
    if not isinstance(row, list) or len(row) != 4:
        raise errors.ToolkitError("must be fx, fy, cx, cy", path=path, field=at, value=row)
    with errors.located(path):
        fx, fy, cx, cy = (number(x, at) for x in row)
    return replace(base, fx=fx, fy=fy, cx=cx, cy=cy)
