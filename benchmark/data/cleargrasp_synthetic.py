"""ClearGrasp's rendered images: `synthetic-val/<object>-val/`, `synthetic-test/<object>-test/`.

rgb-imgs/NNNNNNNNN-rgb.jpg                           colour
depth-imgs-rectified/NNNNNNNNN-depth-rectified.exr   exact z-depth, metres
segmentation-masks/NNNNNNNNN-segmentation-mask.png   transparent objects (also `-mask.png`)
json-files/NNNNNNNNN-masks.json                      field of view, among other things
camera-normals, outlines, variant-masks              not read here

No raw depth was simulated (issue 8 of the data set's repository). As raw depth, the exact one is
given without the pixels of transparent objects: what a sensor would measure that sees nothing of
them and everything else perfectly.

Source of the names: the sample set in github.com/Shreeyak/cleargrasp.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.data.assemble import (
    NO_COLOR,
    NO_DEPTH,
    check_proportions,
    check_same_size,
    first_file,
)
from benchmark.data.cleargrasp_real import COLOR_FOV_X, TRANSPARENT, camera_of_view
from benchmark.data.frame import DepthFrame
from benchmark.data.listing import FrameIndex, SceneFolder, list_scenes, scene_files
from benchmark.data.maps import read_binary_mask, read_depth_map
from benchmark.data.source import FrameKey, SceneFiles
from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import read_color

COLOR = ("-rgb.jpg", "-rgb.png")
TRUTH = ("-depth-rectified.exr",)
MASK = ("-segmentation-mask.png", "-mask.png")
_FOLDERS = {
    "colour": ("rgb-imgs", COLOR),
    "ground-truth depth": ("depth-imgs-rectified", TRUTH),
    "mask": ("segmentation-masks", MASK),
}


@dataclass(frozen=True)
class ClearGraspSynthetic:
    """Rendered images, a scene per folder of one kind of object; see `DepthSource`."""

    name: str
    index: FrameIndex

    def __len__(self) -> int:
        return len(self.index)

    def keys(self) -> list[FrameKey]:
        return [FrameKey(scene.name, stem) for scene, stem in self.index]

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:  # noqa: ARG002 - it has none
        """See `DepthSource`."""
        scene, stem = self.index.at(index)

        def path(what: str) -> Path:
            folder, suffixes = _FOLDERS[what]
            return first_file(Path(scene.path) / folder, tuple(stem + s for s in suffixes), what)

        true, mask_path = read_depth_map(path("ground-truth depth")), path("mask")
        mask = read_binary_mask(mask_path, TRANSPARENT.mask_id)
        check_same_size(mask_path, mask, true, "mask")
        size = (true.shape[1], true.shape[0])
        color, raw = NO_COLOR, NO_DEPTH
        if sensor:
            color_path = path("colour")
            color = read_color(color_path)
            check_proportions(color_path, color, size)
            raw = np.where(mask == TRANSPARENT.mask_id, np.float32(0), true)
        view = _field_of_view(Path(scene.path) / "json-files" / f"{stem}-masks.json")
        return DepthFrame(
            scene=scene.name,
            name=stem,
            color=color,
            depth_raw=raw,
            depth_true=true,
            mask=mask,
            camera=camera_of_view(size, view),
            instances=(TRANSPARENT,),
        )

    def files(self) -> Iterator[SceneFiles]:
        """See `DepthSource`."""
        for scene in self.index.scenes:
            missing: dict[str, list[str]] = {}
            for what, (folder, suffixes) in _FOLDERS.items():
                place = Path(scene.path) / folder
                if not place.is_dir():
                    missing[what] = [f"{folder}/{stem}{suffixes[0]}" for stem in scene.stems]
                    continue
                part = SceneFolder(scene.name, str(place), scene.stems)
                missing |= scene_files(part, {what: suffixes}).missing
            yield SceneFiles(scene.name, scene.path, len(scene.stems), missing)


def list_rendered(tops: Sequence[Path]) -> FrameIndex:
    """Scenes below these folders: every folder that holds `rgb-imgs`.

    Raises:
        ToolkitError: a folder cannot be read.
    """
    scenes = []
    for top in tops:
        listed = list_scenes(top, (*COLOR, *TRUTH, *MASK), depth=4)
        stems: dict[Path, set[str]] = {}
        for part in listed.scenes:
            if Path(part.path).name in {folder for folder, _ in _FOLDERS.values()}:
                stems.setdefault(Path(part.path).parent, set()).update(part.stems)
        scenes += [
            SceneFolder(place.name, str(place), tuple(sorted(found)))
            for place, found in stems.items()
        ]
    return FrameIndex(tuple(scenes))


def _field_of_view(path: Path) -> float:
    """Horizontal, in radians; the usual one where the file is not there."""
    if not path.is_file():
        return COLOR_FOV_X
    try:
        view = json.loads(path.read_bytes())["camera"]["field_of_view"]["x_axis_rads"]
        if not 0.1 < view < math.pi - 0.1:
            raise ValueError(view)
    except (OSError, ValueError, TypeError, LookupError, RecursionError) as error:
        raise ToolkitError(
            "tells no horizontal field of view",
            path=path,
            field="camera.field_of_view.x_axis_rads",
        ) from error
    return float(view)
