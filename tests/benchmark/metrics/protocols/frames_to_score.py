"""Frames for tests of scoring."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmark.data.frame import DepthFrame, Instance, Material
from benchmark.metrics.protocols import Row
from std_toolkit.geometry.camera import Camera

RAW, DIFFUSE, TRANSPARENT, SPECULAR = Material
FOUR = tuple(Instance(i, i + 1, m) for i, m in enumerate(Material))


def frame(
    true: np.ndarray,
    mask: np.ndarray | None = None,
    instances: Sequence[Instance] = FOUR,
    *,
    raw: np.ndarray | None = None,
) -> DepthFrame:
    """A frame with this ground truth; one specular object everywhere unless told otherwise."""
    height, width = true.shape
    if mask is None:
        mask, instances = np.zeros(true.shape, np.uint8), (Instance(0, 6, SPECULAR),)
    return DepthFrame(
        scene="scene",
        name="0000",
        color=np.zeros((height, width, 3), np.uint8),
        depth_raw=(true if raw is None else raw).astype(np.float32),
        depth_true=true.astype(np.float32),
        mask=mask.astype(np.uint8),
        camera=Camera(width, height, float(width), float(width), width / 2 - 0.5, height / 2 - 0.5),
        instances=tuple(instances),
    )


def by_name(rows: Sequence[Row]) -> dict[tuple[str, str], Row]:
    found = {(row.grid, row.subset): row for row in rows}
    assert len(found) == len(rows)
    return found


def random_depths(size: tuple[int, int], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Prediction (with holes of every kind) and truth, (height, width) each."""
    rng = np.random.default_rng(seed)
    shape = (size[1], size[0])
    true = rng.uniform(0.4, 1.2, shape).astype(np.float32)
    pred = (true * rng.normal(1, 0.05, shape)).astype(np.float32)
    for bad in (0, -0.5, np.nan, np.inf):
        pred[rng.random(shape) < 0.03] = bad
    true[rng.random(shape) < 0.2] = 0
    return pred, true
