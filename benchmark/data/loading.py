"""Common parts of loaders: compact lists of scenes and frames, reading and checking of maps."""

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

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND
from benchmark.data.splits import FrameKey, SceneFiles
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.depth_survey import DepthSurveySettings
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.exr import read_exr_channel
from std_toolkit.io.images import read_png

# Folders of meshes, whose textures may have the names of frames, and of records.
_NO_SCENES = frozenset({"cad_model", "parameters"})

# Renderers write 1e10 or the largest half float where a ray meets nothing.
NOTHING_BEYOND_M = 1000.0

NO_COLOR = np.zeros((0, 0, 3), np.uint8)

NO_DEPTH = np.zeros((0, 0), np.float32)


@dataclass(frozen=True)
class SceneFolder:
    """A folder of frames.

    Attributes:
        name: unique within the split.
        path: path of the folder.
        stems: prefixes of the file names of frames, in natural order.
    """

    name: str
    path: str
    stems: tuple[str, ...]


@dataclass(frozen=True)
class FrameIndex:
    """Frames of several scenes by index."""

    scenes: tuple[SceneFolder, ...]

    def __len__(self) -> int:
        return self._ends[-1] if self.scenes else 0

    def __iter__(self) -> Iterator[tuple[SceneFolder, str]]:
        return ((scene, stem) for scene in self.scenes for stem in scene.stems)

    def at(self, index: int) -> tuple[SceneFolder, str]:
        """Return scene and stem of a frame.

        Raises:
            IndexError: index out of range.
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
    """List scene folders at and below `top`: those with files with these suffixes.

    A frame is identified by any of its files, so that missing colour raises an error when the frame
    is read instead of dropping the frame silently. Folders in between, such as `part0` of an
    unpacked archive, are ignored; if two scenes have the same name, these folders are prepended.

    Args:
        suffixes: suffixes of the file names of frames, such as "_color.png".
        telling: suffixes of which a scene must have at least one; () for any.
        depth: maximum depth of folders below `top`.

    Raises:
        ToolkitError: a folder cannot be read.
    """
    pattern = re.compile(f"(.+?)({'|'.join(re.escape(s) for s in suffixes)})")
    found = sorted(
        _scan(top, pattern, frozenset(telling or suffixes), depth),
        key=lambda f: natural_key(str(f[0])),
    )
    return index_of(top, found)


def index_of(top: Path, found: Sequence[tuple[Path, tuple[str, ...]]]) -> FrameIndex:
    """Return the frames of folders; where two have one name, those above it are prepended.

    Args:
        top: folder at or above all of them.
        found: folders, and the prefixes of the file names of their frames.
    """
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
    """List the existing and missing files of a scene.

    Args:
        needed: accepted suffixes of each file of a frame, by content.
        placeholders: stems of files that exist but are empty, by content.

    Raises:
        ToolkitError: the folder cannot be read.
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
    found_here = False
    below: list[Path] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.startswith(".") or entry.name in _NO_SCENES:
                    continue
                match = pattern.fullmatch(entry.name)
                if match:
                    # The same few hundred names occur in every scene.
                    stems.add(intern(match.group(1)))
                    found_here = found_here or match.group(2) in telling
                elif depth > 0 and entry.is_dir():
                    below.append(folder / entry.name)
    except OSError as error:
        raise ToolkitError(f"cannot read the folder: {error.strerror}", path=folder) from error
    if found_here:
        yield folder, tuple(sorted(stems, key=natural_key))
    for path in below:
        yield from _scan(path, pattern, telling, depth - 1)


def read_depth_map(path: Path) -> NDArray[np.float32]:
    """Read depth (H, W) in metres from an EXR file; 0 where not measured.

    NaN, infinity, zero and negative numbers (DREDS writes -0.001) mean that depth was not measured.

    Raises:
        ToolkitError: missing, damaged, not a depth map, or not in metres.
    """
    stored = read_exr_channel(path, require_equal=True)
    depth = stored.astype(np.float32, copy=False)
    # Comparisons with NaN are false.
    depth[~((depth > 0) & (depth < NOTHING_BEYOND_M))] = 0
    sample = depth[::8, ::8]
    measured = sample[sample > 0]
    if measured.size and np.median(measured) > DepthSurveySettings.current().farthest_m:
        raise ToolkitError(
            "the median depth is implausible: the file seems not to be in metres",
            path=path,
            value=f"{np.median(measured):.4g}",
        )
    return depth


