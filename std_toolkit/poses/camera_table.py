"""Camera poses in text files: CSV with a header, TUM, rows of matrices, and `*_par.txt`.

Columns of a CSV file (upper or lower case):

which image   `name`, `image`, `file`, `filename`, `file_path`, `timestamp`, `time`, `frame` or
              `id`; of several, the one that names most images of the scene
position      `x y z`, `tx ty tz` or `px py pz`
rotation      `qw qx qy qz`, or the rotation vector `rx ry rz` in radians
or a matrix   `m00` to `m33` (or to `m23`), row-major
intrinsics    `fx fy cx cy`, of each image
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, compress
from pathlib import Path
from typing import Self

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.intrinsics import Intrinsics
from std_toolkit.geometry.se3 import ROTATION_TOLERANCE
from std_toolkit.io.foreign_files import csv_rows
from std_toolkit.log import logger
from std_toolkit.poses.filed_matrices import (
    poses_or_lost,
    quaternion_poses,
    rigid,
    rotation_deviations,
    rotation_vector_poses,
)
from std_toolkit.poses.pose_columns import (
    FiledOrder,
    column_units,
    columns_of_comment,
    euroc_rows,
    filed_order,
    plain_columns,
    without_frame_numbers,
)

_KEYS = ("name", "image", "file", "filename", "file_path", "timestamp", "time", "frame", "id")
_POSITIONS = (("x", "y", "z"), ("tx", "ty", "tz"), ("px", "py", "pz"))
_QUATERNION = ("qw", "qx", "qy", "qz")
_VECTOR = ("rx", "ry", "rz")
_LENS = ("fx", "fy", "cx", "cy")
_MATRIX = tuple(f"m{r}{c}" for r in range(4) for c in range(4))


@dataclass(frozen=True, kw_only=True, eq=False)
class FiledCameras:
    """Camera poses as filed: no convention is applied.

    Attributes:
        path: the file or folder.
        kind: name of the format.
        matrices: (N, 4, 4) rigid transforms; within the readers of one format as filed, with the
            last row 0 0 0 w.
        keys: what names the image of each pose: file name, time stamp or number. None: the
            poses are in the order of the images.
        more_keys: other columns that name the images, such as numbers beside time stamps.
        keys_are_times: whether a header calls the keys time stamps.
        lenses: intrinsics of each pose where the file has them; may be empty.
        lens_problem: why intrinsics that the file has cannot be used.
        convention: convention that the format fixes; None: the file does not state it.
        unit: unit that the format fixes.
        unit_is_open: such files are often in an arbitrary unit, so the user must name it.
        repairs: sentences on what `rigid` changed.
        lost: rows that are no pose (not finite, zero or blank), which a tracker files for images
            that it lost; their matrices are the identity.
        quaternion: the order of quaternions whose components the file does not name.
    """

    path: Path
    kind: str
    matrices: Array
    keys: list[str] | None = None
    more_keys: Sequence[list[str]] = ()
    keys_are_times: bool = False
    lenses: Sequence[Intrinsics | None] = ()
    lens_problem: ToolkitError | None = None
    convention: str | None = None
    unit: str | None = None
    unit_is_open: bool = False
    repairs: Sequence[str] = ()
    lost: frozenset[int] = frozenset()
    quaternion: FiledOrder | None = None

    def rigid(self) -> Self:
        """Return the poses with exact rotations and the last row 0 0 0 1."""
        if len(self.lost) == len(self.matrices):
            raise ToolkitError(
                "the file has no camera poses: all are not finite or zero", path=self.path
            )
        off = rotation_deviations(self.matrices)
        rough = int((off > ROTATION_TOLERANCE).sum())
        w = self.matrices[:, 3, 3]
        repairs = []
        if rough:
            repairs.append(
                f"the rotations of {rough} of {len(off)} poses are up to {off.max():.2g} off "
                "orthonormal; the nearest rotations are used"
            )
        if (scaled := int((w != 1).sum())) and not np.allclose(w, 1, atol=1e-6):
            repairs.append(
                f"the last row of {scaled} of {len(off)} poses is 0 0 0 w, w = "
                f"{w[w != 1][0]:.6g}; they are divided by w"
            )
        return replace(self, matrices=rigid(self.matrices, self.path), repairs=repairs)

    def lens(self) -> Intrinsics | None:
        """Return the intrinsics that all poses share; None if the file has none.

        Raises:
            ToolkitError: the intrinsics of the images differ, or cannot be used.
        """
        if self.lens_problem is not None:
            raise self.lens_problem
        lenses = [x for x in self.lenses if x is not None]
        if not lenses:
            return None
        if (other := next((i for i, x in enumerate(lenses) if x != lenses[0]), None)) is not None:
            raise ToolkitError(
                "the images have different intrinsics", path=self.path,
                value=self.keys[other] if self.keys else other,
                hint="give those of one camera with --intrinsics",
            )  # fmt: skip
        return lenses[0]


def read_table(path: Path) -> FiledCameras:
    """Read a text file of camera poses; the number of columns tells the format.

    Raises:
        ToolkitError: not text, of unknown layout, or a row that is no pose.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ToolkitError("the file of camera poses is not text", path=path) from error
    lines = [
        (i, line.strip())
        for i, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith(("#", "%", "//"))
    ]
    if not lines:
        raise ToolkitError("the file has no camera poses", path=path)
    rows = [(i, line.strip("[] ").replace(",", " ").replace(";", " ").split()) for i, line in lines]
    first = rows[0][1]
    if len(first) > 2 and not any(_is_number(w) for w in first):
        return _read_csv(path, [line for _, line in lines], rows[0][0])
    if len(first) == 1 and len(rows) > 1 and len(rows[1][1]) == 22:
        rows = rows[1:]
    rows = without_frame_numbers(rows)
    widths = {len(words) for _, words in rows}
    commas = "," in lines[-1][1]
    named = columns_of_comment(text, len(first)) if len(widths) == 1 else None
    if named is not None and named[-7:] != ["x", "y", "z", "qx", "qy", "qz", "qw"]:
        cells = [named, *(words for _, words in rows)]
        return _read_csv(path, [",".join(c) for c in cells], rows[0][0] - 1)
    if len(widths) == 1 and commas:
        rows = euroc_rows(rows)
        widths = {len(rows[0][1])}
    if widths == {4} and len(rows) == 3:
        rows = [(1, [w for _, words in rows for w in words])]
        widths = {12}
    if widths == {4} and len(rows) % 4 == 0:
        rows = [
            (rows[i][0], [w for _, words in rows[i : i + 4] for w in words])
            for i in range(0, len(rows), 4)
        ]
        widths = {16}
    readers: dict[int, Callable[..., FiledCameras]] = {
        8: partial(_read_tum, commas=commas, is_named=named is not None), 12: _read_rows,
        16: _read_rows, 13: _read_rows, 17: _read_rows, 22: _read_par,
    }  # fmt: skip
    if len(widths) > 1 or not widths & readers.keys():
        shown = ", ".join(map(str, sorted(widths)[:4]))
        raise ToolkitError(
            f"unknown layout of camera poses: {shown} columns", path=path,
            hint="8 (TUM: time tx ty tz qx qy qz qw; EuRoC: qw first, nanoseconds, commas), "
            "12 or 16 (matrix), 13 or 17 (name, matrix), 22 (name K R t), or CSV with a header",
        )  # fmt: skip
    return readers[widths.pop()](path, rows)


