"""Result files of the BOP Challenge: one estimated pose a line, millimetres."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry.se3 import SE3
from std_toolkit.importers.bop_documents import (
    filed_pose,
    first_bad_pose,
    unchecked_pose,
)
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.foreign_files import csv_rows

_COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
_MM = 1000.0
_SAME_TIME_S = 0.001  # as bop_toolkit


@dataclass(frozen=True, eq=False)
class BopEstimate:
    """An estimated pose.

    Attributes:
        scene_id, im_id, obj_id: numbers of the scene, the image and the object.
        score: confidence.
        T_cam_obj: model to camera, metres; the rotation as filed.
        seconds: that the whole image took; -1 if unknown.
    """

    scene_id: int
    im_id: int
    obj_id: int
    score: float
    T_cam_obj: SE3
    seconds: float = -1.0


def read_bop_results(path: Path | str) -> list[BopEstimate]:
    """Read a result file (`scene_id,im_id,obj_id,score,R,t,time`, with or without that line).

    Args:
        path: of the CSV file.

    Returns:
        The estimates in the order of the file.

    Raises:
        ToolkitError: cannot be read, a field that is none, a rotation that is more than 5 % off,
            or times that differ by more than a millisecond within an image.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "method_set-test.csv"
    ...     _ = path.write_text("1,3,5,0.9,1 0 0 0 1 0 0 0 1,0 0 700,0.1")
    ...     read_bop_results(path)[0].T_cam_obj.t.round(9).tolist()
    [0.0, 0.0, 0.7]
    """
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv_rows(file, path))
    except (OSError, UnicodeDecodeError) as error:
        raise ToolkitError(f"cannot read the results: {error}", path=path) from error
    estimates: list[BopEstimate] = []
    numbers: list[int] = []
    times: dict[tuple[int, int], float] = {}
    for number, row in enumerate(rows, start=1):
        if not row or (number == 1 and row[0].strip() == _COLUMNS[0]):
            continue
        if len(row) != len(_COLUMNS):
            raise ToolkitError(
                f"needs {len(_COLUMNS)} fields: {','.join(_COLUMNS)}",
                path=path,
                field=f"line {number}",
                value=len(row),
            )
        estimate = _estimate(row, path, number)
        image = (estimate.scene_id, estimate.im_id)
        if abs(times.setdefault(image, estimate.seconds) - estimate.seconds) > _SAME_TIME_S:
            raise ToolkitError(
                "the time of an image must be the same in all its lines",
                path=path,
                field=f"line {number}, time",
                value=estimate.seconds,
            )
        estimates.append(estimate)
        numbers.append(number)
    poses = [e.T_cam_obj for e in estimates]
    bad = first_bad_pose([T.R for T in poses], [T.t for T in poses])
    if bad is not None:
        with located(path, f"line {numbers[bad]}, R or t"):
            filed_pose(poses[bad].R, poses[bad].t * _MM)
    return estimates


def write_bop_results(path: Path | str, estimates: Iterable[BopEstimate]) -> None:
    """Write a result file that the BOP Challenge's server and tools read.

    Args:
        path: of the CSV file.
        estimates: in any order.

    Raises:
        ToolkitError: cannot be written.

    >>> write_bop_results("/dev/null", [])  # doctest: +SKIP
    """
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for e in estimates:
        R = " ".join(repr(float(x)) for x in e.T_cam_obj.R.ravel())
        t = " ".join(repr(float(x)) for x in _MM * e.T_cam_obj.t)
        writer.writerow([e.scene_id, e.im_id, e.obj_id, repr(e.score), R, t, repr(e.seconds)])
    write_bytes_atomic(Path(path), text.getvalue().encode())


def _estimate(row: list[str], path: Path, number: int) -> BopEstimate:
    fields = dict(zip(_COLUMNS, row, strict=True))
    name = ""
    try:
        ids = []
        for name in _COLUMNS[:3]:
            ids.append(int(fields[name]))
            if ids[-1] < 0:
                raise ValueError
        numbers = []
        for name in ("score", "time"):
            numbers.append(float(fields[name]))
            if not np.isfinite(numbers[-1]):
                raise ValueError
        name = "R"
        R = np.array([float(x) for x in fields["R"].split()]).reshape(3, 3)
        name = "t"
        t_mm = np.array([float(x) for x in fields["t"].split()]).reshape(3)
        T = unchecked_pose(R, t_mm)
    except ValueError as error:
        raise ToolkitError(
            "is not what BOP's result format has there",
            path=path,
            field=f"line {number}, {name}",
            value=fields.get(name),
            hint="R has nine and t three numbers, split by spaces",
        ) from error
    return BopEstimate(ids[0], ids[1], ids[2], numbers[0], T, numbers[1])
