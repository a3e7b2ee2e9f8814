"""Plug-ins of `std-sim`."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import trimesh

from sensors.assets.asset import Asset
from sensors.assets.asset_source import SourceOptions
from sensors.depth_models.depth_model import Reading
from sensors.depth_models.stereo import ActiveStereo
from sensors.render.mitsuba_renderer import MitsubaRenderer


class ShortRange(ActiveStereo):
    """`"depth_model": "short-range"` of a sensor file: active stereo that ends at 1 m."""

    def read(self, received: Any, *, seed: int) -> Reading:
        reading = super().read(received, seed=seed)
        depth = np.where(reading.depth < 1.0, reading.depth, 0).astype(np.float32)
        return Reading(depth, reading.left, reading.right)


class Crates:
    """`std-sim dataset --assets crates`: boxes of three shapes."""

    def __init__(self, options: SourceOptions) -> None:
        """It reads no files."""

    def categories(self) -> Sequence[str]:
        return ["crate"]

    def sample(self, rng: np.random.Generator, category: str) -> Asset:
        return self.load(f"crate-{rng.integers(3)}")

    def load(self, asset_id: str) -> Asset:
        sides = np.array([1.0, 1.0 + int(asset_id.removeprefix("crate-")), 2.0])
        mesh = trimesh.creation.box(sides / np.linalg.norm(sides))
        return Asset(id=asset_id, category="crate", mesh=mesh, diagonal_m=0.2)


class DimRenderer(MitsubaRenderer):
    """`simulate(..., renderer="dim")`: Mitsuba under another name in records."""

    def __init__(self, *, threads: int | None = None) -> None:
        super().__init__(threads=threads)
        self.name = f"dim/{self.name}"


class BlockMatcher:
    """`std-sim dataset --matcher blocks`: OpenCV's block matcher."""

    def __init__(self, *, min_disparity: float = 0, max_disparity: float = 64) -> None:
        count = 16 * int(np.ceil((max_disparity - min_disparity) / 16))
        self.matcher = cv2.StereoBM.create(numDisparities=count, blockSize=11)
        self.matcher.setMinDisparity(int(min_disparity))

    def match(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        disparity = self.matcher.compute(left, right).astype(np.float32) / 16
        return np.maximum(disparity, 0)
