"""Frames resized to a method's input, and its output resized to the frame.

Resized frames contain no ground truth.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame, Material, nearest_indices, resize_nearest
from benchmark.methods.protocol import Restored, Restorer, View

# Metres: neighbours farther apart are not of one surface; and how far the sensor may be from
# what was restored around it, to be believed.
_EDGE, _NEAR = 0.015, 0.01

_TRUSTED = 0.5

_BEYOND = 1e6  # metres, farther than anything

Depth = NDArray[np.float32]


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


def restorer_view(
    frame: DepthFrame, restorer: Restorer, size: tuple[int, int] | None = None
) -> View:
    """What a restorer sees of a frame.

    Args:
        frame: with colour and raw depth.
        restorer: that will see it.
        size: (width, height) at which a protocol makes the views, as the released evaluation does,
            for a restorer that has no size of its own; None for that of the ground truth.
    """
    return view_of(
        frame,
        restorer.input_size or size,
        with_mask=restorer.needs_mask,
        color_nearest=size is not None,
    )


def at_full_size(sensor: Depth, answer: Restored) -> Depth:
    """A restored map at the size of the sensor's own.

    Where the method trusts the sensor, and the sensor is near what was restored there, its own
    pixels are kept, which have all details. Elsewhere restored depth is enlarged: linearly on a
    surface, by the nearest pixel across an edge, so that nothing floats between surfaces. A map
    that has the sensor's size already is the method's own, whatever the sensor says.

    Args:
        sensor: (H, W) metres, 0 where nothing was measured.
        answer: at the size that the method works at, whose pixels were taken out of the sensor's
            map (`resize_nearest`). Without confidence, the sensor is believed where it is near.

    Returns:
        (H, W) metres, 0 where there is no answer.
    """
    depth = np.where(np.isfinite(answer.depth) & (answer.depth > 0), answer.depth, 0)
    depth = depth.astype(np.float32)
    if depth.shape == sensor.shape:
        return depth
    square = np.ones((3, 3), np.uint8)
    answered = depth > 0
    # A pixel without an answer is no near surface.
    least = cv2.erode(np.where(answered, depth, np.float32(_BEYOND)), square)
    most, whole = cv2.dilate(depth, square), cv2.erode(answered.astype(np.uint8), square)
    enlarge = _Enlarge(depth.shape, sensor.shape)
    near, far = enlarge(least), enlarge(most)
    found = enlarge(depth)
    smooth = (far - near < _EDGE) & (enlarge(whole) > 0)
    found[smooth] = enlarge(depth, cv2.INTER_LINEAR)[smooth]
    believed = (sensor > 0) & (sensor > near - _NEAR) & (sensor < far + _NEAR)
    if answer.confidence is not None:
        believed &= enlarge(answer.confidence, cv2.INTER_LINEAR) >= _TRUSTED
    return np.where(believed, sensor, found)


class _Enlarge:
    """Enlarges maps whose pixels were taken out of a larger one."""

    def __init__(self, size: tuple[int, ...], wanted: tuple[int, ...]) -> None:
        rows, columns = (
            np.interp(np.arange(large), nearest_indices(large, small), np.arange(small))
            for small, large in zip(size, wanted, strict=True)
        )
        self._x, self._y = (each.astype(np.float32) for each in np.meshgrid(columns, rows))

    def __call__(self, image: NDArray[Any], how: int = cv2.INTER_NEAREST) -> Depth:
        found = cv2.remap(
            np.asarray(image, np.float32), self._x, self._y, how, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(found, np.float32)
