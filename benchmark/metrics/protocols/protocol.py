"""Evaluation protocols: the pixels and the size of the comparison, and the treatment of holes.

The built-in protocols are the definition in the paper's text with every hole counted (the default),
the paper's released evaluation, the grids and pixels of the evaluations of ClearGrasp and of
TransCG, and depth after an alignment, for methods that know it up to scale and shift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import Instance, Material, Size
from benchmark.metrics.depth.figures import Missing, check_reportable
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry

ALL = frozenset(Material)

# Name of the rows of a range of true depth, in metres.
DEPTH_SUBSET = "depth:{:.2f}-{:.2f}"

HARD = frozenset({Material.TRANSPARENT, Material.SPECULAR})

DIFFUSE = frozenset({Material.RAW, Material.DIFFUSE})

# Classes by `Instance.class_id`; the name that a data set gives to an instance goes before.
CLASS_NAMES = ("other", "bottle", "bowl", "camera", "can", "car", "mug", "aeroplane")

DEFAULT = "strict"

protocols: Registry[Protocol] = Registry(
    "std_toolkit.depth_protocols",
    {
        "strict": "benchmark.metrics.protocols.protocol:STRICT",
        "paper": "benchmark.metrics.protocols.protocol:PAPER",
        "cleargrasp": "benchmark.metrics.protocols.protocol:CLEARGRASP",
        "transcg": "benchmark.metrics.protocols.protocol:TRANSCG",
        "aligned-frame": "benchmark.metrics.protocols.protocol:ALIGNED_FRAME",
        "aligned-clip": "benchmark.metrics.protocols.protocol:ALIGNED_CLIP",
        "transcg-2022-10": "benchmark.metrics.protocols.protocol:TRANSCG_2022_10",
        "clearpose": "benchmark.metrics.protocols.protocol:CLEARPOSE",
        "full-frame": "benchmark.metrics.protocols.protocol:FULL_FRAME",
    },
)


@dataclass(frozen=True)
class Subset:
    """Some of the pixels of a frame's objects.

    Attributes:
        name: name in tables.
        materials: of the objects that belong to it.
        edges: only the pixels beside a step of depth or the outline of an object.
        category: only objects of this category, where given.
        scene: every pixel with ground truth, off the objects too; the others are then ignored.
    """

    name: str
    materials: frozenset[Material] = ALL
    edges: bool = False
    category: str | None = None
    scene: bool = False

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
        """Return the sequence of sizes for a frame with ground truth of size `native`."""
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
        align: `frame` or `clip`: predictions are first mapped to metres by one scale and shift for
            each frame or scene, by least squares over all pixels of the first grid with truth.

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
    align: Literal["", "frame", "clip"] = ""

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

    Args:
        instance: an object of a frame.

    Returns:
        `other` for a class without a name.

    >>> category_of(Instance(1, 6, Material.RAW))
    'mug'
    """
    if instance.category:
        return instance.category
    if 0 <= instance.class_id < len(CLASS_NAMES):
        return CLASS_NAMES[instance.class_id]
    return f"class {instance.class_id}"


STRICT = Protocol(
    name="strict",
    about="126x224 and native resolution; predictions that are missing or not positive cost",
    grids=(Grid("h126w224", (224, 126)), Grid("native", None)),
    subsets=(
        Subset("all"),
        Subset("specular+transparent", HARD),
        Subset("diffuse", DIFFUSE),
        Subset("specular", frozenset({Material.SPECULAR})),
        Subset("transparent", frozenset({Material.TRANSPARENT})),
        Subset("edges", edges=True),
        Subset("specular+transparent edges", HARD, edges=True),
    ),
    missing=Missing.COUNTED,
    depth_bins=tuple(round(0.2 + 0.1 * i, 1) for i in range(19)),
)

# The released code hands (width, height) to a function that takes (rows, columns): its grid has
# 224 rows and 126 columns, the transposed shape of the "126x224" of the text.
PAPER = Protocol(
    name="paper",
    about="the paper's released evaluation, its transposed grid and unclamped predictions included",
    grids=(Grid("h224w126", (126, 224), through=((224, 224),)),),
    subsets=(Subset("all"), Subset("specular+transparent", HARD)),
    missing=Missing.AS_GIVEN,
    view_size=(224, 224),
)

CLEARGRASP = Protocol(
    name="cleargrasp",
    about="256x144, transparent objects with ground truth, as ClearGrasp and LIDF compare",
    grids=(Grid("h144w256", (256, 144)),),
    subsets=(Subset("transparent", frozenset({Material.TRANSPARENT})),),
    missing=Missing.COUNTED,
)

TRANSCG = Protocol(
    name="transcg",
    about="320x240, transparent objects 0.3 to 1.5 m away, as TransCG and DFNet compare",
    grids=(Grid("h240w320", (320, 240)),),
    subsets=(Subset("transparent", frozenset({Material.TRANSPARENT})),),
    missing=Missing.COUNTED,
    depth_range=(0.3, 1.5),
)


ALIGNED_FRAME = Protocol(
    name="aligned-frame",
    about="after one scale and shift a frame, by least squares; truth 0.3 to 1.5 m away; cm",
    grids=(Grid("h126w224", (224, 126)),),
    subsets=(
        Subset("scene", scene=True),
        Subset("all"),
        Subset("specular+transparent", HARD),
    ),
    missing=Missing.COUNTED,
    depth_range=(0.3, 1.5),
    align="frame",
)

ALIGNED_CLIP = replace(
    ALIGNED_FRAME,
    name="aligned-clip",
    about="after one scale and shift a scene, by least squares; truth 0.3 to 1.5 m away; cm",
    align="clip",
)


# As the loader of October 2022: true depth below a tenth of its unit of 1 m is none. The frames of
# the splits `transcg-...-2022-10` are prepared as it prepares them.
TRANSCG_2022_10 = replace(
    TRANSCG,
    name="transcg-2022-10",
    about="320x240, transparent objects beyond 0.1 m, as the release of October 2022 of TransCG",
    depth_range=(0.1, float("inf")),
)

# Which pixels the paper scored is not known; the fork of its first author has the first two.
CLEARPOSE = Protocol(
    name="clearpose",
    about="native size, 0.3 to 3 m away: every pixel, objects, and transparent objects alone",
    grids=(Grid("native", None),),
    subsets=(
        Subset("all"),
        Subset("transparent", frozenset({Material.TRANSPARENT})),
        Subset("scene", scene=True),
    ),
    missing=Missing.COUNTED,
    depth_range=(0.3, 3.0),
)

FULL_FRAME = Protocol(
    name="full-frame",
    about="native size, every pixel with ground truth, objects or not, as users of HAMMER score",
    grids=(Grid("native", None),),
    subsets=(Subset("scene", scene=True), Subset("all"), Subset("specular+transparent", HARD)),
    missing=Missing.COUNTED,
)


def get_protocol(name: str = DEFAULT) -> Protocol:
    """A protocol by its name, or by `package.module:ATTRIBUTE`.

    Args:
        name: one of `protocols.names()`, of an installed plug-in, or a path to one.

    Returns:
        The protocol.

    Raises:
        ToolkitError: no such protocol, or what stands there is none.

    >>> get_protocol().main
    ('h126w224', 'all')
    """
    found = protocols.get(name)
    if not isinstance(found, Protocol):
        raise ToolkitError("is not a Protocol", field=name, value=type(found).__name__)
    return found
