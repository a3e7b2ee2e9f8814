"""Base class of the filling methods with their common settings; raw and nearest depth.

Raw depth is the sensor's own and the baseline of every table.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.plugins import configured

Number = TypeVar("Number", bound=np.generic)


@dataclass(frozen=True, kw_only=True)
class FillSettings:
    """Settings common to all filling methods.

    Attributes:
        mask: `holes` fills pixels without a measurement; `objects` first drops the measurements
            inside the view's mask, because the sensor's depth of transparent and specular objects
            is often wrong and not missing.
        grow_px: by how many pixels `objects` widens the mask before it drops; measurements beside
            such an object are often wrong too.
        speckle_px: connected patches of fewer measured pixels than this stay, but nothing is
            filled from them: a wild measurement in the middle of a hole would fill half of it.

    Raises:
        ToolkitError: a value outside its range.
    """

    mask: Literal["holes", "objects"] = "holes"
    grow_px: int = 0
    speckle_px: int = 0

    def __post_init__(self) -> None:
        check_range("grow_px", self.grow_px, 0, 200)
        check_range("speckle_px", self.speckle_px, 0, 1_000_000)


def check_range(name: str, value: float, least: float, most: float) -> None:
    """Refuses a setting that is not a number from `least` to `most`.

    Raises:
        ToolkitError: it is outside, or NaN.
    """
    if not least <= value <= most:
        raise ToolkitError(f"must be from {least:g} to {most:g}", field=name, value=value)


class Filler(ABC):
    """A restorer that keeps every measurement it trusts and fills the other pixels.

    A subclass says how, in `fill`. A view without any trusted measurement stays empty (0 is "no
    answer"); one without a pixel to fill comes back as it is. Multiplying the depth of a view by a
    factor multiplies the answer by the same.

    Args:
        options: only `settings` matters: those of `settings_type`.

    Raises:
        ToolkitError: an unknown setting, or a value that it cannot take.
    """

    name: ClassVar[str]
    settings_type: ClassVar[type[FillSettings]] = FillSettings
    input_size: tuple[int, int] | None = None

    def __init__(self, options: MethodOptions | None = None) -> None:
        given = (options or MethodOptions()).settings
        self.settings = configured(self.settings_type(), given)
        self.needs_mask = self.settings.mask == "objects"

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """Fill each view.

        Raises:
            ToolkitError: colour, depth, mask and camera of a view differ in size, or the mask that
                `mask=objects` needs is not there.
        """
        return [self._restored(view) for view in views]

    @abstractmethod
    def fill(
        self,
        color: NDArray[np.uint8],
        depth: NDArray[np.float64],
        missing: NDArray[np.bool_],
        camera: Camera,
    ) -> NDArray[np.floating]:
        """Depth of the missing pixels.

        Args:
            color: (h, w, 3) uint8 RGB.
            depth: (h, w) float64 metres, 0 at the missing pixels.
            missing: (h, w) bool, neither all true nor all false.
            camera: intrinsics at this size.

        Returns:
            (h, w) metres; only the values at missing pixels count, and of these only the finite
            and positive ones.
        """

    def _restored(self, view: View) -> Restored:
        _check_sizes(view)
        measured = measured_pixels(view.depth)
        if self.needs_mask:
            measured &= ~self._doubted(view)
        kept = np.where(measured, view.depth, np.float32(0)).astype(np.float32, copy=False)
        known = measured & ~_speckles(measured, self.settings.speckle_px)
        if measured.all() or not known.any():
            return Restored(depth=kept)
        trusted = np.where(known, kept, 0).astype(np.float64)
        answer = self.fill(view.color, trusted, ~known, view.camera)
        filled = np.asarray(answer, dtype=np.float32)
        usable = ~measured & measured_pixels(filled)
        return Restored(depth=np.where(usable, filled, kept))

    def _doubted(self, view: View) -> NDArray[np.bool_]:
        if view.mask is None:
            raise ToolkitError(
                f"method `{self.name}` with mask=objects needs to know the pixels of the objects, "
                "and this view has no mask",
                field="mask",
                hint="use mask=holes, or data whose frames have instance masks",
            )
        reach = self.settings.grow_px
        if not reach:
            return view.mask
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        return cv2.dilate(view.mask.astype(np.uint8), disc).astype(bool)


def measured_pixels(depth: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(h, w) pixels that hold a depth: finite and positive."""
    return np.asarray(np.isfinite(depth) & (depth > 0))


def _speckles(measured: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """(h, w) pixels of the connected measured patches of fewer than `least` pixels."""
    if least < 2:
        return np.zeros_like(measured)
    _, label, stats, _ = cv2.connectedComponentsWithStats(measured.astype(np.uint8))
    return np.asarray(measured & (stats[:, cv2.CC_STAT_AREA] < least)[label])


def _check_sizes(view: View) -> None:
    size = (view.camera.height, view.camera.width)
    shapes = {"depth": view.depth.shape, "color": view.color.shape[:2]}
    if view.mask is not None:
        shapes["mask"] = view.mask.shape
    for name, shape in shapes.items():
        if shape != size:
            raise ToolkitError(
                f"is not of the camera's size {size[1]}x{size[0]}", field=name, value=shape
            )


class Raw:
    """Gives back what the sensor measured; 0 ("no answer") where it measured nothing.

    Raises:
        ToolkitError: any setting at all.
    """

    input_size: tuple[int, int] | None = None
    needs_mask = False

    def __init__(self, options: MethodOptions | None = None) -> None:
        for name in (options or MethodOptions()).settings:
            raise ToolkitError("method `raw` has no settings", field=name)

    def restore(self, views: Sequence[View]) -> list[Restored]:
        return [
            Restored(np.where(measured_pixels(v.depth), v.depth, 0).astype(np.float32))
            for v in views
        ]


class Nearest(Filler):
    """Every missing pixel takes the depth of the measured pixel nearest to it in the image.

    The distance is Euclidean, in pixels. It is the simplest filling there is and the least that
    any other must beat.
    """

    name = "nearest"

    def fill(
        self,
        color: NDArray[np.uint8],  # noqa: ARG002
        depth: NDArray[np.float64],
        missing: NDArray[np.bool_],
        camera: Camera,  # noqa: ARG002
    ) -> NDArray[np.floating]:
        return fill_nearest(depth, missing)


def fill_nearest(values: NDArray[Number], missing: NDArray[np.bool_]) -> NDArray[Number]:
    """(h, w) values, those at missing pixels replaced by that of the nearest other pixel."""
    rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return values[rows, columns]


def filled_prompt(depth: Floats, holes: Literal["nearest", "median"]) -> Floats:
    """The sensor's depth without holes.

    Args:
        depth: (h, w) metres, 0 where nothing was measured, but not everywhere.
        holes: what they are filled with: the nearest measurement, or the median of all.

    Returns:
        (h, w) float32 metres, of two values at least: the network divides by their range.
    """
    there = depth > 0
    filled = fill_nearest(depth, ~there) if holes == "nearest" else depth.copy()
    filled[filled == 0] = np.median(depth[there])
    if np.ptp(filled) == 0:
        filled[0, 0] *= np.float32(1 + 1e-6)
    return filled.astype(np.float32)
