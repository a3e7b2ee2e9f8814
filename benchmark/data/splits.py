"""Splits by name: how each is opened, and where its data come from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmark.data.source import DepthSource
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry


@dataclass(frozen=True)
class Published:
    """How many frames someone says that a split has.

    Attributes:
        source: who says so.
        scenes: how many scenes, where that is said.
        of_more: what is counted together, where it is more than the split.
    """

    source: str
    frames: int
    scenes: int | None = None
    of_more: str = ""


@dataclass(frozen=True)
class Split:
    """A named part of a data set.

    Attributes:
        name: as on the command line.
        about: what it is, in a line.
        layout: where its files are expected, for a user who has none yet.
        open: makes the source of a root folder; it may search below it.
        page: address of the data set's page.
        download: addresses of the files.
        published: frame counts of papers and pages. They need not agree.
    """

    name: str
    about: str
    layout: str
    open: Callable[[Path], DepthSource]
    page: str = ""
    download: tuple[str, ...] = ()
    published: tuple[Published, ...] = ()


_MODULE = "benchmark.data.known_splits"

splits: Registry[Split] = Registry(
    "std_toolkit.splits",
    {
        "dreds-catknown-train": f"{_MODULE}:DREDS_CATKNOWN_TRAIN",
        "dreds-catknown-val": f"{_MODULE}:DREDS_CATKNOWN_VAL",
        "dreds-catknown-test": f"{_MODULE}:DREDS_CATKNOWN_TEST",
        "dreds-catnovel": f"{_MODULE}:DREDS_CATNOVEL",
        "std-catknown": f"{_MODULE}:STD_CATKNOWN",
        "std-catnovel": f"{_MODULE}:STD_CATNOVEL",
        "cleargrasp-real-known": f"{_MODULE}:CLEARGRASP_REAL_KNOWN",
        "cleargrasp-real-novel": f"{_MODULE}:CLEARGRASP_REAL_NOVEL",
        "cleargrasp-synthetic": f"{_MODULE}:CLEARGRASP_SYNTHETIC",
        "scenes": f"{_MODULE}:SCENES",
        "std-export": f"{_MODULE}:STD_EXPORT",
    },
)


def get_split(name: str) -> Split:
    """A split by its name, or by `package.module:SPLIT`.

    Raises:
        ToolkitError: no such split; the known ones are named.
    """
    split = splits.get(name)
    if not isinstance(split, Split):
        raise ToolkitError("is no benchmark.data.splits.Split", field="split", value=name)
    return split


def open_split(name: str, root: Path | str) -> DepthSource:
    """The frames of a split below a folder; see `Place` for how tolerant the search is.

    Raises:
        ToolkitError: no such split, no such folder, or nothing of the split below it.
    """
    split = get_split(name)
    root = Path(root)
    if not root.is_dir():
        raise ToolkitError("no such folder", path=root, hint=where_to_get(split))
    return split.open(root)


def where_to_get(split: Split) -> str:
    """What to do about a split that is not there."""
    text = f"{split.name} is expected as {split.layout}"
    return f"{text}; download: {split.page}" if split.page else text
