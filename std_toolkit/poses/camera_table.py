"""Camera poses in text files: CSV with a header, TUM, rows of matrices, and `*_par.txt`.

Columns of a CSV file (upper or lower case):

which image   `name`, `image`, `file`, `filename`, `file_path`, `frame`, `timestamp` or `time`
position      `x y z`, `tx ty tz` or `px py pz`
rotation      `qw qx qy qz`, or the rotation vector `rx ry rz` in radians
or a matrix   `m00` to `m33` (or to `m23`), row-major
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry import SE3
from std_toolkit.geometry.intrinsics import Intrinsics
from std_toolkit.geometry.se3 import ROTATION_TOLERANCE, nearest_rotation, so3_exp
from std_toolkit.io.foreign_files import csv_rows
from std_toolkit.poses.pose_columns import columns_of_comment, plain_columns, without_frame_numbers
from std_toolkit.settings import Settings, limit

_KEYS = ("name", "image", "file", "filename", "file_path", "timestamp", "time", "frame", "id")
_POSITIONS = (("x", "y", "z"), ("tx", "ty", "tz"), ("px", "py", "pz"))
_QUATERNION = ("qw", "qx", "qy", "qz")
_VECTOR = ("rx", "ry", "rz")
_MATRIX = tuple(f"m{r}{c}" for r in range(4) for c in range(4))


@dataclass(frozen=True, kw_only=True)
class CameraTableSettings(Settings):
    """Which numbers of a file are a camera pose."""

    largest_deviation: float = limit(
        1e-2,
        source="poses of KinectFusion in float32 are 1.9e-4 off; files of three decimals are up to "
        "2e-3 off, a scale of 1 % is 2e-2 off",
    )
    """largest entry of `R R^T - I` of a rotation R that is taken for one with rounding errors"""
    largest_turn: float = limit(
        6.3, unit="rad", source="a turn is 2 pi; angles in degrees are larger in most rows"
    )
    """longest rotation vector"""


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
        lenses: intrinsics of each pose where the file has them; may be empty.
        lens_problem: why intrinsics that the file has cannot be used.
        convention: convention that the format fixes; None: the file does not state it.
        unit: unit that the format fixes.
        unit_is_open: such files are often in an arbitrary unit, so the user must name it.
        repairs: sentences on what `rigid` changed.
        lost: rows that are no pose (not finite, zero or blank), which a tracker files for images
            that it lost; their matrices are the identity.
    """

    path: Path
    kind: str
    matrices: Array
    keys: list[str] | None = None
    lenses: Sequence[Intrinsics | None] = ()
    lens_problem: ToolkitError | None = None
    convention: str | None = None
    unit: str | None = None
    unit_is_open: bool = False
    repairs: Sequence[str] = ()
    lost: frozenset[int] = frozenset()

    def rigid(self) -> Self:
        """Return the poses with exact rotations and the last row 0 0 0 1."""
        if len(self.lost) == len(self.matrices):
            raise ToolkitError(
                "the file has no camera poses: all are not finite or zero", path=self.path
            )
        off = np.array([rotation_deviation(M) for M in self.matrices])
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
        exact = np.array([_rigid(M) for M in self.matrices])
        return replace(self, matrices=exact, repairs=repairs)

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
        for i, other in enumerate(lenses):
            a, b = ([x.fx, x.fy, x.cx, x.cy, *x.distortion] for x in (lenses[0], other))
            same = len(a) == len(b) and lenses[0].model == other.model
            if not same or not np.allclose(a, b, rtol=1e-5, atol=1e-6):
                raise ToolkitError(
                    "the images have different intrinsics", path=self.path,
                    value=self.keys[i] if self.keys else i,
                    hint="one scene has one camera; give its intrinsics with --intrinsics, or "
                    "import the images of each camera as a scene",
                )  # fmt: skip
        return lenses[0]


def pose_or_lost(value: Any, path: Path, at: str) -> tuple[Array, bool]:
    """Return the matrix of `as_matrix` and False, or the identity and True for a lost image.

    A pose of an image that a tracker lost is null, blank, or has a number that is not finite or a
    rotation of zeros.
    """
    if value is None or (isinstance(value, list | str) and not value):
        return np.eye(4), True
    try:
        M = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        flat = list(_flat(value))
        if flat and all(x is None or str(x).lower() in ("", "null", "none", "nan") for x in flat):
            return np.eye(4), True
        return as_matrix(value, path, at), False
    if M.shape in ((4, 4), (3, 4), (16,), (12,)):
        rows = M.reshape(-1, 4)[:3]
        if not np.isfinite(rows).all() or not rows[:, :3].any():
            return np.eye(4), True
    return as_matrix(M, path, at), False


def _flat(value: Any) -> Iterator[Any]:
    if isinstance(value, list | tuple):
        for item in value:
            yield from _flat(item)
    else:
        yield value


