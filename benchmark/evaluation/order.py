"""The order of points of LayeredDepth in a folder of predictions.

A folder has KEY_LAYER.png (16 bit) or .npy of each photo, or KEY.png and KEY.npy of the first layer
alone. The authors' pages number layers 1, 3, 5, 7, their program 0, 1, 2, 3; and their program
reads .npy as inverse depth. A layer does not exist where a PNG is 0, or an array not a number, or
where it has no file.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.layered_depth import LAYERS, OrderedPhoto
from benchmark.data.prediction_files import names_in
from std_toolkit.errors import ToolkitError
from std_toolkit.io.foreign_files import read_npy
from std_toolkit.io.images import read_depth

# In the place of a layer: all tuples of a size.
ALL = "all"
Counting = Literal["odd", "counted"]
_NUMBERS: dict[Counting, dict[int, int]] = {
    "odd": {layer: layer for layer in LAYERS},
    "counted": dict(enumerate(LAYERS)),
}
_FILE = re.compile(r"(.+?)(?:_(\d))?\.(png|npy)")


@dataclass(frozen=True)
class OrderPredictions:
    """Files of a folder.

    Attributes:
        files: by key of the photo and layer.
        counted_as: how the files count layers: `odd` or `counted`.
        inverse: whether arrays hold inverse depth.
    """

    files: Mapping[tuple[str, int], Path]
    counted_as: Counting
    inverse: bool

    def files_of(self, key: str) -> dict[int, Path]:
        """Files of a photo by layer."""
        return {k: path for k in LAYERS if (path := self.files.get((key, k))) is not None}

    def layers(self, photo: OrderedPhoto) -> dict[int, NDArray[np.float64]]:
        """Depth of each layer that has a file, (H, W), NaN where it does not exist.

        Raises:
            ToolkitError: no file, or one that is damaged or has other proportions.
        """
        files = self.files_of(photo.key)
        if not files:
            raise ToolkitError("no prediction of this photo", value=photo.key)
        return {k: _read(path, photo.size, inverse=self.inverse) for k, path in files.items()}


def _read(path: Path, size: tuple[int, int], *, inverse: bool) -> NDArray[np.float64]:
    if path.suffix == ".png":
        depth = read_depth(path, scale=0.001).astype(np.float64)
        depth[depth == 0] = np.nan
    else:
        depth = read_npy(path).astype(np.float64)
        if depth.ndim != 2:
            raise ToolkitError("expected (H, W)", path=path, value=depth.shape)
        if (depth < 0).any():
            raise ToolkitError("depth is not negative", path=path, value=float(depth.min()))
        if inverse:
            with np.errstate(divide="ignore"):
                depth = 1 / depth  # 0 is farthest
        else:
            depth[depth == 0] = np.nan
    if depth.shape[1] * size[1] != depth.shape[0] * size[0]:
        raise ToolkitError(
            f"has other proportions than the photo's {size[0]}x{size[1]}", path=path,
            value=f"{depth.shape[1]}x{depth.shape[0]}",
        )  # fmt: skip
    return depth


def has_order(depths: Sequence[float | None], *, is_real: bool = True) -> bool:
    """Whether a tuple of points is right.

    Args:
        depths: predicted, of points from near to far; None where a layer does not exist.
        is_real: whether these layers exist.

    Returns:
        For real points, whether all are predicted and each is farther than the one before it.
        Otherwise, whether none is predicted.

    >>> has_order([1.0, 2.5]), has_order([1.0, 1.0]), has_order([1.0, None])
    (True, False, False)
    >>> has_order([None], is_real=False)
    True
    """
    if not is_real:
        return all(depth is None for depth in depths)
    known = [depth for depth in depths if depth is not None]
    return len(known) == len(depths) and all(a < b for a, b in pairwise(known))


def count_order(
    photo: OrderedPhoto, layers: Mapping[int, NDArray[np.float64]] | None
) -> dict[tuple[str, str], tuple[int, int]]:
    """Return the numbers of tuples and of right ones by size and layer, `ALL` included.

    Args:
        photo: what is known.
        layers: depth of each predicted layer; None without an answer, which is wrong everywhere: it
            does not say that a layer does not exist.
    """
    asked: Counter[tuple[str, str]] = Counter()
    right: Counter[tuple[str, str]] = Counter()
    for size, tuples in photo.tuples.items():
        for one in tuples:
            keys = [(size, one.layer), (size, ALL)]
            asked.update(keys)
            if layers is None:
                continue
            depths = [_depth_at(layers.get(k), x, y, photo.size) for x, y, k in one.points]
            if has_order(depths, is_real=one.is_real):
                right.update(keys)
    return {key: (count, right[key]) for key, count in asked.items()}


def _depth_at(
    depth: NDArray[np.float64] | None, x: int, y: int, size: tuple[int, int]
) -> float | None:
    if depth is None:
        return None
    found = float(depth[y * depth.shape[0] // size[1], x * depth.shape[1] // size[0]])
    return None if np.isnan(found) else found


def list_predictions(
    folder: Path, layers: Literal["auto", "odd", "counted"], *, inverse: bool
) -> OrderPredictions:
    """List the files of a folder by photo and layer.

    Args:
        folder: of predictions.
        layers: `odd` or `counted`, how files count layers, or `auto`, as they tell.
        inverse: whether arrays hold inverse depth.

    Raises:
        ToolkitError: no file, names that could mean two layers, or two files of one layer.
    """
    if not folder.is_dir():
        raise ToolkitError("no such folder", path=folder)
    names = sorted(names_in(folder))
    named = [(folder / name, m) for name in names if (m := _FILE.fullmatch(name))]
    if not named:
        raise ToolkitError("no .png or .npy of predictions", path=folder)
    numbers = {int(m[2]) for _, m in named if m[2]}
    fitting = [k for k, table in _NUMBERS.items() if numbers <= set(table)]
    if layers == "auto" and numbers <= {1}:
        fitting = ["odd"]  # both the first layer of the pages, and no more
    if layers != "auto":
        fitting = [layers] if layers in fitting else []
    if len(fitting) != 1:
        told = "may count layers 1, 3, 5, 7 or 0, 1, 2, 3" if fitting else "fit no way of counting"
        raise ToolkitError(
            f"the numbers of the files {told}", path=folder, value=sorted(numbers),
            hint="give --layers odd or --layers counted; files are KEY_LAYER.png or .npy",
        )  # fmt: skip
    table = _NUMBERS[fitting[0]]
    found: dict[tuple[str, int], Path] = {}
    for path, match in named:
        key = match[1], table[int(match[2])] if match[2] else LAYERS[0]
        if key in found:
            raise ToolkitError("two files of one photo and layer", path=path, value=found[key].name)
        found[key] = path
    return OrderPredictions(found, fitting[0], inverse)
