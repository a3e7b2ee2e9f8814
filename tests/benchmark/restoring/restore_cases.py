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

class Lifting(FromBehind):
    """Lifts a quarter of the image by 5 cm, whatever the sensor says."""

    def restore(self, views):
        found = []
        for view in views:
            depth = view.depth.copy()
            depth[:, : depth.shape[1] // 4] -= 0.05
            found.append(Restored(depth, np.zeros(depth.shape, np.float32)))
        return found
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


def write_blocks(root: Path, shift: int = 0, frames: int = 3) -> Path:
    """Boxes of their own colours over a table, depth moved to the right by `shift` pixels."""
    rng = np.random.default_rng(0)
    for index in range(frames):
        color = np.full((240, 320, 3), 120, np.uint8)
        depth = np.full((240, 320), 0.9, np.float32)
        for _ in range(6):
            x, y, w, h = (int(v) for v in rng.integers([20, 20, 40, 40], [240, 160, 70, 70]))
            color[y : y + h, x : x + w] = rng.integers(0, 255, 3)
            depth[y : y + h, x : x + w] = rng.uniform(0.5, 0.8)
        noise = rng.normal(0, 4, color.shape)
        write_color(
            root / f"color/{index:04d}.png", np.clip(color + noise, 0, 255).astype(np.uint8)
        )
        write_depth_png16(
            root / f"depth/{index:04d}.png", np.roll(depth, shift, axis=1), scale=1e-3
        )
    return root
