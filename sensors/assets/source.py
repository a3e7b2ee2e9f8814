"""Where assets come from: built-in sources, and those that are installed as plug-ins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

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
        "procedural": "sensors.assets.procedural.library:ProceduralSource",
        "shapenet": "sensors.assets.shapenet:ShapeNetSource",
        "folder": "sensors.assets.folder:FolderSource",
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
