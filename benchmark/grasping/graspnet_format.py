"""GraspNet's files of grasps: arrays of 17 numbers, and where a planner's answers lie.

A dump, what GraspNet's evaluation takes, is `scene_<4 digits>/<camera>/<frame, 4 digits>.npy` with
one row (`Grasps.from_array`) for each grasp, in the frame of that image's camera, in metres.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.grasping.grasp import Grasps
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic

CAMERAS = ("realsense", "kinect")


def write_grasps(path: Path | str, grasps: Grasps) -> None:
    """Write grasps as (N, 17) float64 `.npy`, atomically."""
    buffer = io.BytesIO()
    np.save(buffer, grasps.to_array(), allow_pickle=False)
    write_bytes_atomic(path, buffer.getvalue())


def read_grasps(path: Path | str) -> Grasps:
    """Read grasps of a `.npy` file.

    Raises:
        ToolkitError: no such file, not an array of numbers, or not grasps.
    """
    path = Path(path)
    try:
        array = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise ToolkitError("file of grasps not found", path=path) from None
    except (OSError, ValueError, EOFError) as error:
        raise ToolkitError(f"cannot read the grasps: {error}", path=path) from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise ToolkitError("holds no array of numbers", path=path)
    try:
        return Grasps.from_array(array)
    except ToolkitError as error:
        raise ToolkitError(error.problem, path=path, field=error.field, value=error.value) from None


@dataclass(frozen=True, order=True)
class DumpKey:
    """One image of a dump.

    Attributes:
        scene: its number.
        camera: `realsense` or `kinect`.
        frame: number of the image.
    """

    scene: int
    camera: str
    frame: int

    def path(self, root: Path) -> Path:
        """Its file below a dump."""
        return root / f"scene_{self.scene:04d}" / self.camera / f"{self.frame:04d}.npy"


def dumped(root: Path, *, camera: str) -> Iterator[DumpKey]:
    """The images that a dump has grasps of, in order.

    Raises:
        ToolkitError: no such folder or camera.
    """
    if camera not in CAMERAS:
        raise ToolkitError(f"one of {', '.join(CAMERAS)}", field="camera", value=camera)
    if not root.is_dir():
        raise ToolkitError("the folder of grasps is not there", path=root)
    digit = "[0-9]"
    for path in sorted(root.glob(f"scene_{digit * 4}/{camera}/{digit * 4}.npy")):
        yield DumpKey(int(path.parent.parent.name[-4:]), camera, int(path.stem))
