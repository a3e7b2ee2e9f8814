"""HAMMER: full-scene true depth beside a D435, an L515 and a time-of-flight camera.

<root>/sceneX_trajY_Z/[polarization/]rgb/000000.png           colour of the polarisation camera
.../depth_d435/, depth_l515/, depth_tof/000000.png            millimetres, 16 bit, warped into it
.../_gt/000000.png                                            true depth of the whole scene

Depth of all sensors was warped into the polarisation camera, so shadows of the warp are holes that
no sensor made; the colour of the depth cameras is not published. There are no masks in the copies
that third parties describe: the whole frame is scored.

Source: the README and issue 7 of github.com/Junggy/HAMMER-dataset; the folders from three third
parties that agree, among them `infer_HAMMER.py` of github.com/rcao-hk/d3roma. Not checked on the
authors' files.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

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
from std_toolkit.geometry import SE3, Camera
from std_toolkit.importers.foreign_files import natural_key

Sensor = Literal["d435", "l515", "tof"]

# The nine sequences that users of the set test on; others take the first 300 frames of each.
TEST = tuple(
    f"scene{scene}_{trajectory}"
    for scene in (12, 13, 14)
    for trajectory in ("traj1_1", "traj2_1", "traj2_2")
)
_SEQUENCE = re.compile(r"scene(\d+)_traj\d+_(naked_)?\d+")
_TRAIN = range(2, 12)

# At 1088x832, as users of the set have it; the set's files with intrinsics are not known.
_CAMERA = Camera(1088, 832, 706.755, 707.513, 545.633, 389.930)


@dataclass(frozen=True)
class Hammer(FieldFrames):
    """Frames of HAMMER with the depth of one sensor.

    Attributes:
        sensor: whose depth is raw.
    """

    sensor: Sensor = "d435"

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        top = Path(scene.path)
        folders = {COLOR: "rgb", RAW: f"depth_{self.sensor}", TRUTH: "_gt"}
        return {what: top / folder / f"{stem}.png" for what, folder in folders.items()}

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:  # noqa: ARG002
        true = read_field_depth(files[TRUTH], self.unit)
        width, height = true.shape[1], true.shape[0]
        if width * _CAMERA.height != height * _CAMERA.width:
            raise ToolkitError(
                f"the camera of HAMMER is known at {_CAMERA.width}x{_CAMERA.height}",
                path=files[TRUTH],
                value=f"{width}x{height}",
            )
        nothing = np.full(true.shape, BACKGROUND, np.uint8)
        camera = _CAMERA if _CAMERA.size == (width, height) else _CAMERA.resized(width, height)
        return Maps(true, nothing, camera, ())

    def notes(self) -> Sequence[str]:
        """See `FieldFrames`."""
        there = {scene.name for scene in self.index.scenes}
        lacking = [name for name in TEST if name not in there] if there & set(TEST) else []
        return [f"of the nine test sequences, not here: {', '.join(lacking)}"] if lacking else []

    def camera_pose(self, index: int) -> SE3 | None:
        """Return the 4x4 matrix of `_pose/` as filed; whose frame it maps is not verified."""
        scene, stem = self.index.at(index)
        path = Path(scene.path) / "_pose" / f"{stem}.txt"
        if not path.is_file():
            return None
        try:
            matrix = np.loadtxt(path, dtype=np.float64)
        except (OSError, ValueError) as error:
            raise ToolkitError("no 4x4 matrix", path=path) from error
        return SE3.from_matrix(matrix)


def open_hammer(name: str, root: Path, sensor: Sensor, *, test: bool) -> Hammer:
    """List the frames of a sensor.

    Args:
        name: of the split.
        root: folder of the sequences, or one above it.
        sensor: whose depth is raw.
        test: the nine sequences of `TEST`; otherwise those of scenes 2 to 11 with objects.
    """
    scenes = []
    for folder in sequences(root):
        match = _SEQUENCE.fullmatch(folder.name)
        if match is None or match[2]:
            continue
        wanted = folder.name in TEST if test else int(match[1]) in _TRAIN
        inner = folder / "polarization"
        top = inner if inner.is_dir() else folder
        if wanted and (stems := _stems(top, sensor)):
            scenes.append(SceneFolder(folder.name, str(top), stems))
    return Hammer(name, FrameIndex(tuple(scenes)), sensor=sensor)


def sequences(root: Path) -> list[Path]:
    """Return the folders of sequences in a folder, or one below it."""
    for top in (root, *(sorted(p for p in root.iterdir() if p.is_dir()))):
        found = [p for p in top.iterdir() if p.is_dir() and _SEQUENCE.fullmatch(p.name)]
        if found:
            return sorted(found, key=lambda p: natural_key(p.name))
    return []


def _stems(top: Path, sensor: str) -> tuple[str, ...]:
    """Frames that have any file: a missing one is then told."""
    names = {
        path.stem
        for folder in ("rgb", f"depth_{sensor}", "_gt")
        for path in (top / folder).glob("*.png")
    }
    return tuple(sorted(names, key=natural_key))
