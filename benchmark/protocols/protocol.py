"""What an evaluation protocol is: on which pixels, at which size, and what a hole costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import Instance, Material
from benchmark.metrics.missing import Missing, check_reportable
from benchmark.metrics.resize import Size
from std_toolkit.errors import ToolkitError

ALL = frozenset(Material)
# Name of the rows of a range of true depth, in metres.
DEPTH_SUBSET = "depth:{:.2f}-{:.2f}"
HARD = frozenset({Material.TRANSPARENT, Material.SPECULAR})
DIFFUSE = frozenset({Material.RAW, Material.DIFFUSE})
# Classes by `Instance.class_id`; the name that a data set gives to an instance goes before.
CLASS_NAMES = ("other", "bottle", "bowl", "camera", "can", "car", "mug", "aeroplane")


@dataclass(frozen=True)
class Subset:
    """Some of the pixels of a frame's objects.

    Attributes:
        name: as it stands in tables.
        materials: of the objects that belong to it.
        edges: only the pixels beside a step of depth or the outline of an object.
        category: only objects of this category, where given.
    """

    name: str
    materials: frozenset[Material] = ALL
    edges: bool = False
    category: str | None = None

    def has(self, instance: Instance) -> bool:
        """Whether the pixels of an object belong to it (those at edges, where it is of edges)."""
        right = self.category is None or self.category == category_of(instance)
        return right and instance.material in self.materials


@dataclass(frozen=True)
class Grid:
    """The pixels that are compared.

    Attributes:
        name: as it stands in tables: `h126w224` has 126 rows and 224 columns.
        size: (width, height), or None for that of the ground truth.
        through: sizes that ground truth, mask and prediction are resized to before.
    """

    name: str
    size: Size | None
    through: tuple[Size, ...] = ()

    def steps(self, native: Size) -> tuple[Size, ...]:
        """The sizes that a frame goes through whose ground truth is of size `native`."""
        return (*self.through, self.size or native)


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """How restored depth is compared with ground truth.

    Attributes:
        name: as the command line has it.
        about: one line on what it is good for.
        grids: at which sizes; the first is the one of the main tables.
        subsets: on which pixels; the first is the main column.
        missing: what pixels without a usable prediction do to the error.
        view_size: (width, height) that colour, sensor depth and ground truth have before any
            method sees them; None leaves that to the method.
        depth_range: ground truth outside of these metres (both included) is not compared.
        per_category: whether each category gets a row of its own.
        depth_bins: ends, in metres, of ranges of true depth that get a row each on the first grid
            where a frame has pixels in them, for curves of error against depth.

    Raises:
        ToolkitError: no grid, no subset, or two of one name.
    """

    name: str
    about: str
    grids: tuple[Grid, ...]
    subsets: tuple[Subset, ...]
    missing: Missing
    view_size: Size | None = None
    depth_range: tuple[float, float] = (0.0, float("inf"))
    per_category: bool = False
    depth_bins: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_reportable(self.missing)
        for field, parts in (("grids", self.grids), ("subsets", self.subsets)):
            names = [part.name for part in parts]
            if not names or len(set(names)) < len(names):
                raise ToolkitError(
                    "must be given, each under a name of its own",
                    path=self.name,
                    field=field,
                    value=names,
                )

    @property
    def main(self) -> tuple[str, str]:
        """Names of the grid and the subset that methods are ranked by."""
        return self.grids[0].name, self.subsets[0].name

    def subsets_of(self, instances: Sequence[Instance]) -> tuple[Subset, ...]:
        """The subsets of one frame: the same for all frames, and its categories if wanted."""
        if not self.per_category:
            return self.subsets
        found = sorted({category_of(i) for i in instances})
        return (*self.subsets, *(Subset(f"category:{c}", category=c) for c in found))

    def usable(self, true: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Which ground truth is there and in range, of the shape of `true`."""
        low, high = self.depth_range
        # NaN fails both comparisons; the bound at infinity keeps infinity out.
        above = true >= low if low > 0 else true > 0
        return above & (true <= high if np.isfinite(high) else true < np.inf)


def category_of(instance: Instance) -> str:
    """The data set's name of an object's category, or that of its class.

    >>> category_of(Instance(1, 6, Material.RAW))
    'mug'
    """
    if instance.category:
        return instance.category
    if 0 <= instance.class_id < len(CLASS_NAMES):
        return CLASS_NAMES[instance.class_id]
    return f"class {instance.class_id}"
