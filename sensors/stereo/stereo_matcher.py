"""The interface of stereo matchers, and the conversion of disparity to depth."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry

Image = NDArray[np.uint8]
Disparity = NDArray[np.float32]


class StereoMatcher(Protocol):
    """Finds the pixels of a left image in a rectified right one."""

    def match(self, left: Image, right: Image) -> Disparity:
        """Disparity of every pixel of the left image.

        Args:
            left, right: (H, W) uint8, rectified: a point is in the same row of both images, in the
                right one further left by its disparity.

        Returns:
            (H, W) float32 pixels, 0 = none.
        """
        ...


# A plug-in is called with its own options as keywords.
MATCHERS: Registry[Callable[..., StereoMatcher]] = Registry(
    "std_toolkit.stereo_matchers",
    {
        "local": "sensors.stereo.builtin_matchers:local_matcher",
        "dreds": "sensors.stereo.builtin_matchers:dreds_matcher",
        "sgbm": "sensors.stereo.builtin_matchers:sgbm_matcher",
    },
)


def make_matcher(name: str, **options: Any) -> StereoMatcher:
    """The matcher called `name` with its own options.

    Raises:
        ToolkitError: no such matcher or option, or an invalid value.
    """
    maker = MATCHERS.get(name)
    try:
        return maker(**options)
    except TypeError as error:
        raise ToolkitError(
            f"stereo matcher {name}: {error}", field="options", value=options
        ) from error


def check_pair(left: Image, right: Image) -> None:
    """Raise unless the images are 8-bit, grey and of one size."""
    for side, image in (("left", left), ("right", right)):
        if image.dtype != np.uint8 or image.ndim != 2:
            raise ToolkitError(
                "an infrared image must be grey, (H, W) uint8",
                field=side,
                value=f"{image.dtype} {image.shape}",
            )
    if left.shape != right.shape:
        raise ToolkitError(
            "the two infrared images differ in size", value=(left.shape, right.shape)
        )


def disparity_to_depth(
    disparity: NDArray[np.floating],
    *,
    focal_px: float,
    baseline_m: float,
    range_m: tuple[float, float] = (0.0, np.inf),
) -> NDArray[np.float32]:
    """z-depth (H, W) float32 metres; 0 where disparity is 0 or depth is out of range.

    Args:
        disparity: (H, W) pixels of the left image, 0 = none.
        focal_px: fx of both infrared cameras at this image size.
        baseline_m: distance between them.
        range_m: nearest and farthest depth that the sensor reports.
    """
    seen = disparity > 0
    depth = np.zeros(disparity.shape, dtype=np.float64)
    np.divide(focal_px * baseline_m, disparity, out=depth, where=seen, dtype=np.float64)
    depth[(depth < range_m[0]) | (depth > range_m[1])] = 0
    return depth.astype(np.float32)