def as_matrix(value: Any, path: Path, at: str) -> Array:
    """Return 16 or 12 numbers in any nesting as (4, 4), of which `FiledCameras.rigid` makes a pose.

    Raises:
        ToolkitError: other numbers, or not a rigid transform; `at` names the place.
    """
    try:
        M = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ToolkitError("not a matrix of numbers", path=path, field=at) from error
    if M.shape not in ((4, 4), (3, 4), (16,), (12,)):
        raise ToolkitError(
            "a camera pose needs 4x4 (or 3x4) numbers", path=path, field=at,
            value=f"{M.size} numbers",
        )  # fmt: skip
    M = M.reshape(-1, 4)
    M = M if len(M) == 4 else np.vstack([M, [0.0, 0.0, 0.0, 1.0]])
    with located(path, at):
        _rigid(M)
    return M


def rotation_deviation(M: Array) -> float:
    """Largest entry of `R R^T - I` of the rotation of a homogeneous matrix (4, 4), see `_rigid`."""
    R = M[:3, :3]
    off = [float(np.abs(A @ A.T - np.eye(3)).max()) for A in (R, R / M[3, 3])]
    return min(off)


def _rigid(M: Array) -> Array:
    """Return the rigid transform of a homogeneous matrix (4, 4) with the last row 0 0 0 w.

    A homogeneous matrix is known up to a factor, so that M / w is the pose, if its rotation is
    one. Some writers scale only the translation by w: the rotation is one as it is filed.
    """
    w = float(M[3, 3])
    if not np.isfinite(M).all() or np.abs(M[3, :3]).max() > 1e-6 * abs(w) or w == 0:
        return SE3.from_matrix(M).matrix()  # which refuses it
    limit = CameraTableSettings.current().largest_deviation
    whole = M[:3] / w
    off = np.abs(M[:3, :3] @ M[:3, :3].T - np.eye(3)).max()
    if w > 0 and off <= limit:
        whole = np.column_stack([M[:3, :3], M[:3, 3] / w])
    return SE3(nearest_rotation(whole[:, :3], tolerance=limit), whole[:, 3]).matrix()


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
    rows = [(i, [w for w in re.split(r"[\s,;]+", line.strip("[] ")) if w]) for i, line in lines]
    first = rows[0][1]
    if len(first) > 2 and not any(_is_number(w) for w in first):
        return _read_csv(path, [line for _, line in lines], rows[0][0])
    if len(first) == 1 and len(rows) > 1 and len(rows[1][1]) == 22:
        rows = rows[1:]
    rows = without_frame_numbers(rows)
    widths = {len(words) for _, words in rows}
    named = columns_of_comment(text, len(first)) if len(widths) == 1 else None
    if named is not None and named[-7:] != ["x", "y", "z", "qx", "qy", "qz", "qw"]:
        cells = [named, *(words for _, words in rows)]
        return _read_csv(path, [",".join(c) for c in cells], rows[0][0] - 1)
    if widths == {4} and len(rows) == 3:
        M, is_lost = pose_or_lost(
            _numbers(path, [w for _, words in rows for w in words], "line 1"), path, ""
        )
        lost = frozenset({0} if is_lost else ())
        return FiledCameras(path=path, kind="matrices", matrices=M[None], lost=lost)
    if widths == {4} and len(rows) % 4 == 0:
        rows = [
            (rows[i][0], [w for _, words in rows[i : i + 4] for w in words])
            for i in range(0, len(rows), 4)
        ]
        widths = {16}
    readers: dict[int, Callable[..., FiledCameras]] = {
        8: _read_tum, 12: _read_rows, 16: _read_rows, 13: _read_rows, 17: _read_rows, 22: _read_par,
    }  # fmt: skip
    if len(widths) > 1 or not widths & readers.keys():
        shown = ", ".join(map(str, sorted(widths)[:4]))
        raise ToolkitError(
            f"unknown layout of camera poses: {shown} columns", path=path,
            hint="8 (TUM: time tx ty tz qx qy qz qw), 12 or 16 (matrix), 13 or 17 (name, matrix), "
            "22 (name K R t), or CSV with a header",
        )  # fmt: skip
    return readers[widths.pop()](path, rows)


Rows = list[tuple[int, list[str]]]


def _read_rows(path: Path, rows: Rows) -> FiledCameras:
    named = len(rows[0][1]) in (13, 17)
    found = [
        pose_or_lost(_numbers(path, words[named:], f"line {i}"), path, f"line {i}")
        for i, words in rows
    ]
    return FiledCameras(
        path=path,
        kind="matrices",
        matrices=np.array([M for M, _ in found]),
        keys=[words[0] for _, words in rows] if named else None,
        lost=frozenset(i for i, (_, lost) in enumerate(found) if lost),
    )


