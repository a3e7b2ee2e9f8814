"""A frame to score: sensor data and ground truth, selections of objects, resizing.

Objects are selected by material, category, and whether they are distractors. Nearest-neighbour
resizing uses the same indices as `torch.nn.functional.interpolate`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import lru_cache
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.infrared import InfraredPair
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.scene.model import CATEGORY_CLASS_IDS

Size = tuple[int, int]  # (width, height), as everywhere in the toolkit

T = TypeVar("T", bound=np.generic)

BACKGROUND = 255  # mask value of pixels without an instance, as in STD and DREDS

OTHER = 0


@lru_cache(maxsize=256)
def nearest_indices(length: int, wanted: int) -> NDArray[np.intp]:
    """Return the source index of each of `wanted` samples.

    Args:
        length: samples along an axis of the source.
        wanted: samples along that axis of the result.

    Returns:
        (wanted,) read-only indices: `floor(i * length / wanted)` with quotient, product and floor
        in float32, as in torch for float32 tensors. Another precision gives a different index for
        about one pair of lengths in sixty.

    Raises:
        ToolkitError: a length below 1, or above 2**24, where float32 is not exact for integers.

    >>> nearest_indices(5, 3).tolist()
    [0, 1, 3]
    """
    for name, value in (("length", length), ("wanted", wanted)):
        if not 1 <= value <= 2**24:
            raise ToolkitError("is no length of an image", field=name, value=value)
    scale = np.float32(length) / np.float32(wanted)
    exact = np.floor(np.arange(wanted, dtype=np.float32) * scale)
    indices = np.minimum(exact.astype(np.intp), length - 1)
    indices.flags.writeable = False
    return indices


@lru_cache(maxsize=32)
def pixels_taken(size: Size, *steps: Size) -> NDArray[np.intp] | None:
    """Return the source pixels of an image that is resized to each of `steps` in turn.

    Args:
        size: (width, height) of the image.
        steps: intermediate sizes, and last the size of the result.

    Returns:
        (height * width of the last step,) read-only indices into the flat image, row by row;
        None if no pixel moves.

    Raises:
        ToolkitError: a size without pixels.

    >>> pixels_taken((4, 2), (2, 2)).tolist()
    [0, 2, 4, 6]
    >>> pixels_taken((4, 2), (4, 2)) is None
    True
    """
    columns, rows = nearest_indices(size[0], size[0]), nearest_indices(size[1], size[1])
    before = size
    for step in steps:
        columns = columns[nearest_indices(before[0], step[0])]
        rows = rows[nearest_indices(before[1], step[1])]
        before = step
    if before == size and all(step == size for step in steps):
        return None
    taken = (rows[:, None] * size[0] + columns).ravel()
    taken.flags.writeable = False
    return taken


def resize_nearest(image: NDArray[T], size: Size) -> NDArray[T]:
    """Resize an image with nearest-neighbour sampling.

    Args:
        image: (H, W) or (H, W, C) of any type.
        size: wanted (width, height).

    Returns:
        (height, width) or (height, width, C); always a new array.

    Raises:
        ToolkitError: not an image, or a size without pixels.

    >>> resize_nearest(np.arange(8).reshape(2, 4), (2, 1)).tolist()
    [[0, 2]]
    """
    if image.ndim not in (2, 3):
        raise ToolkitError("must be (H, W) or (H, W, C)", field="image", value=image.shape)
    rows = nearest_indices(image.shape[0], size[1])
    columns = nearest_indices(image.shape[1], size[0])
    return image.take(rows, axis=0).take(columns, axis=1)


class Material(IntEnum):
    """Material class of an instance, numbered as in the DREDS `_meta.txt`."""

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
        category, model: names of its category and CAD model, empty if the data set has none.
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
        scene, name: names of scene and frame, together unique within the split.
        color: (H, W, 3) uint8 RGB.
        depth_raw: (h, w) float32 metres, z-depth aligned to the colour image; 0 if not measured.
        depth_true: (k, l) float32 metres, z-depth; 0 where there is no ground truth.
        mask: (k, l) uint8 instance ids, `BACKGROUND` elsewhere.
        camera: intrinsics at the size of `depth_true`.
        instances: the objects of `mask`.
        nocs: (k, l, 3) float32 x y z in [0, 1], not flipped, 0 in the background; or None.
        infrared: the infrared pair, if a method asks for it.

    Colour and raw depth may be omitted if a frame is loaded only to score depth restored earlier;
    they are then (0, 0, 3) and (0, 0).

    Raises:
        ToolkitError: inconsistent shapes, or a mask id without an instance.
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
    infrared: InfraredPair | None = None

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
        # A histogram takes 0.5 ms at 1280x720, np.unique 3 ms.
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
        """Return the (k, l) mask of instances of these materials; of all instances by default."""
        return self.mask_where(lambda i: not materials or i.material in materials)

    def mask_where(self, wanted: Callable[[Instance], bool]) -> NDArray[np.bool_]:
        """Return the (k, l) mask of the instances for which `wanted` is true."""
        table = np.zeros(256, np.uint8)
        table[[i.mask_id for i in self.instances if wanted(i)]] = 1
        return cv2.LUT(np.ascontiguousarray(self.mask), table).view(np.bool_)


@dataclass(frozen=True)
class Selection:
    """A selection of objects.

    Attributes:
        materials: material classes; empty for all.
        categories: names, such as "mug"; empty for all.
        distractors: whether to include objects without a category (class 0, "other").
            Category-novel sets and ClearGrasp have only such objects.

    Example:
        >>> glass = Instance(3, 6, Material.TRANSPARENT, "mug")
        >>> Selection(materials=frozenset({Material.SPECULAR})).wants(glass)
        False
        >>> Selection(categories=frozenset({"mug"}), distractors=False).wants(glass)
        True
    """

    materials: frozenset[Material] = frozenset()
    categories: frozenset[str] = frozenset()
    distractors: bool = True

    def wants(self, instance: Instance) -> bool:
        """Whether an object is selected."""
        if self.materials and instance.material not in self.materials:
            return False
        if self.categories and instance.category not in self.categories:
            return False
        return self.distractors or instance.class_id != OTHER

    def mask(self, frame: DepthFrame) -> NDArray[np.bool_]:
        """Return the (k, l) mask of the selected objects."""
        return frame.mask_where(self.wants)


def selection_of(
    *, materials: list[str] | None = None, categories: list[str] | None = None, distractors: bool
) -> Selection:
    """Create a selection from names, as given on a command line.

    Args:
        materials: names among raw, diffuse, transparent, specular.
        categories: names among the seven categories of the data sets; "other" for the rest.

    Raises:
        ToolkitError: unknown material or category.
    """
    chosen = []
    for name in materials or []:
        if name.upper() not in Material.__members__:
            known = ", ".join(m.name.lower() for m in Material)
            raise ToolkitError("no such material", field="material", value=name, hint=known)
        chosen.append(Material[name.upper()])
    for name in categories or []:
        if name not in CATEGORY_CLASS_IDS:
            raise ToolkitError(
                "no such category", field="category", value=name, hint=", ".join(CATEGORY_CLASS_IDS)
            )
    return Selection(frozenset(chosen), frozenset(categories or []), distractors)
