"""What a scene's files share: strict documents, safe names, provenance records.

Names that are safe as parts of file paths.

What made a derived file: enough to skip a step that is done and to redo one that is stale.
"""

from __future__ import annotations

import hashlib
import math
import re
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import InvalidDocument, read_document, write_document
from std_toolkit.log import logger

Positive = Annotated[float, msgspec.Meta(gt=0)]

NonNegative = Annotated[float, msgspec.Meta(ge=0)]

# The largest whole number that every JSON reader keeps exactly is 2^53 - 1.
Count = Annotated[int, msgspec.Meta(ge=0, le=2**53 - 1)]

ObjectId = Annotated[int, msgspec.Meta(ge=1, le=254)]

Pose16 = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]

Covariance36 = Annotated[list[float], msgspec.Meta(min_length=36, max_length=36)]

Vector3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]

_SAFE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,127}")

_LONGEST_PATH = 512


# An object nearer than 1 cm or further than 20 m is a wrong unit.
NEAREST_M, FURTHEST_M = 0.01, 20.0


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


def check_name(name: str, *, path: Path | str | None = None, field: str = "name") -> str:
    """Return `name` if it may stand in a path.

    Raises:
        ToolkitError: it holds a separator, starts with a dot, is empty or too long.
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
    """The nearest safe name to `text`: other characters become '_'."""
    name = re.sub(r"[^A-Za-z0-9._+-]+", "_", text).lstrip("._+-")[:128]
    return name or "unnamed"


def check_relative(text: str, *, path: Path | str | None = None, field: str = "path") -> str:
    """Return `text` if it is a relative path that stays inside its folder.

    Raises:
        ToolkitError: absolute, too long, with '..' or a part that is no safe name.
    """
    # Splitting by hand: a path library would forgive "a//b" and "./a", and two spellings of one
    # file make duplicates that nobody sees.
    if len(text) > _LONGEST_PATH or not all(_SAFE.fullmatch(part) for part in text.split("/")):
        raise ToolkitError(
            "not a relative path inside the scene folder",
            path=path,
            field=field,
            value=text,
            hint="paths in a scene are relative, without '..'",
        )
    return text


class Record(Document, frozen=True, kw_only=True):
    """The record of one finished step.

    Attributes:
        step: name of the step.
        version: of the toolkit that ran it.
        digest: of everything that determines the result.
        outputs: path relative to the scene folder, to digest of the content.
        parameters: the options of the step, for people.
    """

    step: str
    version: str
    digest: str
    outputs: dict[str, str]
    parameters: dict[str, Any]


def digest_file(path: Path) -> str:
    """Hex digest of a file's content.

    Raises:
        ToolkitError: no regular file there (a pipe or device could block or never end).
    """
    if not path.is_file():
        problem = "is not a regular file" if path.exists() else "file not found"
        raise ToolkitError(problem, path=path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def digest_of(*parts: Any, versioned: bool = True) -> str:
    """Hex digest of plain values and documents; the toolkit's version is part of it if asked for.

    Numbers must be finite: JSON would make null of NaN, and two different inputs would look alike.
    """
    encoded = msgspec.json.encode([__version__ if versioned else "", *parts], order="sorted")
    return hashlib.blake2b(encoded, digest_size=16).hexdigest()


def record_path(root: Path, step: str) -> Path:
    return root / ".std" / "records" / f"{step}.json"


def is_fresh(root: Path, step: str, digest: str) -> bool:
    """Whether the step was finished with these inputs and its outputs are still what it wrote."""
    path = record_path(root, step)
    if not path.exists():
        return False
    try:
        record = read_document(path, Record)
    except ToolkitError as error:
        # A record is a cache: redoing the step is always right, stopping here never helps.
        logger.warning("%s; the step is done again", error)
        return False
    return record.digest == digest and all(
        (root / name).is_file() and digest_file(root / name) == content
        for name, content in record.outputs.items()
    )


def write_record(
    root: Path, step: str, digest: str, *, outputs: list[Path], parameters: dict[str, Any]
) -> None:
    """Record a finished step; call it after its outputs are in place."""
    write_document(
        record_path(root, step),
        Record(
            step=step,
            version=__version__,
            digest=digest,
            outputs={p.relative_to(root).as_posix(): digest_file(p) for p in sorted(outputs)},
            parameters=parameters,
        ),
    )


def check_in_front(T_cam_obj: SE3, *, path: Path | str | None = None) -> None:
    """Refuse a pose whose origin no camera sees.

    Raises:
        ToolkitError: behind the camera, or at a distance that is the mark of a wrong unit.
    """
    z = float(T_cam_obj.t[2])
    if z <= 0:
        raise ToolkitError(
            "the object lies behind the camera",
            path=path,
            value=f"z = {z:.4g} m",
            hint="is this the inverse pose, or one with OpenGL camera axes "
            "(--pose-convention opengl)?",
        )
    distance = math.hypot(*T_cam_obj.t)
    if z < NEAREST_M or not distance <= FURTHEST_M:
        raise ToolkitError(
            "the object's distance is implausible",
            path=path,
            value=f"z = {z:.4g} m" + (f", {distance:.4g} m away" if distance > 2 * z else ""),
            hint="in millimetres? give --pose-unit mm",
        )
