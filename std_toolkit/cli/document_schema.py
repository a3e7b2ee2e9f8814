"""JSON Schema of every document, generated from the msgspec structures that read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from std_toolkit.checks.result import CheckReport
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import DIALECT
from std_toolkit.io.regular import read_regular
from std_toolkit.jobs import artefact
from std_toolkit.project.dataset_card import Dataset
from std_toolkit.project.people import Tokens
from std_toolkit.project.record import ProjectRecord
from std_toolkit.rendering.ground_truth import FrameTruth
from std_toolkit.scene import model, review, sidecar

_ADDRESS = "https://std-toolkit.example/schemas"


def document_types() -> dict[str, type]:
    """The structure of each kind of document, by name."""
    return {
        "scene": model.SceneInfo,
        "frames": model.Frames,
        "objects": model.ObjectTable,
        "poses": model.CameraPoses,
        "labels": model.Labels,
        "annotation": model.Annotation,
        "review": review.Reviews,
        "project": ProjectRecord,
        "tokens": Tokens,
        "dataset": Dataset,
        "ground_truth": FrameTruth,
        "check_report": CheckReport,
        "record": artefact.Record,
        "export": sidecar.Sidecar,
    }


def document_schema(name: str) -> dict[str, Any]:
    """JSON Schema (2020-12) of one kind of document.

    The schema covers fields, types and ranges. Rules between values (unique ids, valid rotations,
    existing names) are checked when a document is read; data_spec.md lists them.

    Raises:
        ToolkitError: no such kind of document.
    """
    types = document_types()
    if name not in types:
        raise ToolkitError("no such document", value=name, hint=f"known: {', '.join(types)}")
    schema = msgspec.json.schema(types[name])
    return {
        "$schema": DIALECT,
        "$id": f"{_ADDRESS}/{name}.schema.json",
        **schema,
    }


def schema_bytes(name: str) -> bytes:
    """The schema as it is stored in `schemas/`."""
    text = msgspec.json.format(msgspec.json.encode(document_schema(name)), indent=2)
    return text + b"\n"


def write_schemas(folder: Path) -> list[Path]:
    """Write the schemas of all documents to `folder`; returns their paths."""
    paths = []
    for name in document_types():
        path = folder / f"{name}.schema.json"
        if path.exists() and _ADDRESS.encode() not in read_regular(path, "schema"):
            raise ToolkitError("is not a schema of std-toolkit", path=path, hint="move it away")
        write_bytes_atomic(path, schema_bytes(name))
        paths.append(path)
    return paths
