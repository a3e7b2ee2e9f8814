"""Asset sources by name, and the size range of each category."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Literal, Protocol

import msgspec
import numpy as np

from sensors.assets.asset import Asset
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry

Split = Literal["train", "test", "all"]

SPLITS: tuple[Split, ...] = ("train", "test", "all")


class AssetSource(Protocol):
    """A collection of assets of one or more categories.

    The same random state gives the same asset on any machine with the same files.
    """

    def categories(self) -> Sequence[str]:
        """Categories of the assets, in a fixed order."""
        ...

    def sample(self, rng: np.random.Generator, category: str) -> Asset:
        """Draw an asset.

        Raises:
            ToolkitError: the category is missing, or the drawn file cannot be used.
        """
        ...

    def load(self, asset_id: str) -> Asset:
        """The asset of an id that `sample` returned.

        Raises:
            ToolkitError: no such asset, or its file cannot be used.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """How to open a source.

    Attributes:
        root: folder of the files, for sources that read files.
        split: "train" and "test" never share an instance; "all" is both.
        unit: unit of the files' coordinates ("m", "cm", "mm"), which gives the assets their real
            size; None if the files have no size; it is then drawn by category.
    """

    root: Path | None = None
    split: Split = "all"
    unit: str | None = None

    def __post_init__(self) -> None:
        if self.split not in SPLITS:
            raise ToolkitError("unknown split", field="split", value=self.split)

    def need_root(self) -> Path:
        """The folder of the files.

        Raises:
            ToolkitError: none was given, or it does not exist.
        """
        if self.root is None:
            raise ToolkitError("this asset source needs the folder of its files", field="root")
        if not self.root.is_dir():
            raise ToolkitError("the folder of assets is not there", path=self.root)
        return self.root


SourceMaker = Callable[[SourceOptions], AssetSource]

ASSET_SOURCES: Registry[SourceMaker] = Registry(
    "std_toolkit.asset_sources",
    {
        "procedural": "sensors.assets.procedural.shape_library:ProceduralSource",
        "shapenet": "sensors.assets.mesh_sources:ShapeNetSource",
        "folder": "sensors.assets.mesh_sources:FolderSource",
    },
)


def open_source(name: str, options: SourceOptions | None = None) -> AssetSource:
    """Open the asset source called `name`.

    Args:
        name: "procedural", "shapenet", "folder", the name of an installed plug-in, or
            `module:attribute`.
        options: folder of the files and the part of them to use.

    Raises:
        ToolkitError: no such source, or its files do not exist.
    """
    return ASSET_SOURCES.get(name)(options or SourceOptions())


def in_split(instance: str, split: Split) -> bool:
    """Whether an instance of a file collection belongs to a split, by its name alone.

    The split of a name does not change when files are added or removed. One in five is in test.
    """
    import hashlib

    if split == "all":
        return True
    number = int.from_bytes(hashlib.sha256(instance.encode()).digest()[:8], "big")
    return (number < 0.2 * 2**64) == (split == "test")


class ScaleTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """scales.json.

    Attributes:
        source: where the numbers come from.
        diagonal_m: smallest and largest bounding-box diagonal of each category, metres; "other"
            applies to all categories without a row.
    """

    source: str
    diagonal_m: dict[str, tuple[float, float]]


@cache
def scale_table() -> ScaleTable:
    """The built-in table."""
    data = resources.files("sensors.assets").joinpath("scales.json").read_bytes()
    return msgspec.json.decode(data, type=ScaleTable)


def scale_range(category: str) -> tuple[float, float]:
    """Smallest and largest bounding-box diagonal of a category, metres."""
    rows = scale_table().diagonal_m
    return rows.get(category, rows["other"])


def draw_diagonal(rng: np.random.Generator, asset: Asset) -> float:
    """Bounding-box diagonal for an object in metres: the real one if known, otherwise drawn."""
    if asset.diagonal_m is not None:
        return asset.diagonal_m
    low, high = scale_range(asset.category)
    return float(rng.uniform(low, high))
