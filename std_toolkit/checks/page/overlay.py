"""Images of the report: the frame as JPEG, the labels as vector outlines above it.

Vector outlines stay sharp at any zoom and can be hidden.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.contours import Contour
from std_toolkit.checks.measure.residuals import LabelledView, open_for_work, render_view
from std_toolkit.html.page import Picture
from std_toolkit.options import CheckOptions

CROP_MARGIN = 0.25
SMALLEST_CROP_PX = 96
PANEL_WIDTH = 480
ERROR_LIMIT_M = 0.02
_MISSING_RGB = (58, 58, 64)
_NOTHING_RGB = (246, 247, 249)
# Blue - white - red after ColorBrewer's RdBu: in front of the truth, correct, behind it.
_DIVERGING = np.array(
    [[33, 102, 172], [146, 197, 222], [250, 250, 250], [244, 165, 130], [178, 24, 43]], float
)


@dataclass(frozen=True)
class DepthPanel:
    """Sensor depth, ground truth and their difference in one frame.

    Attributes:
        sensor, truth, error: pictures of equal size.
        near_m, far_m: ends of the colour scale of both depths.
    """

    sensor: Picture
    truth: Picture
    error: Picture
    near_m: float
    far_m: float


@dataclass(frozen=True)
class FramePictures:
    """All pictures of one frame.

    Attributes:
        frame: frame id.
        overview: the whole frame with all labels; None if only close-ups were requested.
        closeups: by object id.
        depth: None without sensor depth.
    """

    frame: int
    overview: Picture | None
    closeups: dict[int, Picture]
    depth: DepthPanel | None


@dataclass(frozen=True)
class DrawingOrder:
    """Requested images of a frame.

    Attributes:
        frame: frame id.
        overview: the whole frame.
        closeups: object ids.
        depth: the depth panel.
    """

    frame: int
    overview: bool
    closeups: tuple[int, ...]
    depth: bool


def draw_frame(
    order: DrawingOrder, *, root: Path, fingerprint: str, options: CheckOptions
) -> FramePictures:
    """Draw the requested images of one registered frame.

    Raises:
        ToolkitError: a file of the frame is missing or damaged.
    """
    scene, caster = open_for_work(root, fingerprint)
    frame = scene.frame(order.frame)
    view = render_view(scene, caster, frame)
    image = scene.read_color(frame)
    wanted = set(caster.object_ids) if order.overview else set(order.closeups)
    contours = {i: c for i in sorted(wanted) if (c := view.contour(i)) is not None}
    closeups = {
        i: closeup(image, {j: contours[j] for j in contours if j == i}, i, options.jpeg_quality)
        for i in order.closeups
        if i in contours
    }
    sensor = scene.read_depth(frame) if order.depth else None
    return FramePictures(
        order.frame,
        overview(image, contours, options) if order.overview else None,
        closeups,
        None if sensor is None else depth_panel(view, sensor),
    )


def overview(
    image: NDArray[np.uint8], contours: dict[int, Contour], options: CheckOptions
) -> Picture:
    """The whole image, at most `options.image_width` wide, with all outlines."""
    height, width = image.shape[:2]
    scale = min(1.0, options.image_width / width)
    small = _resized(image, round(width * scale), round(height * scale))
    return Picture(
        _jpeg(small, options.jpeg_quality),
        "image/jpeg",
        small.shape[1],
        small.shape[0],
        [(i, svg_path(c.loops, scale=scale, offset=(0, 0))) for i, c in contours.items()],
    )


def closeup(
    image: NDArray[np.uint8], contours: dict[int, Contour], object_id: int, quality: int
) -> Picture:
    """The part of the image around one object, pixels as recorded, 4:3."""
    height, width = image.shape[:2]
    points = contours[object_id].points
    low, high = points.min(axis=0), points.max(axis=0)
    size = (high - low) * (1 + 2 * CROP_MARGIN)
    w = max(size[0], size[1] * 4 / 3, SMALLEST_CROP_PX)
    w, h = int(min(w, width)), int(min(w * 3 / 4, height))
    x = int(np.clip((low[0] + high[0] - w) / 2, 0, width - w))
    y = int(np.clip((low[1] + high[1] - h) / 2, 0, height - h))
    part = image[y : y + h, x : x + w]
    return Picture(
        _jpeg(part, quality),
        "image/jpeg",
        w,
        h,
        [(i, svg_path(c.loops, offset=(x, y))) for i, c in contours.items()],
    )


def depth_panel(view: LabelledView, sensor: NDArray[np.float32]) -> DepthPanel:
    """Sensor depth, ground-truth depth and raw minus truth, coloured."""
    truth = view.truth.depth if view.truth else view.depth
    inside = truth > 0
    reference = sensor[sensor > 0] if not inside.any() else truth[inside]
    near, far = (0.0, 1.0)
    if len(reference):
        near, far = (float(x) for x in np.percentile(reference, [1, 99]))
        # Margin for the table around the objects.
        near, far = near - 0.25 * (far - near) - 0.05, far + 0.25 * (far - near) + 0.05
    error = np.where(inside, sensor - truth, 0)
    error_image = _diverging(error / ERROR_LIMIT_M)
    error_image[~inside] = _NOTHING_RGB
    error_image[inside & (sensor <= 0)] = _MISSING_RGB
    return DepthPanel(
        _png(_depth_image(sensor, near, far, _MISSING_RGB)),
        _png(_depth_image(truth, near, far, _NOTHING_RGB)),
        _png(error_image),
        near,
        far,
    )


def _depth_image(
    depth: NDArray[np.floating], near: float, far: float, nothing: tuple[int, int, int]
) -> NDArray[np.uint8]:
    level = np.clip((depth - near) / max(far - near, 1e-6), 0, 1)
    colored = cv2.applyColorMap((255 * (1 - level)).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    image = cv2.cvtColor(colored, cv2.COLOR_BGR2RGB)
    image[depth <= 0] = nothing
    return image


def _diverging(value: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(H, W, 3) colours of values, -1 blue, 0 white, 1 red."""
    at = (np.clip(value, -1, 1) + 1) / 2 * (len(_DIVERGING) - 1)
    grid = np.arange(len(_DIVERGING))
    return np.stack([np.interp(at, grid, _DIVERGING[:, c]) for c in range(3)], axis=-1).astype(
        np.uint8
    )