Rows = list[tuple[int, list[str]]]


def _words(line: str) -> list[str]:
    return line.strip("[] ").replace(",", " ").replace(";", " ").split()


def _read_rows(path: Path, rows: Rows) -> FiledCameras:
    named = len(rows[0][1]) in (13, 17)
    matrices, lost = poses_or_lost(_table(path, rows, int(named)), path, _lines(rows))
    return FiledCameras(
        path=path,
        kind="matrices",
        matrices=matrices,
        keys=[words[0] for _, words in rows] if named else None,
        lost=lost,
    )


def _read_tum(path: Path, rows: Rows, *, commas: bool, is_named: bool) -> FiledCameras:
    values, keys = _table(path, rows, 1), [words[0] for _, words in rows]
    lost = ~np.isfinite(values).all(1) | ~values[:, 3:].any(1)
    filed = (
        FiledOrder("xyzw", "as a comment names them")
        if is_named
        else filed_order(keys, values, commas=commas)
    )
    wxyz = values[:, [3, 4, 5, 6] if filed.order == "wxyz" else [6, 3, 4, 5]]
    wxyz[lost], values[lost] = (1, 0, 0, 0), 0
    return FiledCameras(
        path=path,
        kind="euroc" if filed.order == "wxyz" else "tum",
        matrices=quaternion_poses(wxyz, values[:, :3], path, _lines(rows)),
        keys=keys,
        lost=frozenset(map(int, np.flatnonzero(lost))),
        quaternion=filed,
    )