def _read_tum(path: Path, rows: Rows) -> FiledCameras:
    matrices: list[Array] = []
    lost: set[int] = set()
    for i, words in rows:
        tx, ty, tz, *xyzw = _numbers(path, words[1:], f"line {i}")
        if not np.isfinite([tx, ty, tz, *xyzw]).all() or not any(xyzw):
            lost.add(len(matrices))
            matrices.append(np.eye(4))
            continue
        matrices.append(_from_quat([xyzw[3], *xyzw[:3]], [tx, ty, tz], path, f"line {i}"))
    return FiledCameras(
        path=path,
        kind="tum",
        matrices=np.array(matrices),
        keys=[words[0] for _, words in rows],
        lost=frozenset(lost),
    )


def _read_par(path: Path, rows: Rows) -> FiledCameras:
    matrices: list[Array] = []
    lenses: list[Intrinsics] = []
    lost: set[int] = set()
    for i, words in rows:
        at = f"line {i}"
        values = np.array(_numbers(path, words[1:], at))
        K = values[:9].reshape(3, 3)
        if abs(K[0, 1]) > 1e-6 * abs(K[0, 0]) or np.abs(K[1:, 0]).max() > 0 or K[2, 2] != 1:
            raise ToolkitError("K has skew or is no camera matrix", path=path, field=at)
        lenses.append(Intrinsics(K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
        M = np.column_stack([values[9:18].reshape(3, 3), values[18:21]])
        matrix, is_lost = pose_or_lost(M, path, at)
        lost |= {len(matrices)} if is_lost else set()
        matrices.append(matrix)
    return FiledCameras(
        path=path,
        kind="par",
        matrices=np.array(matrices),
        keys=[words[0] for _, words in rows],
        lenses=lenses,
        convention="world-to-camera",
        lost=frozenset(lost),
    )


def _read_csv(path: Path, lines: Sequence[str], first: int) -> FiledCameras:
    delimiter = next((d for d in (",", ";", "\t") if d in lines[0]), " ")
    table = list(csv_rows(lines, path, first=first, delimiter=delimiter))
    columns = plain_columns(table[0])
    key = next((k for k in _KEYS if k in columns), None)
    position = next((p for p in _POSITIONS if set(p) <= set(columns)), None)
    matrix = set(_MATRIX[:12]) <= set(columns)
    rotation = next((r for r in (_QUATERNION, _VECTOR) if set(r) <= set(columns)), None)
    if not matrix and (position is None or rotation is None):
        raise ToolkitError(
            "the columns do not hold a pose", path=path, value=columns,
            hint="position x y z; rotation qw qx qy qz or rx ry rz (radians); or m00 to m33",
        )  # fmt: skip
    used = _MATRIX[:12] if matrix else (*(position or ()), *(rotation or ()))
    matrices, keys = [], []
    for i, line in enumerate(table[1:], start=first + 1):
        row, at = dict(zip(columns, line, strict=False)), f"line {i}"
        cells = [row.get(c) or "" for c in used]
        if all(c.strip().lower() in ("", "null", "none", "nan", "lost") for c in cells):
            continue  # a frame without a pose
        values = _numbers(path, cells, at)
        if _is_lost(values, rotation if not matrix else None):
            continue
        matrices.append(_csv_matrix(values, rotation if not matrix else None, path, at))
        keys.append((row.get(key) or "").strip() if key else "")
    if not matrices:
        raise ToolkitError("the file has no camera poses", path=path)
    return FiledCameras(
        path=path, kind="csv", matrices=np.array(matrices), keys=keys if all(keys) else None
    )


def _is_lost(values: list[float], rotation: tuple[str, ...] | None) -> bool:
    if not np.isfinite(values).all():
        return True
    if rotation is None:
        return not any(values[i] for i in (0, 1, 2, 4, 5, 6, 8, 9, 10))
    return rotation == _QUATERNION and not any(values[3:])


def _csv_matrix(
    values: list[float], rotation: tuple[str, ...] | None, path: Path, at: str
) -> Array:
    if rotation is None:
        return as_matrix(values, path, at)
    if rotation == _QUATERNION:
        return _from_quat(values[3:], values[:3], path, at)
    if float(np.linalg.norm(values[3:])) > CameraTableSettings.current().largest_turn:
        raise ToolkitError(
            "a rotation vector is in radians", path=path, field=at, value=values[3:],
            hint="are these degrees, or Euler angles? convert them",
        )  # fmt: skip
    return SE3(so3_exp(values[3:]), np.array(values[:3])).matrix()


def _from_quat(wxyz: Sequence[float], t: Sequence[float], path: Path, at: str) -> Array:
    with located(path, at):
        return SE3.from_quat(wxyz, t).matrix()


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _numbers(path: Path, words: Sequence[str], at: str) -> list[float]:
    try:
        return [float(w) for w in words]
    except ValueError as error:
        wrong = next(w for w in words if not _is_number(w))
        raise ToolkitError("not a number", path=path, field=at, value=wrong) from error