def read_id_mask(path: Path, *, truncated: bool = False) -> NDArray[np.uint8]:
    """Read instance ids (H, W) uint8 from a PNG, or from an EXR with id/255 in its channel R.

    EXR values are rounded. Public loaders truncate, which is wrong by one for every second id in
    half precision.

    Args:
        path: the file.
        truncated: truncate EXR values, as public loaders do.

    Raises:
        ToolkitError: missing, damaged or not a mask.
    """
    if path.suffix == ".exr":
        values = read_exr_channel(path, names=("R",)).astype(np.float32) * np.float32(255)
        low, high = float(values.min()), float(values.max())
        if not (low > -0.5 and high < 255.5):
            raise ToolkitError(
                "a mask in EXR holds id/255 between 0 and 1",
                path=path,
                value=(low / 255, high / 255),
            )
        return (np.floor(values.clip(min=0)) if truncated else np.rint(values)).astype(np.uint8)
    image = read_png(path)
    if image.ndim == 3:
        if not (image == image[..., :1]).all():
            raise ToolkitError("a mask holds ids in one channel or in equal ones", path=path)
        image = np.ascontiguousarray(image[..., 0])
    if image.dtype != np.uint8:
        raise ToolkitError("a mask is 8-bit", path=path, value=str(image.dtype))
    return image  # type: ignore[return-value]


def read_binary_mask(path: Path, inside: int) -> NDArray[np.uint8]:
    """Read a binary mask as instance `inside` and `BACKGROUND`.

    Raises:
        ToolkitError: missing, damaged or not a mask.
    """
    return np.where(read_id_mask(path) > 0, np.uint8(inside), np.uint8(BACKGROUND))


def read_coord_picture(path: Path, mask: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Read NOCS (H, W, 3) in [0, 1] from an 8-bit image with R = x, G = y, B = 1 - z.

    Pixels outside of objects are 0.

    Raises:
        ToolkitError: missing, damaged, not such an image, or not of the size of the mask.
    """
    picture = read_png(path, size=(mask.shape[1], mask.shape[0]))
    if picture.ndim != 3 or picture.dtype != np.uint8:
        raise ToolkitError(
            "a NOCS picture is 8-bit RGB", path=path, value=f"{picture.dtype} {picture.shape}"
        )
    nocs = picture.astype(np.float32) / np.float32(255)
    nocs[..., 2] = 1 - nocs[..., 2]
    nocs[mask == BACKGROUND] = 0
    return nocs


for _array in (NO_COLOR, NO_DEPTH):
    _array.flags.writeable = False


def first_file(folder: Path, names: tuple[str, ...], what: str) -> Path:
    """Return the first of these files that exists.

    Raises:
        ToolkitError: none exists.
    """
    for name in names:
        path = folder / name
        if path.is_file():
            return path
    others = f" (nor {', '.join(names[1:])})" if len(names) > 1 else ""
    raise ToolkitError(
        f"the frame has no {what}: no such file{others}",
        path=folder / names[0],
        hint="is the download complete? `std-bench check-data` lists all that is missing",
    )


def check_proportions(path: Path, image: NDArray[np.generic], size: tuple[int, int]) -> None:
    """Check that an image has the aspect ratio of the ground truth.

    Args:
        path: path of the image.
        image: (H, W) or (H, W, C).
        size: (width, height) of the ground truth.

    Raises:
        ToolkitError: the aspect ratios differ.
    """
    height, width = image.shape[:2]
    if width * size[1] != height * size[0]:
        raise ToolkitError(
            f"has other proportions than the ground truth's {size[0]}x{size[1]}",
            path=path,
            value=f"{width}x{height}",
            hint="colour, raw depth and ground truth must be aligned",
        )


def check_same_size(
    path: Path, image: NDArray[np.generic], reference: NDArray[np.generic], what: str
) -> None:
    """Check that a map has the size of the ground truth depth.

    Raises:
        ToolkitError: the sizes differ.
    """
    if image.shape[:2] != reference.shape[:2]:
        raise ToolkitError(
            f"the {what} has another size than the ground-truth depth's "
            f"{reference.shape[1]}x{reference.shape[0]}",
            path=path,
            value=f"{image.shape[1]}x{image.shape[0]}",
        )


def about(error: ToolkitError, key: FrameKey, path: Path) -> ToolkitError:
    """Return an error about a frame with the path of the file that causes it."""
    if error.path is None or error.path == str(key):
        return error.revised(path=path)
    return error