def _read_par(path: Path, rows: Rows) -> FiledCameras:
    values, at = _table(path, rows, 1), _lines(rows)
    K = values[:, :9].reshape(-1, 3, 3)
    odd = (np.abs(K[:, 0, 1]) > 1e-6 * np.abs(K[:, 0, 0])) | K[:, 1:, 0].any(1)
    odd |= K[:, 2, 2] != 1
    if odd.any():
        first = at(int(np.argmax(odd)))
        raise ToolkitError("K has skew or is no camera matrix", path=path, field=first)
    M = np.concatenate([values[:, 9:18].reshape(-1, 3, 3), values[:, 18:, None]], axis=2)
    matrices, lost = poses_or_lost(M, path, at)
    return FiledCameras(
        path=path,
        kind="par",
        matrices=matrices,
        keys=[words[0] for _, words in rows],
        lenses=[Intrinsics(*k) for k in K[:, [0, 1, 0, 1], [0, 1, 2, 2]].tolist()],
        convention="world-to-camera",
        lost=lost,
    )


def _read_csv(path: Path, lines: Sequence[str], first: int) -> FiledCameras:
    delimiter = next((d for d in (",", ";", "\t") if d in lines[0]), " ")
    table = list(csv_rows(lines, path, first=first, delimiter=delimiter))
    columns = plain_columns(table[0])
    named_by = [k for k in _KEYS if k in columns]
    position = next((p for p in _POSITIONS if set(p) <= set(columns)), None)
    matrix = set(_MATRIX[:12]) <= set(columns)
    rotation = next((r for r in (_QUATERNION, _VECTOR) if set(r) <= set(columns)), None)
    if not matrix and (position is None or rotation is None):
        raise ToolkitError(
            "the columns do not hold a pose", path=path, value=columns,
            hint="position x y z; rotation qw qx qy qz or rx ry rz (radians); or m00 to m33",
        )  # fmt: skip
    used = _MATRIX[:12] if matrix else (*(position or ()), *(rotation or ()))
    lens = _LENS if set(_LENS) <= set(columns) else ()
    rest = [c for c in columns if c and c not in (*used, *lens, *named_by, *_MATRIX[12:])]
    if rest:
        logger.info(
            "%s: columns that are not read: %s", path, ", ".join(rest), extra={"doctor": "ignored"}
        )
    units = dict(zip(columns, column_units(table[0]), strict=True))
    unit = _stated(path, units, position or (), ("m", "cm", "mm"))
    angle = _stated(path, units, rotation if rotation == _VECTOR else (), ("rad", "deg"))
    place = {c: i for i, c in enumerate(columns)}
    rows: Rows = []
    names: list[list[str]] = []
    lenses: list[list[str] | None] = []
    for i, line in enumerate(table[1:], start=first + 1):
        cells = [line[place[c]] if place[c] < len(line) else "" for c in used]
        if _is_blank(cells[0]) and all(map(_is_blank, cells)):
            continue  # a frame without a pose
        names.append([line[place[k]].strip() if place[k] < len(line) else "" for k in named_by])
        filed_lens = [line[place[c]] if place[c] < len(line) else "" for c in lens]
        lenses.append(None if any(map(_is_blank, filed_lens)) else filed_lens)
        rows.append((i, cells))
    values = _table(path, rows, 0) if rows else np.empty((0, len(used)))
    turn = values.reshape(-1, 3, 4)[:, :, :3].reshape(-1, 9) if matrix else values[:, 3:]
    kept = np.asarray(np.isfinite(values).all(axis=1))
    if matrix or rotation != _VECTOR:
        kept = np.asarray(kept & turn.any(axis=1))
    if not kept.any():
        raise ToolkitError("the file has no camera poses", path=path)
    rows = list(compress(rows, kept))
    names, lenses = list(compress(names, kept)), list(compress(lenses, kept))
    values = values[kept]
    at = _lines(rows)
    if matrix:
        matrices, _ = poses_or_lost(values, path, at)
    elif rotation == _QUATERNION:
        matrices = quaternion_poses(values[:, 3:], values[:, :3], path, at)
    else:
        turns = np.radians(values[:, 3:]) if angle == "deg" else values[:, 3:]
        matrices = rotation_vector_poses(turns, values[:, :3], path, at)
    keys = {k: [row[i] for row in names] for i, k in enumerate(named_by)}
    keys = {k: texts for k, texts in keys.items() if all(texts)}
    first_key = next(iter(keys), None)
    return FiledCameras(
        path=path,
        kind="csv",
        matrices=matrices,
        keys=keys[first_key] if first_key else None,
        more_keys=[texts for k, texts in keys.items() if k != first_key],
        unit=unit,
        keys_are_times=first_key in ("timestamp", "time"),
        lenses=_lenses(path, rows, lenses) if lens else (),
    )


