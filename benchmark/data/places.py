"""Finding the folder of a split below what a user gives as root."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

# Folder names that mean one split of one data set: where they are met, it is not another's.
_NAMES = (
    ("dreds-catknown", "dreds-catnovel", "std-catknown", "std-catnovel"),
    ("train", "val", "test"),
    ("real-val", "real-known", "real-test", "real-novel", "synthetic-val", "synthetic-test"),
)
# What archives and users put around the data sets.
_WRAPPERS = (
    "", "dreds", "std", "cleargrasp", "cleargrasp-dataset-test-val", "data", "data/dreds",
    "data/std", "data/cleargrasp", "data/cleargrasp-dataset-test-val",
    "cleargrasp/cleargrasp-dataset-test-val",
)  # fmt: skip


@dataclass(frozen=True)
class Place:
    """Where the scenes of a split may lie.

    Attributes:
        folders: below the root or one of the usual folders around it, the best first; several
            levels parted by "/". Upper and lower case, `-` and `_` are the same.
        data_set: folder name of the data set, "" for any.
        part: whether the data set has parts, so that the folder's name must not be another's.
    """

    folders: tuple[str, ...]
    data_set: str = ""
    part: bool = False

    def find(self, root: Path) -> Path | None:
        """The folder, or None. The root itself is taken where nothing about it says that it is
        another split's or holds several.
        """
        for wrapper in _WRAPPERS:
            for folder in self.folders:
                found = _descend(root, (*wrapper.split("/"), *folder.split("/")))
                if found is not None and not self._is_rival(found):
                    return found
        if not root.is_dir() or self._is_rival(root):
            return None
        every = {name for names in (*_NAMES, *(w.split("/") for w in _WRAPPERS)) for name in names}
        if any(_plain(p.name) in every for p in _folders(root)):
            return None
        return root

    def _is_rival(self, folder: Path) -> bool:
        parts = [_plain(p) for p in folder.resolve().parts[-3:]]
        data_sets = {p for p in parts if p in _NAMES[0]}
        if data_sets and _plain(self.data_set) not in data_sets:
            return True
        if not self.part:
            return False
        told = [p for p in parts if p in (*_NAMES[1], *_NAMES[2])]
        own = {_plain(f.rsplit("/", 1)[-1]) for f in self.folders}
        return bool(told) and told[-1] not in own


def find_all(root: Path, folders: Sequence[str]) -> list[Path]:
    """Those of these folders that are below the root or one of the usual folders around it."""
    for wrapper in _WRAPPERS:
        found = [_descend(root, (*wrapper.split("/"), f)) for f in folders]
        if any(found):
            return [f for f in found if f is not None]
    return []


def _descend(root: Path, parts: tuple[str, ...]) -> Path | None:
    place = root
    for part in parts:
        if not part:
            continue
        below = next((p for p in _folders(place) if _plain(p.name) == _plain(part)), None)
        if below is None:
            return None
        place = below
    return place if place.is_dir() else None


def _folders(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            return sorted(folder / e.name for e in entries if e.is_dir())
    except OSError:
        return []


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")
