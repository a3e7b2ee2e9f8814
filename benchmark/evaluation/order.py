"""`std-bench order`: the order of points of LayeredDepth in folders of predictions.

A folder has KEY_LAYER.png (16 bit) or .npy of each photo, or KEY.png and KEY.npy of the first layer
alone. The authors' pages number layers 1, 3, 5, 7, their program 0, 1, 2, 3; and their program
reads .npy as inverse depth. A layer does not exist where a PNG is 0, or an array not a number, or
where it has no file.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.layered_depth import (
    LAYERS,
    PAGE,
    SIZES,
    OrderedPhoto,
    read_photos,
)
from benchmark.evaluation.query_options import OrderOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Cell, Column, Row, Table
from std_toolkit.io.foreign_files import read_npy
from std_toolkit.io.images import read_depth

ALL = "all"
_NUMBERS: dict[str, dict[int, int]] = {
    "odd": {layer: layer for layer in LAYERS},
    "counted": dict(enumerate(LAYERS)),
}
_FILE = re.compile(r"(.+?)(?:_(\d))?\.(png|npy)")


class OrderScore(msgspec.Struct, frozen=True, kw_only=True):
    """Share of right tuples.

    Attributes:
        method: name of the predictions.
        tuples: pairs, trips or quads.
        layer: of all points, "mixed", or "all" for all tuples.
        count, right: numbers of tuples.
    """

    method: str
    tuples: str
    layer: str
    count: int
    right: int


class OrderRecord(msgspec.Struct, frozen=True, kw_only=True):
    """What was scored.

    Attributes:
        subset: which tuples.
        photos: number of photos; their tuples count whether answered or not.
        left_out: tuples with points outside their photo.
        unanswered: photos without a prediction, by method: all their tuples are wrong.
        scores: of each method, size and layer.
    """

    subset: str
    photos: int
    left_out: int
    unanswered: dict[str, int]
    scores: list[OrderScore]


@dataclass(frozen=True)
class _Predictions:
    """Files of a folder.

    Attributes:
        files: by key of the photo and layer.
        inverse: whether arrays hold inverse depth.
    """

    files: Mapping[tuple[str, int], Path]
    inverse: bool

    def layers(self, photo: OrderedPhoto) -> dict[int, NDArray[np.float64]]:
        """Depth of each layer that has a file; NaN where it does not exist."""
        found = {}
        for layer in LAYERS:
            path = self.files.get((photo.key, layer))
            if path is not None:
                found[layer] = self._read(path, photo.size)
        return found

    def _read(self, path: Path, size: tuple[int, int]) -> NDArray[np.float64]:
        if path.suffix == ".png":
            depth = read_depth(path, scale=0.001).astype(np.float64)
            depth[depth == 0] = np.nan
        else:
            depth = read_npy(path).astype(np.float64)
            if depth.ndim != 2:
                raise ToolkitError("expected (H, W)", path=path, value=depth.shape)
            if (depth < 0).any():
                raise ToolkitError("depth is not negative", path=path, value=float(depth.min()))
            if self.inverse:
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


def score_order(options: OrderOptions) -> OrderRecord:
    """Score folders of predictions, or count what is there.

    Raises:
        ToolkitError: no data, a folder whose names say two things, or a file that is damaged or of
            other proportions.
    """
    for path in (options.data, *options.folders.values()):
        if not path.is_dir():
            raise ToolkitError("no such folder", path=path)
    photos = read_photos(options.data, options.subset)
    scores, unanswered = [], {}
    for name, folder in options.folders.items():
        predictions = _Predictions(_listed(folder, options.layers), options.npy == "inverse")
        right: Counter[tuple[str, str]] = Counter()
        unanswered[name] = 0
        for photo in photos:
            layers = predictions.layers(photo)
            unanswered[name] += not layers
            right.update(_right(photo, layers))
        for key, count in _counts(photos).items():
            scores.append(
                OrderScore(method=name, tuples=key[0], layer=key[1], count=count, right=right[key])
            )
    if not options.folders:
        scores = [
            OrderScore(method="", tuples=size, layer=layer, count=count, right=0)
            for (size, layer), count in _counts(photos).items()
        ]
    return OrderRecord(
        subset=options.subset, photos=len(photos), left_out=sum(p.left_out for p in photos),
        unanswered=unanswered, scores=scores,
    )  # fmt: skip


def _counts(photos: Iterable[OrderedPhoto]) -> dict[tuple[str, str], int]:
    """Tuples by size and layer, in order."""
    found: Counter[tuple[str, str]] = Counter()
    for photo in photos:
        for size, tuples in photo.tuples.items():
            found.update((size, layer) for t in tuples for layer in (t.layer, ALL))
    layers = (*map(str, LAYERS), "mixed", ALL)
    return {(s, k): found[s, k] for s in SIZES for k in layers if found[s, k]}


def _right(
    photo: OrderedPhoto, layers: Mapping[int, NDArray[np.float64]]
) -> Counter[tuple[str, str]]:
    found: Counter[tuple[str, str]] = Counter()
    if not layers:  # an answer that is missing does not say that a layer does not exist
        return found
    for size, tuples in photo.tuples.items():
        for one in tuples:
            depths = [_depth_at(layers.get(k), x, y, photo.size) for x, y, k in one.points]
            if has_order(depths, is_real=one.is_real):
                found.update([(size, one.layer), (size, ALL)])
    return found


def _depth_at(
    depth: NDArray[np.float64] | None, x: int, y: int, size: tuple[int, int]
) -> float | None:
    if depth is None:
        return None
    found = float(depth[y * depth.shape[0] // size[1], x * depth.shape[1] // size[0]])
    return None if np.isnan(found) else found


def _listed(folder: Path, layers: str) -> dict[tuple[str, int], Path]:
    """Files by photo and layer."""
    named = [(path, m) for path in sorted(folder.iterdir()) if (m := _FILE.fullmatch(path.name))]
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
    return found


def order_table(record: OrderRecord) -> Table:
    """Return the table of a record: a row for each method, a column for each size and layer."""
    cells = dict.fromkeys((s.tuples, s.layer) for s in record.scores)
    titles = [f"{size} {layer}" for size, layer in cells]
    by_name: dict[str, list[Cell]] = {}
    for score in record.scores:
        text = f"{100 * score.right / score.count:.2f}" if score.method else str(score.count)
        by_name.setdefault(score.method, []).append(Cell(text=text))
    rows = [Row([Cell(text=name or "tuples"), *found]) for name, found in by_name.items()]
    first = "first surfaces" if record.subset == "layer_first" else "all layers"
    notes = [
        f"{record.photos} photos; share of tuples whose order is right, %",
        "order of points alone: never beside errors of metric depth",
    ]
    if record.left_out:
        notes.append(f"{record.left_out} tuples with points outside their photo are left out")
    notes += [f"{n}: {k} photos not answered, all wrong" for n, k in record.unanswered.items() if k]
    if not record.unanswered:
        notes.append(f"page: {PAGE}; benchmark CC0, synthetic part BSD-3-Clause")
    columns = [Column(heading="method", numeric=False), *(Column(heading=t) for t in titles)]
    return Table(columns=columns, rows=rows, title=f"LayeredDepth, {first}", notes=notes)
