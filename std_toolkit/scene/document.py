"""Strict documents of a scene, and names that are safe in file paths."""

import math
import re
import unicodedata
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import InvalidDocument

Positive = Annotated[float, msgspec.Meta(gt=0)]

NonNegative = Annotated[float, msgspec.Meta(ge=0)]

# 2^53 - 1 is the largest integer that every JSON reader represents exactly.
Count = Annotated[int, msgspec.Meta(ge=0, le=2**53 - 1)]

ObjectId = Annotated[int, msgspec.Meta(ge=1, le=254)]

Pose16 = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]

Covariance36 = Annotated[list[float], msgspec.Meta(min_length=36, max_length=36)]

Vector3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]

_SAFE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,127}")

_SAFE_PATH = re.compile(rf"(?:{_SAFE.pattern}/)*{_SAFE.pattern}")

_LONGEST_PATH = 512

# An object nearer than 1 cm or further than 20 m has a wrong unit.
NEAREST_M, FURTHEST_M = 0.01, 20.0


class Document(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=False
):
    """Base class of all documents. Subclasses override `check`, which runs on construction."""

    def __post_init__(self) -> None:
        try:
            self.check()
        except InvalidDocument:
            raise
        except ToolkitError as error:
            raise InvalidDocument(
                error.problem,
                path=error.path,
                field=error.field,
                value=error.value,
                hint=error.hint,
            ) from error

    def check(self) -> None:
        """Raise ToolkitError for values that violate more than the types of the fields."""


def pose_from_list(numbers: list[float]) -> SE3:
    """Return the SE3 of 16 numbers that a document has validated."""
    M = np.asarray(numbers, dtype=np.float64).reshape(4, 4)
    return SE3(M[:3, :3].copy(), M[:3, 3].copy())


def check_pose(numbers: list[float] | None, field: str) -> None:
    """Check that 16 numbers are a pose; None passes.

    Raises:
        ToolkitError: the numbers are not a rigid transform.
    """
    if numbers is None or _is_exact(numbers):
        return
    with located(None, field):
        SE3.from_matrix(numbers)


def _is_exact(numbers: list[float]) -> bool:
    """Whether 16 numbers are a pose to 1e-6: quick, because a scene has thousands of them."""
    if len(numbers) != 16:
        return False
    a, b, c, x, d, e, f, y, g, h, i, z, *last = numbers
    return (
        last == [0, 0, 0, 1]
        and math.isfinite(x)
        and math.isfinite(y)
        and math.isfinite(z)
        and abs(a * a + b * b + c * c - 1) < 1e-6
        and abs(d * d + e * e + f * f - 1) < 1e-6
        and abs(g * g + h * h + i * i - 1) < 1e-6
        and abs(a * d + b * e + c * f) < 1e-6
        and abs(a * g + b * h + c * i) < 1e-6
        and abs(d * g + e * h + f * i) < 1e-6
        and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    )


def check_unique(values: list[str], table: str, field: str) -> None:
    """Check that no value appears in two rows of a table.

    Raises:
        ToolkitError: a value appears twice; the message names the second row.
    """
    seen: set[str] = set()
    for i, value in enumerate(values):
        if value in seen:
            raise ToolkitError("appears twice", field=f"{table}[{i}].{field}", value=value)
        seen.add(value)


def find_row(table: list[Any], key: str, value: object, kind: str) -> Any:
    """Return the row of a table whose `key` is `value`.

    Raises:
        ToolkitError: there is no such row; the message lists the known values.
    """
    for row in table:
        if getattr(row, key) == value:
            return row
    raise ToolkitError(
        f"no such {kind}",
        value=value,
        hint=f"known: {', '.join(str(getattr(r, key)) for r in table) or 'none'}",
    )


def check_name(name: str, *, path: Path | str | None = None, field: str = "name") -> str:
    """Return `name` if it is safe as part of a path.

    Raises:
        ToolkitError: it has an invalid character, such as a separator, does not start with a
            letter or digit, is empty or too long.
    """
    if not _SAFE.fullmatch(name):
        raise ToolkitError(
            "not a safe name",
            path=path,
            field=field,
            value=name,
            hint="use letters, digits, '.', '_', '+', '-'; at most 128, first a letter or digit",
        )
    return name


def safe_name(text: str) -> str:
    """Return a safe name similar to `text`: other characters become '_'.

    Accents are left out; letters of other scripts become their number, so that different names
    stay different.

    >>> safe_name("Tasse é [1]"), safe_name("杯子")
    ('Tasse_e_1_', 'u676fu5b50')
    """
    plain = "".join(
        c if c.isascii() or not c.isalnum() else f"u{ord(c):x}"
        for c in unicodedata.normalize("NFKD", text)
        if not unicodedata.combining(c)
    )
    name = re.sub(r"[^A-Za-z0-9._+-]+", "_", plain).lstrip("._+-")[:128]
    return name or "unnamed"


def check_relative(text: str, *, path: Path | str | None = None, field: str = "path") -> str:
    """Return `text` if it is a relative path that stays inside its folder.

    Raises:
        ToolkitError: it is absolute, too long, or has '..' or a part that is not a safe name.
    """
    # Not split with pathlib, which accepts "a//b" and "./a": two spellings of one file would be
    # undetected duplicates.
    if len(text) > _LONGEST_PATH or not _SAFE_PATH.fullmatch(text):
        raise ToolkitError(
            "not a relative path inside the scene folder",
            path=path,
            field=field,
            value=text,
            hint="paths in a scene are relative, without '..'",
        )
    return text


def check_in_front(
    T_cam_obj: SE3,
    *,
    path: Path | str | None = None,
    unit_hint: str = "if the pose is in millimetres, give --pose-unit mm",
) -> None:
    """Check that the origin of a pose can be in view of the camera.

    `unit_hint` is the hint for a distance that suggests a wrong unit.

    Raises:
        ToolkitError: it is behind the camera, or its distance suggests a wrong unit.
    """
    z = float(T_cam_obj.t[2])
    if z <= 0:
        raise ToolkitError(
            "the object lies behind the camera",
            path=path,
            value=f"z = {z:.4g} m",
            hint="check for an inverted pose or OpenGL camera axes (--pose-convention opengl)",
        )
    distance = math.hypot(*T_cam_obj.t)
    if z < NEAREST_M or not distance <= FURTHEST_M:
        raise ToolkitError(
            "the object's distance is implausible",
            path=path,
            value=f"z = {z:.4g} m" + (f", {distance:.4g} m away" if distance > 2 * z else ""),
            hint=unit_hint,
        )
