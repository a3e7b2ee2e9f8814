"""Which scenes and frames a folder holds, listed once and kept small."""

from __future__ import annotations

import os
import re
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from sys import intern

from benchmark.data.source import SceneFiles
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.pairing import natural_key

# Folders of meshes, whose textures may be called as frames are, and of records.
_NO_SCENES = frozenset({"cad_model", "parameters"})


@dataclass(frozen=True)
class SceneFolder:
    """A folder of frames.

    Attributes:
        name: unique within the split.
        path: of the folder.
        stems: beginnings of the frames' file names, in natural order.
    """

    name: str
    path: str
    stems: tuple[str, ...]


@dataclass(frozen=True)
class FrameIndex:
    """Frames of several scenes by number."""

    scenes: tuple[SceneFolder, ...]

    def __len__(self) -> int:
        return self._ends[-1] if self.scenes else 0

    def __iter__(self) -> Iterator[tuple[SceneFolder, str]]:
        return ((scene, stem) for scene in self.scenes for stem in scene.stems)

    def at(self, index: int) -> tuple[SceneFolder, str]:
        """Scene and stem of a frame.

        Raises:
            IndexError: no such frame.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        place = bisect_right(self._ends, index)
        scene = self.scenes[place]
        return scene, scene.stems[index - self._ends[place] + len(scene.stems)]

    @cached_property
    def _ends(self) -> list[int]:
        return list(accumulate(len(s.stems) for s in self.scenes))


def list_scenes(
    top: Path, suffixes: Sequence[str], *, telling: Sequence[str] = (), depth: int = 3
) -> FrameIndex:
    """Scene folders at and below `top`: those that hold files with these suffixes.

    A frame is what any of its files begins with, so that one whose colour is missing is found
    and told of when it is read, instead of being left out without a word. Folders in between, such
    as `part0` of an unpacked archive, do not matter; where two scenes have one name, theirs are
    put in front.

    Args:
        suffixes: ends of the frames' file names, as "_color.png".
        telling: of these a scene must have one at least; () for any.
        depth: folders are entered so deep below `top`.

    Raises:
        ToolkitError: a folder cannot be read.
    """
    pattern = re.compile(f"(.+?)({'|'.join(re.escape(s) for s in suffixes)})")
    found = sorted(
        _scan(top, pattern, frozenset(telling or suffixes), depth),
        key=lambda f: natural_key(str(f[0])),
    )
    names = Counter(path.name for path, _ in found)
    return FrameIndex(
        tuple(
            SceneFolder(
                path.name
                if names[path.name] == 1
                else "_".join(path.relative_to(top).parts) or path.name,
                str(path),
                stems,
            )
            for path, stems in found
        )
    )


def scene_files(
    scene: SceneFolder,
    needed: Mapping[str, Sequence[str]],
    *,
    placeholders: Mapping[str, Set[str]] | None = None,
) -> SceneFiles:
    """What a scene has and lacks.

    Args:
        needed: what a frame's files hold, to the suffixes that such a file may have.
        placeholders: stems whose file is there but holds nothing, by what it should hold.

    Raises:
        ToolkitError: the folder cannot be read any more.
    """
    there = set(_entries(scene.path))
    missing = {}
    for what, suffixes in needed.items():
        empty = (placeholders or {}).get(what, frozenset())
        lacking = [
            stem + suffixes[0]
            for stem in scene.stems
            if stem in empty or not any(stem + s in there for s in suffixes)
        ]
        if lacking:
            missing[what] = lacking
    return SceneFiles(scene.name, scene.path, len(scene.stems), missing)


def _entries(folder: str) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208 - names only, of folders of thousands of files
    except OSError as error:
        raise ToolkitError(f"cannot read the folder: {error.strerror}", path=folder) from error


def _scan(
    folder: Path, pattern: re.Pattern[str], telling: Set[str], depth: int
) -> Iterator[tuple[Path, tuple[str, ...]]]:
    stems: set[str] = set()
    told = False
    below: list[Path] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.startswith(".") or entry.name in _NO_SCENES:
                    continue
                match = pattern.fullmatch(entry.name)
                if match:
                    # The same few hundred names come back in every scene.
                    stems.add(intern(match.group(1)))
                    told = told or match.group(2) in telling
                elif depth > 0 and entry.is_dir():
                    below.append(folder / entry.name)
    except OSError as error:
        raise ToolkitError(f"cannot read the folder: {error.strerror}", path=folder) from error
    if told:
        yield folder, tuple(sorted(stems, key=natural_key))
    for path in below:
        yield from _scan(path, pattern, telling, depth - 1)
