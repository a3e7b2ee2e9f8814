"""Symmetries from command-line arguments or a JSON file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.io.documents import read_document
from std_toolkit.scene.model import ContinuousSymmetry, SymmetryModel

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
SYNTAX = (
    "none | axis:x|y|z (any turn) | fold:x|y|z:N (N equal turns) | a JSON file; "
    "axis and fold pass through the bounding box's centre, with '@origin' through the mesh origin"
)


def parse_symmetry(arguments: Sequence[str], *, centre: Sequence[float]) -> SymmetryModel:
    """The symmetry that the arguments describe together.

    Args:
        arguments: each as in `SYNTAX`. A JSON file contains either {"discrete", "continuous"} in
            metres, as in objects.json, or BOP's {"symmetries_discrete", "symmetries_continuous"}
            in millimetres.
        centre: (3,) centre of the mesh's bounding box, metres.

    Raises:
        ToolkitError: an invalid argument, `none` together with others, or a file without a
            symmetry.
    """
    discrete: list[list[float]] = []
    continuous: list[ContinuousSymmetry] = []
    if "none" in arguments and len(set(arguments)) > 1:
        raise ToolkitError(
            "'none' contradicts the other symmetries",
            field="--symmetry",
            value=" ".join(arguments),
            hint="remove one of them",
        )
    for text in arguments:
        if text == "none":
            continue
        if text.lower().endswith(".json"):
            part = read_symmetry_file(Path(text))
        else:
            part = _named(text, np.asarray(centre, dtype=np.float64))
        discrete += part.discrete
        continuous += part.continuous
    return SymmetryModel(discrete=_closed(discrete), continuous=continuous)


def read_symmetry_file(path: Path) -> SymmetryModel:
    """Symmetry from a JSON file; see `parse_symmetry`."""
    document: dict[str, Any] = read_document(path, dict[str, Any])
    if "symmetries_discrete" in document or "symmetries_continuous" in document:
        try:
            matrices = [
                np.asarray(m, dtype=np.float64).reshape(4, 4)
                for m in document.get("symmetries_discrete", [])
            ]
            axes = [
                (
                    [float(x) for x in c["axis"]],
                    [float(x) / 1000 for x in c.get("offset", [0, 0, 0])],
                )
                for c in document.get("symmetries_continuous", [])
            ]
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise ToolkitError(f"not a BOP symmetry: {error}", path=path) from error
        for m in matrices:
            m[:3, 3] /= 1000
        return SymmetryModel(
            discrete=[[float(x) for x in m.ravel()] for m in matrices],
            continuous=[ContinuousSymmetry(axis=a, offset=o) for a, o in axes],
        )
    if not set(document) & {"discrete", "continuous"}:
        raise ToolkitError(
            "the file has no symmetry",
            path=path,
            value=sorted(document),
            hint='expected {"discrete": [...], "continuous": [...]} or BOP\'s keys',
        )
    return read_document(path, SymmetryModel)


def _named(text: str, centre: np.ndarray) -> SymmetryModel:
    body, _, through = text.partition("@")
    kind, _, rest = body.partition(":")
    axis_name, _, count = rest.partition(":")
    if (
        axis_name not in AXES
        or through not in ("", "origin", "centre")
        or kind not in ("axis", "fold")
        or (kind == "axis" and count)
        or (kind == "fold" and not (count.isdigit() and 2 <= int(count) <= 360))
    ):
        raise ToolkitError("unknown symmetry", field="--symmetry", value=text, hint=SYNTAX)
    axis = np.array(AXES[axis_name])
    point = np.zeros(3) if through == "origin" else centre
    # The point on the axis nearest to the origin gives round numbers for centred meshes.
    point = point - axis * (axis @ point)
    if kind == "axis":
        offset = [float(x) for x in point]
        return SymmetryModel(
            continuous=[ContinuousSymmetry(axis=[float(x) for x in axis], offset=offset)]
        )
    turns = []
    for k in range(1, int(count)):
        R = so3_exp(axis * (2 * np.pi * k / int(count)))
        turns.append(SE3(R, point - R @ point).flat())
    return SymmetryModel(discrete=turns)


def _closed(discrete: list[list[float]]) -> list[list[float]]:
    """The group that the transforms generate, without the identity.

    Two half turns about x and y imply the one about z; without it, a correct pose would count as
    wrong.
    """
    group = [SE3.identity()]
    generators = [SE3.from_matrix(T) for T in discrete]
    frontier = list(group)
    while frontier:
        fresh = []
        for a in frontier:
            for b in generators:
                product = a @ b
                if not any(_same(product, g) for g in group):
                    group.append(product)
                    fresh.append(product)
        if len(group) > 400:
            raise ToolkitError(
                "the discrete symmetries do not form a finite group",
                field="symmetry",
                hint="give a continuous symmetry as axis:x|y|z",
            )
        frontier = fresh
    return [g.flat() for g in group[1:]]


def _same(a: SE3, b: SE3) -> bool:
    return bool(np.abs(a.R - b.R).max() < 1e-3 and np.abs(a.t - b.t).max() < 1e-4)
