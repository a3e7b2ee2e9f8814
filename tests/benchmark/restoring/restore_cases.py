"""Small recordings to restore, and methods in a file of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmark.restoring.onnx_export import made_up_views
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_color, write_depth_png16

SIZE = (96, 72)
K = "96,96,47.5,35.5"

METHODS = '''
import os, time
import numpy as np
from benchmark.methods.protocol import Restored

class FromBehind:
    """Fills holes by the farthest depth; trusts the left half of the image."""
    input_size, needs_mask = (48, 36), False

    def __init__(self, options):
        self.pause = float(options.settings.get("pause", 0))

    def restore(self, views):
        time.sleep(self.pause)
        trust = np.zeros(views[0].depth.shape, np.float32)
        trust[:, : trust.shape[1] // 2] = 1
        return [Restored(np.where(v.depth > 0, v.depth, v.depth.max()), trust) for v in views]

class Odd(FromBehind):
    def restore(self, views):
        return [Restored(np.zeros((3, 3), np.float32))]

class Masked(FromBehind):
    needs_mask = True
'''


def sensor_depth(index: int = 0) -> np.ndarray:
    """Depth of a made-up frame in whole millimetres."""
    depth = np.roll(made_up_views(SIZE)[0].depth, index, axis=1)
    return (np.rint(depth * 1000) / 1000).astype(np.float32)


def write_folder(root: Path, frames: int = 3, *, exr: bool = False) -> Path:
    """A folder with color/ and depth/."""
    for index in range(frames):
        write_color(root / f"color/{index:04d}.png", made_up_views(SIZE)[0].color)
        if exr:
            write_exr(root / f"depth/{index:04d}.exr", {"Y": sensor_depth(index)})
        else:
            write_depth_png16(root / f"depth/{index:04d}.png", sensor_depth(index), scale=1e-3)
    return root


def write_methods(folder: Path) -> str:
    """The file of methods; returns its path as text."""
    path = folder / "my_methods.py"
    path.write_text(METHODS)
    return str(path)
