"""What made a derived file: enough to skip a step that is done and to redo one that is stale."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import msgspec

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.log import logger
from std_toolkit.scene.document import Document


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
