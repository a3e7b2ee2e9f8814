"""The photos of a scan: of a folder or an RGB-D scene, reduced, their sharpness and cameras."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, undistort_image
from std_toolkit.io.documents import digest_file
from std_toolkit.io.images import COLOR_SUFFIXES, image_size, read_color, write_color
from std_toolkit.log import logger
from std_toolkit.options import KnownCameras
from std_toolkit.poses.features import FrameMeasure, measure_image
from std_toolkit.scanning.photos.photo_file import (
    PHOTO_SUFFIXES,
    PhotoHeader,
    read_photo,
    read_photo_header,
)
from std_toolkit.scanning.photos.video import PHOTOS, spread
from std_toolkit.scanning.photos.views import View
from std_toolkit.scene import Frame, Scene
from std_toolkit.settings import NOT_RECORDED, Settings, limit


@dataclass(frozen=True, kw_only=True)
class PhotoSettings(Settings):
    """Photos that a scan uses."""

    fewest_photos: int = limit(8, source=NOT_RECORDED)
    """a scan needs at least this many photos"""
    usual_photos: int = limit(24, source=NOT_RECORDED)
    """fewer photos bring a warning"""
    blurred: float = limit(0.2, source=NOT_RECORDED)
    """photos whose sharpness is below this share of the median are left out"""


@dataclass(frozen=True, eq=False)
class Sensor:
    """The depth sensor of an RGB-D scene.

    Attributes:
        scene: the scene.
        frames: that of each photo.
    """

    scene: Scene
    frames: tuple[Frame, ...]

    def camera(self, size: tuple[int, int]) -> Camera:
        """Intrinsics of the photos at this size."""
        return self.scene.camera(self.frames[0]).resized(*size)

    def depth(self, index: int, size: tuple[int, int]) -> NDArray[np.float32] | None:
        """z-depth (H, W) of a photo at this size, metres, 0 for none; None without depth."""
        depth = self.scene.read_depth(self.frames[index])
        if depth is None:
            return None
        return cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST).astype(np.float32)

    def paths(self) -> list[Path]:
        """The files of depth."""
        return [self.scene.root / f.depth for f in self.frames if f.depth is not None]


@dataclass(frozen=True)
class Photos:
    """Photos of one camera, or of several sizes and lenses.

    Attributes:
        paths: as given.
        used: the files that are read: `paths`, or copies that are upright and reduced.
        size: (width, height) of `used`, of the first photo.
        factor: size of `used` over that of `paths`, of the first photo.
        sensor: of an RGB-D scene.
        groups: number of the camera of each photo: photos of one size, lens and orientation have
            the same; empty if all have.
        sizes, headers: of each photo; empty if all are as the first.
    """

    paths: tuple[Path, ...]
    used: tuple[Path, ...]
    size: tuple[int, int]
    factor: float
    sensor: Sensor | None = None
    groups: tuple[int, ...] = ()
    sizes: tuple[tuple[int, int], ...] = ()
    headers: tuple[PhotoHeader, ...] = ()

    def group_of(self, index: int) -> int:
        """Number of the camera of a photo."""
        return self.groups[index] if self.groups else 0

    def size_of(self, index: int) -> tuple[int, int]:
        """(width, height) of a photo of `used`."""
        return self.sizes[index] if self.sizes else self.size

    def factor_of(self, index: int) -> float:
        """Size of a photo of `used` over that of `paths`."""
        whole = self.whole_size(index)
        return self.size_of(index)[0] / whole[0] if whole is not None else self.factor

    def whole_size(self, index: int) -> tuple[int, int] | None:
        """(width, height) of a photo of `paths`, upright."""
        return self.headers[index].size if self.headers else None

    def index_of(self, name: str, option: str) -> int:
        """Index of the photo with a file name or stem.

        Raises:
            ToolkitError: no such photo.
        """
        for i, path in enumerate(self.paths):
            if name in (path.name, path.stem):
                return i
        raise ToolkitError(
            "no such photo", field=option, value=name, hint=f"such as {self.paths[0].name}"
        )


def find_photos(folder: Path, work: Path, *, longest: int, stored: bool = False) -> Photos:
    """List the photos of a folder, turn them upright, and reduce large ones.

    Args:
        folder: folder of JPEG, PNG or HEIC images.
        work: receives upright and reduced copies.
        longest: longer side of the images that are used, pixels.
        stored: leave the pixels as they are stored; given intrinsics or poses belong to these.

    Raises:
        ToolkitError: no folder, too few photos, or HEIC without its extra.
    """
    if not folder.is_dir():
        raise ToolkitError(
            "no such folder of photos, and no video", path=folder,
            hint="give a folder of JPEG, PNG or HEIC files, a video as .mp4, .mov, .avi or .mkv, "
            "or a scene of std-curate import",
        )  # fmt: skip
    paths = sorted(
        p for p in folder.iterdir()
        if p.suffix.lower() in PHOTO_SUFFIXES and p.is_file() and not p.name.startswith(".")
    )  # fmt: skip
    return photos_of(paths, folder, work, longest=longest, stored=stored)


def is_scene(path: Path) -> bool:
    """Whether a folder is a scene of `std-curate import`."""
    return (path / "scene.json").is_file()


def scene_photos(root: Path, work: Path, *, longest: int) -> Photos:
    """The colour frames of a scene as photos; of many about 60, spread evenly over the motion.

    Args:
        root: folder of the scene.
        work: receives reduced copies.
        longest: longer side of the images that are used, pixels.

    Raises:
        ToolkitError: an unreadable scene, too few frames, or frames of several cameras.
    """
    scene = Scene.open(root)
    cameras = sorted({frame.camera for frame in scene.frames})
    if len(cameras) > 1:
        raise ToolkitError(
            "the scene has several cameras", path=root, value=", ".join(cameras),
            hint="import the frames of one camera",
        )  # fmt: skip
    frames = scene.frames
    if len(frames) > PHOTOS:
        measures: list[FrameMeasure] = []
        previous: NDArray[np.uint8] | None = None
        for frame in frames:
            grey = cv2.cvtColor(scene.read_color(frame), cv2.COLOR_RGB2GRAY)
            measure, previous = measure_image(np.asarray(grey, np.uint8), previous)
            measures.append(measure)
        frames = [frames[i] for i in spread(measures, PHOTOS)]
        logger.info("%s: %d of %d frames are used", root.name, len(frames), len(scene.frames))
    paths = [scene.color_path(f) for f in frames]
    found = photos_of(paths, root, work, longest=longest, stored=True)
    return replace(found, sensor=Sensor(scene, tuple(frames)))


def photos_of(
    paths: Sequence[Path], folder: Path, work: Path, *, longest: int, stored: bool = False
) -> Photos:
    """Photos, upright and large ones reduced; arguments and errors as of `find_photos`."""
    limits = PhotoSettings.current()
    if len(paths) < limits.fewest_photos:
        raise ToolkitError(
            f"{len(paths)} photos are too few, at least {limits.fewest_photos} are needed",
            path=folder,
            hint="walk around the object and take 40 to 60 photos from two heights",
        )
    headers = tuple(read_photo_header(p, stored=stored) for p in paths)
    if len(paths) < limits.usual_photos:
        logger.warning(
            "%d photos: surfaces that only one or two of them show will be guessed; 40 to 60 are "
            "usual", len(paths),
        )  # fmt: skip
    kinds = list(dict.fromkeys((h.size, h.lens, h.orientation) for h in headers))
    groups = tuple(kinds.index((h.size, h.lens, h.orientation)) for h in headers)
    if len(kinds) > 1:
        logger.info(
            "photos of %d cameras: %s", len(kinds),
            "; ".join(f"{groups.count(g)} of {w}x{h}" + (f", {lens}" if lens else "")
                      for g, ((w, h), lens, _) in enumerate(kinds)),
        )  # fmt: skip
    made = [_used(p, h, work, longest) for p, h in zip(paths, headers, strict=True)]
    used, sizes = tuple(u for u, _ in made), tuple(s for _, s in made)
    factor = sizes[0][0] / headers[0].size[0]
    return Photos(tuple(paths), used, sizes[0], factor, groups=groups, sizes=sizes, headers=headers)


def _used(
    path: Path, header: PhotoHeader, work: Path, longest: int
) -> tuple[Path, tuple[int, int]]:
    """The file that is read for a photo, and its (width, height): itself, or a copy."""
    size, factor = header.size, min(1.0, longest / max(header.size))
    if factor < 1:
        size = (round(size[0] * factor), round(size[1] * factor))
    elif header.orientation == 1 and path.suffix.lower() in COLOR_SUFFIXES:
        return path, size
    # Named by content: times of files follow the clock, and copies keep the older ones.
    stem = f"{path.stem}-{size[0]}-{header.orientation}-{digest_file(path)[:12]}"
    target = work / "photos" / f"{stem}.png"
    if not target.is_file():
        image = read_photo(path, header.orientation)
        if factor < 1:
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        write_color(target, image)
    return target, size


def blurred_photos(paths: Sequence[Path]) -> list[int]:
    """Indices of photos that are much less sharp than the others.

    Raises:
        ToolkitError: most photos are blurred.
    """
    limits = PhotoSettings.current()
    values = []
    for path in paths:
        grey = cv2.cvtColor(read_color(path), cv2.COLOR_RGB2GRAY)
        small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        # High over middle frequencies, so that a photo of a plain view is not called blurred.
        fine = cv2.Laplacian(small, cv2.CV_32F).var()
        coarse = cv2.Laplacian(
            cv2.resize(small, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA), cv2.CV_32F
        ).var()
        values.append(float(fine / (coarse + 1e-6)))
    sharpness = np.array(values)
    usual = float(np.percentile(sharpness, 75))
    bad = np.flatnonzero(sharpness < limits.blurred * usual).tolist()
    if len(paths) - len(bad) < limits.fewest_photos:
        raise ToolkitError(
            f"{len(bad)} of {len(paths)} photos are blurred",
            hint="hold the camera still, add light, and photograph again: "
            + ", ".join(paths[i].name for i in bad[:5]),
        )
    return [int(i) for i in bad]


def known_views(photos: Photos, options: KnownCameras, intrinsics: str | None) -> list[View]:
    """Undistorted photos with poses and intrinsics from a file of cameras.

    Raises:
        ToolkitError: unreadable, or without intrinsics.
    """
    from std_toolkit.importers.intrinsics import read_intrinsics
    from std_toolkit.poses.known_cameras import read_known_poses

    frames = [Frame(id=i, name=p.stem, color=f"color/{p.name}") for i, p in enumerate(photos.paths)]
    known = read_known_poses(options, frames)
    given = None if intrinsics is None else read_intrinsics(intrinsics)
    views = []
    for i, T in known.poses().items():
        lens = known.filed.lenses[known.row[i]] if len(known.filed.lenses) else None
        found = given if given is not None else lens
        if found is not None:
            whole = photos.whole_size(i) or image_size(photos.paths[i])
            camera = replace(found, size=None).camera(
                whole, path=str(options.cameras), off_centre=True
            )
        elif photos.sensor is not None:
            camera = photos.sensor.camera(photos.size_of(i))
        else:
            raise ToolkitError(
                "the file has no intrinsics", path=options.cameras, hint="give --intrinsics"
            )
        views.append(make_view(photos, i, camera.resized(*photos.size_of(i)), T))
    return views


def make_view(photos: Photos, index: int, camera: Camera, T_world_cam: SE3) -> View:
    """One photo, undistorted."""
    size = photos.size_of(index)
    image = read_color(photos.used[index], size=size)
    flat = undistort_image(image, camera) if camera.is_distorted else image
    sensor = None if photos.sensor is None else photos.sensor.depth(index, size)
    if sensor is not None and camera.is_distorted:
        nearest = undistort_image(sensor, camera, interpolation=cv2.INTER_NEAREST)
        sensor = np.asarray(nearest, np.float32)
    return View(
        photos.paths[index].name,
        np.asarray(flat, np.uint8),
        camera.without_distortion(),
        T_world_cam,
        sensor=sensor,
    )
