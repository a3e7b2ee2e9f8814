"""ClearGrasp's real captures: `real-val/d435` (known objects), `real-test/d415` and `d435` (novel).

NNNNNNNNN-transparent-rgb-img.jpg    colour
NNNNNNNNN-transparent-depth-img.exr  raw depth; float16 metres, 0 or NaN = missing
NNNNNNNNN-opaque-depth-img.exr       depth of spray-painted twins in the same place: ground truth
NNNNNNNNN-mask.png                   255 = transparent object, all of them together
NNNNNNNNN-normals.exr                rendered normals, not read here
camera_intrinsics.yaml               in the folder or above it

Every capture shows another arrangement, so each is a scene of its own.

Source of the names: the data set's repository, github.com/Shreeyak/cleargrasp.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.data.assemble import (
    NO_COLOR,
    NO_DEPTH,
    check_proportions,
    check_same_size,
    first_file,
)
from benchmark.data.frame import DepthFrame, Instance, Material
from benchmark.data.listing import FrameIndex, scene_files
from benchmark.data.maps import read_binary_mask, read_depth_map
from benchmark.data.source import FrameKey, SceneFiles
from std_toolkit.geometry.camera import Camera
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.io.images import read_color
from std_toolkit.log import logger

COLOR = ("-transparent-rgb-img.jpg", "-transparent-rgb-img.png")
RAW = ("-transparent-depth-img.exr",)
TRUTH = ("-opaque-depth-img.exr",)
MASK = ("-mask.png",)
SUFFIXES = (*COLOR, *RAW, *TRUTH, *MASK)
NEEDED = {"colour": COLOR, "raw depth": RAW, "ground-truth depth": TRUTH, "mask": MASK}
INTRINSICS = "camera_intrinsics.yaml"
# Of the cameras' colour images; ClearGrasp's own evaluation uses it for all of them.
COLOR_FOV_X = math.radians(69.4)
TRANSPARENT = Instance(1, 0, Material.TRANSPARENT)


@dataclass(frozen=True)
class ClearGraspReal:
    """Captures of a split; see `DepthSource`."""

    name: str
    index: FrameIndex
    _cameras: dict[str, Camera] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.index)

    def keys(self) -> list[FrameKey]:
        return [FrameKey(f"{folder.name}-{stem}", stem) for folder, stem in self.index]

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:  # noqa: ARG002 - it has none
        """See `DepthSource`."""
        scene, stem = self.index.at(index)
        folder = Path(scene.path)

        def path(what: str) -> Path:
            return first_file(folder, tuple(stem + s for s in NEEDED[what]), what)

        true = read_depth_map(path("ground-truth depth"))
        mask_path = path("mask")
        mask = read_binary_mask(mask_path, TRANSPARENT.mask_id)
        check_same_size(mask_path, mask, true, "mask")
        size = (true.shape[1], true.shape[0])
        color, raw = NO_COLOR, NO_DEPTH
        if sensor:
            color_path, raw_path = path("colour"), path("raw depth")
            color = read_color(color_path)
            raw = read_depth_map(raw_path)
            check_proportions(color_path, color, size)
            check_proportions(raw_path, raw, size)
        return DepthFrame(
            scene=f"{scene.name}-{stem}",
            name=stem,
            color=color,
            depth_raw=raw,
            depth_true=true,
            mask=mask,
            camera=self._camera(folder, size),
            instances=(TRANSPARENT,),
        )

    def files(self) -> Iterator[SceneFiles]:
        """See `DepthSource`."""
        return (scene_files(scene, NEEDED) for scene in self.index.scenes)

    def _camera(self, folder: Path, size: tuple[int, int]) -> Camera:
        known = self._cameras.get(str(folder))
        if known is None:
            known = self._cameras[str(folder)] = _read_camera(folder, size)
        return known if known.size == size else known.resized(*size)


def camera_of_view(size: tuple[int, int], fov_x: float = COLOR_FOV_X) -> Camera:
    """Camera with square pixels and this horizontal field of view in radians, centred."""
    width, height = size
    focal = width / 2 / math.tan(fov_x / 2)
    return Camera(width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5)


def _read_camera(folder: Path, size: tuple[int, int]) -> Camera:
    for place in (folder, folder.parent):
        path = place / INTRINSICS
        if path.is_file():
            return read_intrinsics(str(path), size=size).camera(size, path=str(path))
    logger.warning("%s: no %s: using a field of view of 69.4 degrees", folder, INTRINSICS)
    return camera_of_view(size)
