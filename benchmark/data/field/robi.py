"""ROBI: chrome and steel parts in bins, with the active stereo pair and captured true depth.

<root>/OBJECT/Scene_N/GT_Depth_Raw/DEPTH_view_K.png       true depth; or GT_Depth
<root>/OBJECT/Scene_N/Ensenso/Depth/DEPTH_view_K.png      raw depth, 0.03125 mm per number
<root>/OBJECT/Scene_N/Ensenso/Stereo/LEFT_view_K.bmp      grey, pattern off: the colour image here
<root>/OBJECT/Scene_N/Ensenso/StereoPattern/LEFT_view_K.bmp, RIGHT_view_K.bmp

Depth has the camera of the left image. Truth was captured by the Ensenso alone, for all views of
scenes 4, 5, 8 and 9 and some of the others: frames are those that have it. There are no masks. The
unit of the poses is not verified, so they are not read.

Source: README, `ROBI_Dataset_Structure.txt`, `read_scene_imgs.py` and `cam/*.yml` of
github.com/junyang224/ROBI_Toolkit, which differ in the name of the folder of true depth. Not
checked on the authors' files.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.source import (
    COLOR,
    RAW,
    TRUTH,
    FieldFrames,
    Files,
    Maps,
    read_field_depth,
)
from benchmark.data.frame import BACKGROUND
from benchmark.data.loading import FrameIndex, SceneFolder
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.image_header import check_plausible_size
from std_toolkit.io.regular import read_regular

UNIT_M = 0.03125e-3
_CAMERA = Camera(1280, 1024, 1083.097046, 1083.097046, 379.326874, 509.437195)
_TRUTHS = ("GT_Depth", "GT_Depth_Raw")
_BMP_HEADER = 26


@dataclass(frozen=True)
class Robi(FieldFrames):
    """Views of the Ensenso with captured true depth."""

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        top = Path(scene.path)
        truth = next((t for t in _TRUTHS if (top / t).is_dir()), _TRUTHS[0])
        return {
            COLOR: top / f"Ensenso/Stereo/LEFT_{stem}.bmp",
            RAW: top / f"Ensenso/Depth/DEPTH_{stem}.png",
            TRUTH: top / truth / f"DEPTH_{stem}.png",
        }

    def color(self, path: Path) -> NDArray[np.uint8]:
        return read_bmp(path)

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:  # noqa: ARG002
        true = read_field_depth(files[TRUTH], self.unit)
        width, height = true.shape[1], true.shape[0]
        if width * _CAMERA.height != height * _CAMERA.width:
            raise ToolkitError(
                f"the camera of ROBI is known at {_CAMERA.width}x{_CAMERA.height}",
                path=files[TRUTH], value=f"{width}x{height}",
            )  # fmt: skip
        camera = _CAMERA if _CAMERA.size == (width, height) else _CAMERA.resized(width, height)
        return Maps(true, np.full(true.shape, BACKGROUND, np.uint8), camera, ())

    def infrared_images(self, index: int) -> tuple[Path, Path] | None:
        """See `FieldFrames`; grey images with the projected pattern."""
        scene, stem = self.index.at(index)
        top = Path(scene.path) / "Ensenso" / "StereoPattern"
        left, right = (top / f"{side}_{stem}.bmp" for side in ("LEFT", "RIGHT"))
        return (left, right) if left.is_file() and right.is_file() else None


def read_bmp(path: Path) -> NDArray[np.uint8]:
    """Read an uncompressed bitmap as RGB (H, W, 3).

    Raises:
        ToolkitError: unreadable, or no bitmap.
    """
    data = read_regular(path, "image")
    if len(data) < _BMP_HEADER or data[:2] != b"BM":
        raise ToolkitError("is no bitmap", path=path)
    width, height = (abs(int.from_bytes(data[i : i + 4], "little", signed=True)) for i in (18, 22))
    check_plausible_size(path, width, height)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None or image.shape[:2] != (height, width):
        raise ToolkitError("the bitmap is damaged", path=path)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)  # type: ignore[return-value]


def open_robi(name: str, root: Path) -> Robi:
    """List the views with true depth.

    Args:
        name: of the split.
        root: folder of the objects, or one above it.
    """
    scenes = []
    for folder in sorted(
        (*root.glob("*/Scene_[0-9]"), *root.glob("*/*/Scene_[0-9]")),
        key=lambda p: natural_key(str(p)),
    ):
        stems = {
            path.stem.removeprefix("DEPTH_")
            for truth in _TRUTHS
            for path in (folder / truth).glob("DEPTH_view_*.png")
        }
        if stems:
            key = f"{folder.parent.name}_{folder.name}"
            scenes.append(SceneFolder(key, str(folder), tuple(sorted(stems, key=natural_key))))
    return Robi(name, FrameIndex(tuple(scenes)), unit=UNIT_M)
