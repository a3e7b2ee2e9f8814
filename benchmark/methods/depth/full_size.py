"""Frames resized to a method's input, and its output resized to the frame.

Resized frames contain no ground truth.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame, Material, nearest_indices, resize_nearest
from benchmark.methods.protocol import Restored, Restorer, View
from std_toolkit.geometry.camera import Camera

# Metres: neighbours farther apart are not of one surface.
_EDGE = 0.015

# The sensor is believed this near (metres) to what was restored around it, from this confidence on.
# Chosen on simulated validation scenes as the nearest that spoil less than 1 % of good pixels of
# opaque objects: 0.7 %, at 26.1 mm on glass and metal; 1 cm and 0.5 give 3.0 % and 23.8 mm.
_NEAR, _TRUSTED = 0.015, 0.2

# The same for methods without confidence, chosen likewise: with 3 cm DFNet spoils 0.2 and 0.8 % of
# such pixels (objects as they fell, and upright), with 1.5 cm 1.4 and 3.3 %; its error on glass and
# metal is 0.6 to 1.1 mm larger.
_NEAR_ALONE = 0.03

_BEYOND = 1e6  # metres, farther than anything

# What counts as much: a difference in colour (of 255), and a distance in pixels of the answer.
_LIKE, _AROUND = 12.0, 0.7

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
    mask = frame.mask_of(Material.TRANSPARENT, Material.SPECULAR) if with_mask else None
    view = sensor_view(
        frame.color, frame.depth_raw, frame.camera, size, mask=mask, color_nearest=color_nearest
    )
    return view if frame.infrared is None else replace(view, infrared=frame.infrared)


def sensor_view(
    color: NDArray[np.uint8],
    depth: Depth,
    camera: Camera,
    size: tuple[int, int] | None = None,
    *,
    mask: NDArray[np.bool_] | None = None,
    color_nearest: bool = False,
) -> View:
    """What a sensor recorded, at one size.

    Args:
        color: (H, W, 3) uint8 RGB.
        depth: (h, w) float32 metres, 0 where nothing was measured.
        camera: intrinsics at any size of this image.
        size: (width, height) of the view, or None for the camera's.
        mask: pixels to doubt, for a method that needs them.
        color_nearest: as in `view_of`.
    """
    camera = camera if size is None else camera.resized(*size)
    size = camera.size
    if color_nearest:
        color = resize_nearest(color, size)
    elif (color.shape[1], color.shape[0]) != size:
        shrinks = color.shape[1] >= size[0] and color.shape[0] >= size[1]
        way = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        color = cv2.resize(color, size, interpolation=way)  # type: ignore[assignment]
    if mask is not None:
        mask = resize_nearest(mask, size)
    return View(color, resize_nearest(depth, size), camera, mask)


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
        working_size(restorer, frame.camera.size) or size,
        with_mask=restorer.needs_mask,
        color_nearest=size is not None,
    )


def working_size(restorer: Restorer, size: tuple[int, int]) -> tuple[int, int] | None:
    """(width, height) at which a restorer sees images of a size; None where they stay as they are.

    A restorer for images of any size may have `longest`, the pixels of their longer side at most.
    """
    longest = getattr(restorer, "longest", None)
    if restorer.input_size is not None or longest is None or max(size) <= longest:
        return restorer.input_size
    width, height = (max(round(side * longest / max(size)), 1) for side in size)
    return width, height


@dataclass(frozen=True, eq=False)
class FullSize:
    """A restored map at the size of the sensor's own.

    Attributes:
        depth: (H, W) float32 metres, 0 where there is no answer.
        believed: (H, W) bool pixels that are the sensor's own.
        confidence: (H, W) float32 in [0, 1], trust in the sensor; None of methods without it.
        spread: (H, W) float32 metres, expected error of `depth`; None of methods without it.
        clear: (H, W) float32 in [0, 1], probability of glass or metal; likewise.
    """

    depth: Depth
    believed: NDArray[np.bool_]
    confidence: Depth | None = None
    spread: Depth | None = None
    clear: Depth | None = None


def at_full_size(sensor: Depth, answer: Restored) -> Depth:
    """The depth of `to_full_size` without colour.

    A map that has the sensor's size already is the method's own, whatever the sensor says.
    """
    if answer.depth.shape == sensor.shape:
        return _answered(answer.depth)
    return to_full_size(sensor, answer).depth


def to_full_size(
    sensor: Depth, answer: Restored, color: NDArray[np.uint8] | None = None
) -> FullSize:
    """A restored map at the size of the sensor's own.

    Where the method trusts the sensor, and the sensor is near what was restored there, its own
    pixels are kept, which have all details. Elsewhere restored depth is enlarged: linearly on a
    surface; across an edge by one of the pixels around, so that nothing floats between surfaces.
    This is the nearest pixel or, with colour, the median of 3x3 pixels weighted by distance and
    likeness of colour (joint bilateral upsampling, Kopf et al., SIGGRAPH 2007, with the weighted
    median of Ma et al., ICCV 2013, in place of the mean).

    Args:
        sensor: (H, W) metres, 0 where nothing was measured.
        answer: at the size that the method works at, whose pixels were taken out of the sensor's
            map (`resize_nearest`). Without confidence, the sensor is believed where it is near.
        color: (H, W, 3) uint8 RGB, the sensor's, to guide the enlargement.
    """
    depth = _answered(answer.depth)
    square = np.ones((3, 3), np.uint8)
    answered = depth > 0
    # A pixel without an answer is no near surface.
    least = cv2.erode(np.where(answered, depth, np.float32(_BEYOND)), square)
    most = cv2.dilate(depth, square)
    confidence, spread, clear = (
        None if values is None else np.asarray(values, np.float32)
        for values in (answer.confidence, answer.spread, answer.clear)
    )
    if depth.shape == sensor.shape:
        near, far, found = least, most, depth
    else:
        whole = cv2.erode(answered.astype(np.uint8), square)
        enlarge = _Enlarge(depth.shape, sensor.shape)
        near, far = enlarge(least), enlarge(most)
        found = enlarge(depth)
        smooth = (far - near < _EDGE) & (enlarge(whole) > 0)
        if color is not None:
            edge = ~smooth & (found > 0)
            found[edge] = enlarge.guided(depth, color, edge)
        found[smooth] = enlarge(depth, cv2.INTER_LINEAR)[smooth]
        confidence, spread, clear = (
            None if values is None else enlarge(values, cv2.INTER_LINEAR)
            for values in (confidence, spread, clear)
        )
    reach = _NEAR_ALONE if confidence is None else _NEAR
    believed = (sensor > 0) & (sensor > near - reach) & (sensor < far + reach)
    if confidence is not None:
        believed &= confidence >= _TRUSTED
    return FullSize(np.where(believed, sensor, found), believed, confidence, spread, clear)


def _answered(depth: NDArray[np.floating]) -> Depth:
    """Depth with 0 for what is no answer."""
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)


class _Enlarge:
    """Enlarges maps whose pixels were taken out of a larger one."""

    def __init__(self, size: tuple[int, ...], wanted: tuple[int, ...]) -> None:
        self._rows, self._columns = (
            np.interp(np.arange(large), nearest_indices(large, small), np.arange(small))
            for small, large in zip(size, wanted, strict=True)
        )
        self._x, self._y = (
            each.astype(np.float32) for each in np.meshgrid(self._columns, self._rows)
        )

    def __call__(self, image: NDArray[Any], how: int = cv2.INTER_NEAREST) -> Depth:
        found = cv2.remap(
            np.asarray(image, np.float32), self._x, self._y, how, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(found, np.float32)

    def guided(self, depth: Depth, color: NDArray[np.uint8], where: NDArray[np.bool_]) -> Depth:
        """Each pixel of `where`: the median of 3x3 answers, weighted by nearness and like colour.

        Args:
            depth: (h, w) metres, 0 without an answer.
            color: (H, W, 3) uint8 of the result.
            where: (H, W) pixels, around which there is an answer.

        Returns:
            (N,) metres of the N pixels.
        """
        v, u = np.nonzero(where)
        x, y, own = self._x[v, u], self._y[v, u], color[v, u].astype(np.float32)
        # The colours of the very pixels whose depth was taken.
        colors = resize_nearest(color, (depth.shape[1], depth.shape[0])).astype(np.float32)
        column, row = np.rint(x).astype(np.intp), np.rint(y).astype(np.intp)
        values = np.empty((9, len(v)), np.float32)
        weights = np.empty((9, len(v)), np.float32)
        for index, (down, right) in enumerate(np.ndindex(3, 3)):
            r = np.clip(row + down - 1, 0, depth.shape[0] - 1)
            c = np.clip(column + right - 1, 0, depth.shape[1] - 1)
            unlike = colors[r, c] - own
            far = np.einsum("ij,ij->i", unlike, unlike) / np.float32(_LIKE**2)
            far += ((x - c) ** 2 + (y - r) ** 2) / np.float32(_AROUND**2)
            values[index] = depth[r, c]
            # Not zero where no colour is alike: then the nearest count.
            weights[index] = np.where(values[index] > 0, np.exp(-far / 2) + 1e-30, 0)
        order = np.argsort(values, axis=0)
        sums = np.take_along_axis(weights, order, axis=0).cumsum(axis=0)
        middle = np.argmax(sums >= sums[-1] / 2, axis=0)
        chosen = np.take_along_axis(order, middle[None], axis=0)
        return np.take_along_axis(values, chosen, axis=0)[0]