def _stated(
    path: Path, units: dict[str, str], columns: Sequence[str], known: Sequence[str]
) -> str | None:
    """The unit that a header states for columns.

    Raises:
        ToolkitError: several units, or another than the known ones.
    """
    spelled = {"metres": "m", "meters": "m", "millimeters": "mm", "degrees": "deg", "°": "deg"}
    found = {spelled.get(units[c], units[c]) for c in columns if c in units} - {""}
    if not found:
        return None
    if len(found) > 1 or not found <= set(known):
        raise ToolkitError(
            f"columns in {', '.join(sorted(found))}", path=path, field=", ".join(columns),
            hint=f"known units: {', '.join(known)}",
        )  # fmt: skip
    return found.pop()


def _lenses(path: Path, rows: Rows, filed: Sequence[list[str] | None]) -> list[Intrinsics | None]:
    found: list[Intrinsics | None] = []
    for (line, _), cells in zip(rows, filed, strict=True):
        numbers = None if cells is None else _table(path, [(line, cells)], 0)[0]
        if numbers is not None and not (np.isfinite(numbers).all() and (numbers[:2] > 0).all()):
            raise ToolkitError(
                "are no intrinsics", path=path, field=f"line {line}: fx fy cx cy", value=cells
            )
        found.append(None if numbers is None else Intrinsics(*numbers.tolist()))
    return found


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _is_blank(cell: str) -> bool:
    return cell.strip().lower() in ("", "null", "none", "nan", "lost")


def _lines(rows: Rows) -> Callable[[int], str]:
    """Names of the lines of rows, for errors."""
    return lambda i: f"line {rows[i][0]}"


def _table(path: Path, rows: Rows, skip: int) -> Array:
    """The numbers of rows (N, M) after the first `skip` words.

    Raises:
        ToolkitError: a word that is no number; the line is named.
    """
    try:
        words = chain.from_iterable(words[skip:] for _, words in rows)
        return np.fromiter(map(float, words), np.float64).reshape(len(rows), -1)
    except ValueError as error:
        line, wrong = next((i, w) for i, words in rows for w in words[skip:] if not _is_number(w))
        raise ToolkitError("not a number", path=path, field=f"line {line}", value=wrong) from error
