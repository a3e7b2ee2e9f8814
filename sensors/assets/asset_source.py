"""Where assets come from, by name, and how large objects of a category are.

How large objects of a category are.
"""

from __future__ import annotations

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

    The same random state gives the same asset, on any machine that sees the same files.
    """

    def categories(self) -> Sequence[str]:
        """Categories that it has assets of, in a fixed order."""
        ...

    def sample(self, rng: np.random.Generator, category: str) -> Asset:
        """Draw an asset.

        Raises:
            ToolkitError: it has none of this category, or the file drawn cannot be used.
        """
        ...

    def load(self, asset_id: str) -> Asset:
        """The asset of an id that `sample` gave before.

        Raises:
            ToolkitError: no such asset, or its file cannot be used.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """What a source is opened with.

    Attributes:
        root: folder of the files, for sources that read files.
        split: "train" and "test" never share an instance; "all" is both.
        unit: unit of the files' coordinates ("m", "cm", "mm"), which gives the assets their real
            size; None where the files tell no size and it is drawn by category.
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
            ToolkitError: none was given, or it is not there.
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
        name: "procedural", "shapenet", "folder", an installed plug-in's or `module:attribute`.
        options: where its files are and which part of them to use.

    Raises:
        ToolkitError: no such source, or its files are not there.
    """
    return ASSET_SOURCES.get(name)(options or SourceOptions())


def in_split(instance: str, split: Split, *, test_share: float = 0.2) -> bool:
    """Whether an instance of a file collection belongs to a split, by its name alone.

    A name keeps its split when other files come or go. One in five goes to the test split.
    """
    import hashlib

    if split == "all":
        return True
    number = int.from_bytes(hashlib.sha256(instance.encode()).digest()[:8], "big")
    return (number < test_share * 2**64) == (split == "test")


class ScaleTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """scales.json.

    Attributes:
        source: where the numbers come from.
        diagonal_m: smallest and largest bounding-box diagonal of each category, metres; "other"
            stands for all categories without a row.
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
    """Bounding-box diagonal for an object in metres: the real one if known, else drawn."""
    if asset.diagonal_m is not None:
        return asset.diagonal_m
    low, high = scale_range(asset.category)
    return float(rng.uniform(low, high))
