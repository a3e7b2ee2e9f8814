"""A frame as a method may see it: at the method's size, without the ground truth."""

from __future__ import annotations

import cv2

from benchmark.data.frame import DepthFrame, Material
from benchmark.methods.protocol import View
from benchmark.metrics.resize import resize_nearest


def view_of(
    frame: DepthFrame,
    size: tuple[int, int] | None,
    *,
    with_mask: bool = False,
    color_nearest: bool = False,
) -> View:
    """Colour and raw depth at one size.

    Args:
        size: (width, height), or None for that of the ground truth.
        with_mask: whether to tell the pixels of transparent and specular objects.
        color_nearest: shrink colour by taking the nearest pixel, as the released evaluation does,
            and not by averaging the pixels that fall together.
    """
    camera = frame.camera if size is None else frame.camera.resized(*size)
    size = camera.size
    if color_nearest:
        color = resize_nearest(frame.color, size)
    else:
        shrinks = frame.color.shape[1] >= size[0] and frame.color.shape[0] >= size[1]
        way = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        color = frame.color
        if (color.shape[1], color.shape[0]) != size:
            color = cv2.resize(color, size, interpolation=way)  # type: ignore[assignment]
    mask = None
    if with_mask:
        doubted = frame.mask_of(Material.TRANSPARENT, Material.SPECULAR)
        mask = resize_nearest(doubted, size)
    return View(color, resize_nearest(frame.depth_raw, size), camera, mask)
