"""One frame to score: what a sensor gave, and what was there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

BACKGROUND = 255  # mask value of pixels that belong to no instance, as STD and DREDS have it


class Material(IntEnum):
    """Material class of an instance, with the numbers of the DREDS `_meta.txt`."""

    RAW = 0
    DIFFUSE = 1
    TRANSPARENT = 2
    SPECULAR = 3


@dataclass(frozen=True)
class Instance:
    """One object of a frame.

    Attributes:
        mask_id: its value in `DepthFrame.mask`, 0 to 254.
        class_id: 0 other or distractor, 1 bottle, 2 bowl, 3 camera, 4 can, 5 car, 6 mug,
            7 aeroplane.
        material: its material class.
        category, model: names of its category and CAD model, empty where the data set has none.
    """

    mask_id: int
    class_id: int
    material: Material
    category: str = ""
    model: str = ""


@dataclass(frozen=True)
class DepthFrame:
    """A colour image, raw depth and ground truth, each at its own resolution.

    Attributes:
        scene, name: together they name the frame within its split.
        color: (H, W, 3) uint8 RGB.
        depth_raw: (h, w) float32 metres, z-depth aligned to the colour image; 0 no measurement.
        depth_true: (k, l) float32 metres, z-depth; 0 where there is no ground truth.
        mask: (k, l) uint8 instance ids, `BACKGROUND` elsewhere.
        camera: intrinsics at the size of `depth_true`.
        instances: the objects of `mask`.
        nocs: (k, l, 3) float32 x y z in [0, 1], not flipped, 0 in the background; or None.

    Colour and raw depth may be left out when a frame is loaded only to score what was restored
    earlier: they are (0, 0, 3) and (0, 0) then.

    Raises:
        ToolkitError: shapes that do not belong together, or a mask id that no instance has.
    """

    scene: str
    name: str
    color: NDArray[np.uint8]
    depth_raw: NDArray[np.float32]
    depth_true: NDArray[np.float32]
    mask: NDArray[np.uint8]
    camera: Camera
    instances: tuple[Instance, ...] = field(default_factory=tuple)
    nocs: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for name in ("depth_true", "mask"):
            if getattr(self, name).shape != size:
                raise ToolkitError(
                    f"is not of the camera's size {self.camera.width}x{self.camera.height}",
                    path=self.key,
                    field=name,
                    value=getattr(self, name).shape,
                )
        known = {i.mask_id for i in self.instances} | {BACKGROUND}
        # A histogram, because np.unique needs 3 ms at 1280x720 instead of 0.5.
        counts = cv2.calcHist([np.ascontiguousarray(self.mask)], [0], None, [256], [0, 256])
        strange = sorted(set(np.flatnonzero(counts).tolist()) - known)
        if strange:
            raise ToolkitError(
                "the mask holds ids that the frame's list of instances does not",
                path=self.key,
                field="mask",
                value=strange,
                hint="mask and _meta.txt must come from the same frame",
            )

    @property
    def key(self) -> str:
        """`scene/name`: unique within a split."""
        return f"{self.scene}/{self.name}"

    def mask_of(self, *materials: Material) -> NDArray[np.bool_]:
        """(k, l) pixels of the instances of any of these materials; of all where none is given."""
        return self.mask_where(lambda i: not materials or i.material in materials)

    def mask_where(self, wanted: Callable[[Instance], bool]) -> NDArray[np.bool_]:
        """(k, l) pixels of the instances that `wanted` says yes to."""
        table = np.zeros(256, np.uint8)
        table[[i.mask_id for i in self.instances if wanted(i)]] = 1
        return cv2.LUT(np.ascontiguousarray(self.mask), table).view(np.bool_)