def _png(image: NDArray[np.uint8]) -> Picture:
    height, width = image.shape[:2]
    # Nearest neighbour: missing depth must not blend with measured depth.
    small = _resized(
        image, PANEL_WIDTH, round(PANEL_WIDTH * height / width), method=cv2.INTER_NEAREST
    )
    # The highest level takes seven times as long for files that are 4 % smaller.
    data = cv2.imencode(
        ".png", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, 6]
    )[1]
    return Picture(data.tobytes(), "image/png", small.shape[1], small.shape[0])


def _resized(
    image: NDArray[np.uint8], width: int, height: int, *, method: int = cv2.INTER_AREA
) -> NDArray[np.uint8]:
    if image.shape[1] <= width:
        return image
    return cv2.resize(image, (width, height), interpolation=method)  # type: ignore[return-value]


def _jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def svg_path(
    loops: list[NDArray[np.float64]], *, scale: float = 1.0, offset: tuple[float, float]
) -> str:
    """SVG path data of closed loops, in pixels of the drawn picture.

    Args:
        loops: polygons in image pixels, centres at integers.
        scale: pixels of the picture per pixel of the image.
        offset: x, y of the picture's top-left pixel in the image.
    """
    parts = []
    for loop in loops:
        # SVG puts the edge of the first pixel, not its centre, at 0.
        drawn = (loop - offset + 0.5) * scale
        thin = cv2.approxPolyDP(drawn.astype(np.float32).reshape(-1, 1, 2), 0.12, True)
        if len(thin) >= 3:
            parts.append("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in thin.reshape(-1, 2)) + "Z")
    return "".join(parts)
