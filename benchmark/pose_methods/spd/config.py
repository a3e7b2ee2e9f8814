"""Sizes of SPD."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from benchmark.metrics.pose.classes import DREDS_CLASSES


@dataclass(frozen=True, kw_only=True)
class PriorNetworkConfig:
    """What networks that deform a prior share.

    Attributes:
        categories: class 1 and the following, in the order of their numbers.
        priors: file of priors, or `builtin`.
        prior_points: of a prior.
        side: of the patch of colour, pixels; a multiple of 8.
        points: of an object.
        color_width, color_blocks, color_decoder: see `PatchFeatures`.
        color: channels of the colour features of a point.
        geometry: channels of the geometry features of a point.
        width: channels of the features of a whole object.
        hidden: widths of the heads.
        centred: whether points are moved so that their mean is at 0, and divided by their mean
            distance from it. As published they are in metres in the camera frame, so that a network
            must learn places that it was never shown.
        input_size: (width, height) of the frames that patches are cut out of.
        trained_on: depth that the points of training come from.
        masks: whose masks objects are cut out by: a pose method that segments, such as `nocs`, or
            `true` for those of the ground truth.
        mask_preset, mask_weights: of that method; by default the weights that come with it.
        fit: `ransac` with a metric threshold, or `paper`: least squares over all points.
        threshold_m: largest distance of an inlier, metres.
    """

    categories: tuple[str, ...] = DREDS_CLASSES[1:]
    priors: str = "builtin"
    prior_points: int = 1024
    side: int = 192
    points: int = 1024
    color_width: int = 64
    color_blocks: tuple[int, ...] = (2, 2, 2, 2)
    color_decoder: tuple[int, ...] = (256, 64, 64, 32)
    color: int = 64
    geometry: int = 64
    width: int = 1024
    hidden: tuple[int, ...] = (512, 256)
    centred: bool = False
    input_size: tuple[int, int] = (640, 360)
    trained_on: Literal["raw", "true"] = "raw"
    masks: str = "nocs"
    mask_preset: str = "published"
    mask_weights: str | None = None
    fit: Literal["ransac", "paper"] = "ransac"
    threshold_m: float = 0.02


@dataclass(frozen=True, kw_only=True)
class SPDConfig(PriorNetworkConfig):
    """The network; see `PriorNetworkConfig`."""


_PUBLISHED = SPDConfig()

PRESETS = {
    "published": _PUBLISHED,
    "compact": replace(
        _PUBLISHED,
        side=96,
        points=512,
        color_width=32,
        color_decoder=(64, 32, 32, 32),
        width=256,
        hidden=(256, 128),
        centred=True,
    ),
}
