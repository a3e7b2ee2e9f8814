"""The file of each frame in a folder of predictions of another program.

DIR/SCENE/FRAME + suffix. Scenes may lie up to three folders deeper (SET/METHOD/SCENE), and files
without scene folders may be called SCENE_FRAME, or FRAME where no two frames have the name.
"""

import os
from collections import Counter
from collections.abc import Iterator, Sequence, Sized
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

from benchmark.data.splits import FrameKey
from std_toolkit.errors import ToolkitError

_DEEPEST = 3
_MOST_FOLDERS = 20_000
# The largest split has 97,550 frames; more names are another folder, and would fill the memory.
_MOST_NAMES = 500_000


def _at_most_one(found: Sequence[Path], problem: str, hint: str) -> None:
    if len(found) > 1:
        raise ToolkitError(problem, path=found[0], value=str(found[1]), hint=hint)


def _check_count(found: Sized, most: int, folder: Path, what: str) -> None:
    if len(found) > most:
        raise ToolkitError(
            f"more than {most:,} {what}, too many for predictions of a data set",
            path=folder,
            hint="name the folder of one method on one data set",
        )


@contextmanager
def _entries(folder: Path) -> Iterator[Iterator[Any]]:
    """Entries of a folder, one after the other."""
    try:
        with os.scandir(folder) as entries:
            yield entries
    except (FileNotFoundError, NotADirectoryError):
        raise
    except OSError as error:
        raise ToolkitError(f"cannot read the folder: {error.strerror}", path=folder) from error


def names_in(folder: Path) -> list[str]:
    """Return the names in a folder of predictions, in the order of the disk.

    Raises:
        ToolkitError: the folder cannot be read, or has more names than any data set.
        FileNotFoundError, NotADirectoryError: there is no such folder.
    """
    with _entries(folder) as entries:
        names = [entry.name for entry in islice(entries, _MOST_NAMES + 1)]
    _check_count(names, _MOST_NAMES, folder, "files")
    return names


@dataclass(frozen=True)
class FrameFiles:
    """A folder of predictions.

    Attributes:
        content: what its files are, in tables of content.
        suffixes: of its files, with the dot; endings: what may stand between a name and its suffix;
            below: folders below that of a scene in which files may lie.
        folder: the folder.
        split: name of the split.
        keys: all frames; without them, files need a folder for their scene.

    Raises:
        ToolkitError: the folder does not exist.
    """

    content: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    endings: ClassVar[tuple[str, ...]] = ("",)
    below: ClassVar[tuple[str, ...]] = ("",)
    folder: Path
    split: str
    keys: Sequence[FrameKey] = ()
    _listed: dict[Path, frozenset[str]] = field(default_factory=dict, repr=False, compare=False)
    _scenes: dict[str, list[Path]] = field(default_factory=dict, repr=False, compare=False)
    _names: Counter[str] = field(default_factory=Counter, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.folder.is_dir():
            raise ToolkitError(f"no such folder of {self.content}", path=self.folder)
        self._names.update(key.name for key in self.keys)

    def own_path(self, key: FrameKey) -> Path:
        """Return where the file of a frame is looked for first."""
        return self.folder / key.scene / f"{key.name}{self.suffixes[0]}"

    def joined(self, key: FrameKey) -> Iterator[str]:
        """Yield names of the frame in folders without scenes, without their suffix."""
        for joint in ("_", "-"):
            yield f"{key.scene}{joint}{key.name}"

    def path(self, key: FrameKey) -> Path:
        """Return the file of a frame, which need not exist.

        Raises:
            ToolkitError: two files could be it, or one could be that of several frames, or a
                folder has too many names.
        """
        own = self.own_path(key)
        if own.is_file():
            return own
        found = [p for place in self._folders(key.scene) for p in self._files(place, key.name)]
        if not found and self.keys:
            found += [p for name in self.joined(key) for p in self._files(self.folder, name)]
            flat = [] if found else list(self._files(self.folder, key.name))
            if flat and self._names[key.name] > 1:
                raise ToolkitError(
                    f"{self._names[key.name]} frames have this name",
                    path=flat[0],
                    value=str(key),
                    hint=f"put the files in a folder for each scene: SCENE/FRAME{flat[0].suffix}",
                )
            found += flat
        what = self.content.removeprefix("saved ")
        _at_most_one(found, f"two files could be the {what} of the frame", "leave one of them")
        return found[0] if found else own

    def files(self, key: FrameKey) -> dict[str, Path]:
        """Return the files that are read for a frame, by content; errors as of `path`."""
        return {self.content: self.path(key)}

    def _files(self, place: Path, name: str) -> Iterator[Path]:
        for below in self.below:
            folder = place / below if below else place
            names = self._names_in(folder)
            for ending in self.endings:
                for suffix in self.suffixes:
                    if f"{name}{ending}{suffix}" in names:
                        yield folder / f"{name}{ending}{suffix}"

    def _names_in(self, folder: Path) -> frozenset[str]:
        if folder not in self._listed:
            names: list[str] = []
            with suppress(FileNotFoundError, NotADirectoryError):
                names = names_in(folder)
            self._listed[folder] = frozenset(names)
        return self._listed[folder]

    def _folders(self, scene: str) -> list[Path]:
        """Folders of a scene: directly below, else those of its name farther below."""
        if (self.folder / scene).is_dir():
            return [self.folder / scene]
        if not self._scenes:
            for place in self._below(self.folder, _DEEPEST):
                self._scenes.setdefault(place.name, []).append(place)
        found = self._scenes.get(scene, [])
        hint = "name the folder of one method on one data set"
        _at_most_one(found, "two folders of this scene", hint)
        return found

    def _below(self, folder: Path, levels: int) -> Iterator[Path]:
        with _entries(folder) as entries:
            few = list(islice(entries, _MOST_NAMES + 1))
        _check_count(few, _MOST_NAMES, folder, "files")
        below = [folder / entry.name for entry in few if entry.is_dir()]
        _check_count(below, _MOST_FOLDERS, folder, "folders")
        for place in sorted(below):
            yield place
            if levels > 1:
                yield from self._below(place, levels - 1)
