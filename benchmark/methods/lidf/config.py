"""Sizes of LIDF, where it looks, and which pixels it restores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, kw_only=True)
class LIDFConfig:
    """LIDF; the defaults are the published network.

    Attributes:
        predict: `all` predicts every pixel anew, as the published evaluation does; `missing` keeps
            what the sensor measured and is believed.
        mask: what is believed. `objects` drops the measurements on transparent and specular
            objects, which the method must be told, as in the published evaluation; `holes`
            believes all measurements.
        refine: whether the second stage follows the first.
        channels: of the first level of the network for colour.
        blocks: of its four levels; those of ResNet-34.
        color_features: channels that it gives every pixel.
        point_channels: of the network for points: of its first layer, the others have two and
            four times as many.
        head: widths of the three layers of a head.
        low, high: metres, x, y and z of the first and the last voxel's centre: the corners of the
            volume, which is half a voxel larger on every side.
        voxel: metres, side of a voxel.
        valid_points: measurements that an image's voxels are made of, at most.
        train_rays: pixels predicted per image in training, at most.
        rays_at_once: pixels predicted at once where nothing is learned; bounds the memory.
        refine_reach: metres that a step of the second stage can move a point either way.
        refine_steps: of the second stage.
        input_size: (width, height) of the images.

    Raises:
        ToolkitError: a size or number that must be positive and is not.
    """

    predict: Literal["all", "missing"] = "all"
    mask: Literal["objects", "holes"] = "objects"
    refine: bool = True
    channels: int = 64
    blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    color_features: int = 32
    point_channels: int = 32
    head: tuple[int, int, int] = (256, 128, 64)
    low: tuple[float, float, float] = (-1.0, -1.0, 0.0)
    high: tuple[float, float, float] = (1.0, 1.0, 2.0)
    voxel: float = 0.25
    valid_points: int = 10_000
    train_rays: int = 20_000
    rays_at_once: int = 8192
    refine_reach: float = 0.2
    refine_steps: int = 2
    input_size: tuple[int, int] = (320, 240)

    def __post_init__(self) -> None:
        for name in ("voxel", "valid_points", "train_rays", "rays_at_once"):
            value = getattr(self, name)
            if not value > 0:
                raise ToolkitError("must be positive", field=name, value=value)


PRESETS = {
    "published": LIDFConfig(),
    "compact": LIDFConfig(channels=32, blocks=(2, 2, 2, 2), head=(128, 64, 32)),
}
