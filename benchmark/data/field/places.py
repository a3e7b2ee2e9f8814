"""Cameras, poses and numbers as files of the field's sets state them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.se3 import nearest_rotation
from std_toolkit.log import logger

# Numbers in names and lists; longer ones are none of a frame or an object.
_MOST_DIGITS = 9
# No table-top object is farther; one in millimetres is hardly nearer than as many metres.
_FARTHEST_M = 50.0


def camera_of(K: ArrayLike, size: tuple[int, int], path: Path) -> Camera:
    """Return a camera from a 3x3 matrix.

    Raises:
        ToolkitError: not such a matrix, or it does not fit the image.
    """
    try:
        matrix = np.asarray(K, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise ToolkitError("not a 3x3 matrix of a pinhole camera", path=path) from error
    if matrix.shape != (3, 3) or abs(matrix[0, 1]) > 1e-6 or abs(matrix[2, 2] - 1) > 1e-6:
        raise ToolkitError("not a 3x3 matrix of a pinhole camera", path=path, value=matrix.shape)
    try:
        return Camera(*size, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
    except ToolkitError as error:
        raise error.revised(path=path) from error


def pose_of(R: ArrayLike, t: ArrayLike, path: Path) -> SE3:
    """Return a pose; a rotation that is a little off is made exact.

    Args:
        R: (3, 3) rotation.
        t: 3 metres.
        path: of the file, for errors.

    Raises:
        ToolkitError: no rotation, or a translation that is not finite.
    """
    try:
        found = SE3(nearest_rotation(R), np.asarray(t, np.float64).reshape(3))
    except (ToolkitError, ValueError, TypeError) as error:
        raise ToolkitError(f"no pose: {error}", path=path) from error
    if not np.isfinite(found.t).all():
        raise ToolkitError("no pose: a translation is not finite", path=path)
    return found


def object_pose(R: ArrayLike, t: ArrayLike, path: Path) -> SE3:
    """Return `T_cam_obj` of a set whose translations are known to be in metres.

    Args:
        R, t, path: see `pose_of`.

    Raises:
        ToolkitError: no pose, or farther than an object can be.
    """
    found = pose_of(R, t, path)
    if np.abs(found.t).max() > _FARTHEST_M:
        raise ToolkitError(
            "the translations of this set are known to be in metres", path=path,
            field="translation", value=[float(f"{x:.6g}") for x in found.t],
            hint="millimetres? divide them by 1000",
        )  # fmt: skip
    return found


def whole_number(text: str) -> int:
    """Return the number that a text of at most nine digits states; -1 for any other text."""
    is_number = text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS
    return int(text) if is_number else -1


# Unit that was told of the places of each set in this process, and the file that told it.
_told: dict[Path, tuple[float, Path]] = {}
_UNITS = {1.0: "metres", 0.001: "millimetres"}


def unit_of_place(t: ArrayLike, path: Path, data: Path) -> float:
    """Return the metres per number of a place before the camera, for sets that do not state it.

    A depth camera sees from centimetres to metres: numbers below 10 are metres, above 150
    millimetres; those between may be centimetres. The unit is logged once for each set, and all
    files of a set have one.

    Args:
        t: x, y, z in the camera's frame, z forward.
        path: of the file, for errors.
        data: folder of the set or of its sequence.

    Raises:
        ToolkitError: behind the camera, neither, or another unit than earlier files of the set.
    """
    z = float(np.asarray(t, np.float64).ravel()[2])
    if not (0.01 < z < 10 or 150 < z < 10_000):
        raise ToolkitError(
            "an object stands before the camera, in metres or in millimetres", path=path,
            field="translation", value=f"z = {z:g}",
        )  # fmt: skip
    unit = 1.0 if z < 10 else 0.001
    if data not in _told:
        _told[data] = unit, path
        logger.warning(
            "%s: the set does not state the unit of its poses; an object at z = %g of %s tells %s",
            data, z, path.name, _UNITS[unit],
        )  # fmt: skip
    before, first = _told[data]
    if unit != before:
        raise ToolkitError(
            f"a place in {_UNITS[unit]}, where {first.name} has {_UNITS[before]}", path=path,
            field="translation", value=f"z = {z:g}",
        )  # fmt: skip
    return unit
