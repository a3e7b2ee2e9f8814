"""What all documents of a scene share: strictness, number types and checks."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import InvalidDocument

Positive = Annotated[float, msgspec.Meta(gt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]
# The largest whole number that every JSON reader keeps exactly is 2^53 - 1.
Count = Annotated[int, msgspec.Meta(ge=0, le=2**53 - 1)]
ObjectId = Annotated[int, msgspec.Meta(ge=1, le=254)]
Pose16 = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]
Covariance36 = Annotated[list[float], msgspec.Meta(min_length=36, max_length=36)]
Vector3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]


class Document(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=False
):
    """Base of all documents. Subclasses override `check`, which runs whenever one is made."""

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
        """Raise ToolkitError for what the types of the fields cannot tell."""


def pose_from_list(numbers: list[float]) -> SE3:
    """SE3 of 16 numbers already validated by a document."""
    M = np.asarray(numbers, dtype=np.float64).reshape(4, 4)
    return SE3(M[:3, :3].copy(), M[:3, 3].copy())


def check_pose(numbers: list[float] | None, field: str) -> None:
    """Refuse 16 numbers that are no pose; None passes.

    Raises:
        ToolkitError: not a rigid transform.
    """
    if numbers is None:
        return
    try:
        SE3.from_matrix(numbers)
    except ToolkitError as error:
        raise ToolkitError(
            error.problem, field=field, value=error.value, hint=error.hint
        ) from error


def check_unique(values: list[str], table: str, field: str) -> None:
    """Refuse a value that appears in two rows of a table.

    Raises:
        ToolkitError: naming the second row.
    """
    seen: set[str] = set()
    for i, value in enumerate(values):
        if value in seen:
            raise ToolkitError("appears twice", field=f"{table}[{i}].{field}", value=value)
        seen.add(value)


def find_row(table: list[Any], key: str, value: object, kind: str) -> Any:
    """The row of a table whose `key` is `value`.

    Raises:
        ToolkitError: there is none; the message lists the known ones.
    """
    for row in table:
        if getattr(row, key) == value:
            return row
    raise ToolkitError(
        f"no such {kind}",
        value=value,
        hint=f"known: {', '.join(str(getattr(r, key)) for r in table) or 'none'}",
    )
