"""ClearGrasp's real captures and rendered images.

Rendered images:

rgb-imgs/NNNNNNNNN-rgb.jpg                           colour
depth-imgs-rectified/NNNNNNNNN-depth-rectified.exr   exact z-depth, metres
segmentation-masks/NNNNNNNNN-segmentation-mask.png   transparent objects (also `-mask.png`)
json-files/NNNNNNNNN-masks.json                      field of view, among other things
camera-normals, outlines, variant-masks              not read here

The data set has no simulated raw depth (issue 8 of its repository). The raw depth here is the
exact depth without the pixels of transparent objects, as from a sensor that measures nothing on
them and everything else exactly.

Source of the names: the sample set in github.com/Shreeyak/cleargrasp.

Real captures: `real-val/d435` (known objects), `real-test/d415` and `d435` (novel).

NNNNNNNNN-transparent-rgb-img.jpg    colour
NNNNNNNNN-transparent-depth-img.exr  raw depth; float16 metres, 0 or NaN = missing
NNNNNNNNN-opaque-depth-img.exr       depth of spray-painted twins in the same place: ground truth
NNNNNNNNN-mask.png                   255 = transparent object, all of them together
NNNNNNNNN-normals.exr                rendered normals, not read here
camera_intrinsics.yaml               in the folder or above it

Every capture shows a different arrangement, so each is a separate scene.

Source of the names: the data set's repository, github.com/Shreeyak/cleargrasp.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmark.data import frame, loading, splits
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.io.foreign_files import read_json
from std_toolkit.io.images import read_color
from std_toolkit.log import logger

COLOR = ("-transparent-rgb-img.jpg", "-transparent-rgb-img.png")

RAW = ("-transparent-depth-img.exr",)

TRUTH = ("-opaque-depth-img.exr",)

MASK = ("-mask.png",)

SUFFIXES = (*COLOR, *RAW, *TRUTH, *MASK)

NEEDED = {"colour": COLOR, "raw depth": RAW, "ground-truth depth": TRUTH, "mask": MASK}

INTRINSICS = "camera_intrinsics.yaml"

# Field of view of the colour images; ClearGrasp's evaluation uses it for all of them.
COLOR_FOV_X = math.radians(69.4)

TRANSPARENT = frame.Instance(1, 0, frame.Material.TRANSPARENT)

SYNTHETIC_COLOR = ("-rgb.jpg", "-rgb.png")

SYNTHETIC_TRUTH = ("-depth-rectified.exr",)

SYNTHETIC_MASK = ("-segmentation-mask.png", "-mask.png")

_FOLDERS = {
    "colour": ("rgb-imgs", SYNTHETIC_COLOR),
    "ground-truth depth": ("depth-imgs-rectified", SYNTHETIC_TRUTH),
    "mask": ("segmentation-masks", SYNTHETIC_MASK),
}


@dataclass(frozen=True)
class ClearGraspReal:
    """Captures of a split; see `DepthSource`."""

    name: str
    index: loading.FrameIndex
    _cameras: dict[str, Camera] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.index)

    def keys(self) -> list[splits.FrameKey]:
        return [splits.FrameKey(f"{folder.name}-{stem}", stem) for folder, stem in self.index]

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> frame.DepthFrame:  # noqa: ARG002 - it has none
        """See `DepthSource`."""
        scene, stem = self.index.at(index)
        folder = Path(scene.path)

        def path(what: str) -> Path:
            return loading.first_file(folder, tuple(stem + s for s in NEEDED[what]), what)

        key = splits.FrameKey(f"{scene.name}-{stem}", stem)
        has = ("colour", "raw depth") if sensor else ()
        return _frame(key, path, has, lambda size: self._camera(folder, size))

    def inputs(self, index: int, *, nocs: bool = False) -> dict[str, Path]:  # noqa: ARG002
        """See `DepthSource`."""
        scene, stem = self.index.at(index)
        folder = Path(scene.path)
        found = {what: _first(folder, stem, suffixes) for what, suffixes in NEEDED.items()}
        paths = (place / INTRINSICS for place in (folder, folder.parent))
        path = next((p for p in paths if p.is_file()), None)
        return found if path is None else {**found, "camera": path}

    def files(self) -> Iterator[splits.SceneFiles]:
        """See `DepthSource`."""
        return (loading.scene_files(scene, NEEDED) for scene in self.index.scenes)

    def _camera(self, folder: Path, size: tuple[int, int]) -> Camera:
        known = self._cameras.get(str(folder))
        if known is None:
            known = self._cameras[str(folder)] = _read_camera(folder, size)
        return known if known.size == size else known.resized(*size)


def _frame(
    key: splits.FrameKey,
    path: Callable[[str], Path],
    has: Sequence[str],
    camera: Callable[[tuple[int, int]], Camera],
) -> frame.DepthFrame:
    """Read a frame.

    Args:
        key: scene and name.
        path: the file of each content.
        has: which images of the sensor are read: colour, raw depth. Without a file of it, raw depth
            is the true one without transparent objects.
        camera: of the images, by their size.
    """
    true, mask_path = loading.read_depth_map(path("ground-truth depth")), path("mask")
    mask = loading.read_binary_mask(mask_path, TRANSPARENT.mask_id)
    loading.check_same_size(mask_path, mask, true, "mask")
    size = (true.shape[1], true.shape[0])
    color, raw = loading.NO_COLOR, loading.NO_DEPTH
    paths = [path(what) for what in has]
    if paths:
        color = read_color(paths[0])
        raw = np.where(mask == TRANSPARENT.mask_id, np.float32(0), true)
        if len(paths) > 1:
            raw = loading.read_depth_map(paths[1])
            loading.check_proportions(paths[1], raw, size)
        loading.check_proportions(paths[0], color, size)
    return frame.DepthFrame(
        key.scene, key.name, color, raw, true, mask, camera(size), (TRANSPARENT,)
    )


def _first(folder: Path, stem: str, suffixes: Sequence[str]) -> Path:
    """The first of these files that exists, else the first name."""
    paths = [folder / f"{stem}{suffix}" for suffix in suffixes]
    return next((path for path in paths if path.is_file()), paths[0])


def camera_of_view(size: tuple[int, int], fov_x: float = COLOR_FOV_X) -> Camera:
    """Return a centred camera with square pixels and horizontal field of view `fov_x`, radians."""
    width, height = size
    focal = width / 2 / math.tan(fov_x / 2)
    return Camera(width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5)


def _read_camera(folder: Path, size: tuple[int, int]) -> Camera:
    for place in (folder, folder.parent):
        path = place / INTRINSICS
        if path.is_file():
            return read_intrinsics(str(path), size=size).scene_camera(size, path=str(path))
    logger.warning("%s: no %s: using a field of view of 69.4 degrees", folder, INTRINSICS)
    return camera_of_view(size)


@dataclass(frozen=True)
class ClearGraspSynthetic:
    """Rendered images, a scene per folder of one kind of object; see `DepthSource`."""

    name: str
    index: loading.FrameIndex

    def __len__(self) -> int:
        return len(self.index)

    def keys(self) -> list[splits.FrameKey]:
        return [splits.FrameKey(scene.name, stem) for scene, stem in self.index]

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> frame.DepthFrame:  # noqa: ARG002 - it has none
        """See `DepthSource`."""
        scene, stem = self.index.at(index)

        def path(what: str) -> Path:
            folder, suffixes = _FOLDERS[what]
            return loading.first_file(
                Path(scene.path) / folder, tuple(stem + s for s in suffixes), what
            )

        document = Path(scene.path) / "json-files" / f"{stem}-masks.json"
        key, has = splits.FrameKey(scene.name, stem), ("colour",) if sensor else ()
        return _frame(key, path, has, lambda size: camera_of_view(size, _field_of_view(document)))

    def inputs(self, index: int, *, nocs: bool = False) -> dict[str, Path]:  # noqa: ARG002
        """See `DepthSource`."""
        scene, stem = self.index.at(index)
        place = Path(scene.path)
        found = {
            what: _first(place / folder, stem, suffixes)
            for what, (folder, suffixes) in _FOLDERS.items()
        }
        return found | {"camera": place / "json-files" / f"{stem}-masks.json"}

    def files(self) -> Iterator[splits.SceneFiles]:
        """See `DepthSource`."""
        for scene in self.index.scenes:
            missing: dict[str, list[str]] = {}
            for what, (folder, suffixes) in _FOLDERS.items():
                place = Path(scene.path) / folder
                if not place.is_dir():
                    missing[what] = [f"{folder}/{stem}{suffixes[0]}" for stem in scene.stems]
                    continue
                part = loading.SceneFolder(scene.name, str(place), scene.stems)
                missing |= loading.scene_files(part, {what: suffixes}).missing
            yield splits.SceneFiles(scene.name, scene.path, len(scene.stems), missing)


def list_rendered(tops: Sequence[Path]) -> loading.FrameIndex:
    """List the scenes below these folders: every folder with `rgb-imgs`.

    Raises:
        ToolkitError: a folder cannot be read.
    """
    scenes = []
    for top in tops:
        listed = loading.list_scenes(
            top, (*SYNTHETIC_COLOR, *SYNTHETIC_TRUTH, *SYNTHETIC_MASK), depth=4
        )
        stems: dict[Path, set[str]] = {}
        for part in listed.scenes:
            if Path(part.path).name in {folder for folder, _ in _FOLDERS.values()}:
                stems.setdefault(Path(part.path).parent, set()).update(part.stems)
        scenes += [
            loading.SceneFolder(place.name, str(place), tuple(sorted(found)))
            for place, found in stems.items()
        ]
    return loading.FrameIndex(tuple(scenes))


def _field_of_view(path: Path) -> float:
    """Horizontal field of view in radians; the default if the file does not exist."""
    if not path.is_file():
        return COLOR_FOV_X
    try:
        view = read_json(path)["camera"]["field_of_view"]["x_axis_rads"]
        if not 0.1 < view < math.pi - 0.1:
            raise ValueError(view)
    except (ValueError, TypeError, LookupError) as error:
        raise ToolkitError(
            "tells no horizontal field of view",
            path=path,
            field="camera.field_of_view.x_axis_rads",
        ) from error
    return float(view)
