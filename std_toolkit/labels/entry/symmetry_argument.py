"""Symmetries from command-line arguments or a JSON file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, rotation_angle, so3_exp
from std_toolkit.geometry.symmetry import Symmetry, closed_group, symmetry_words
from std_toolkit.geometry.symmetry_search import check_symmetry, detect_symmetry
from std_toolkit.io.documents import read_document
from std_toolkit.scene.model import ContinuousSymmetry, SymmetryModel

if TYPE_CHECKING:
    import trimesh

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
SYNTAX = (
    "none | auto (found in the mesh) | axis:x|y|z (any turn) | fold:x|y|z:N (N equal turns) | "
    "a JSON file; "
    "axis and fold pass through the bounding box's centre, with '@origin' through the mesh origin"
)


def parse_symmetry(
    arguments: Sequence[str], *, centre: Sequence[float], mesh: trimesh.Trimesh | None = None
) -> SymmetryModel:
    """The symmetry that the arguments describe together.

    Args:
        arguments: each as in `SYNTAX`. A JSON file contains either {"discrete", "continuous"} in
            metres, as in objects.json, or BOP's {"symmetries_discrete", "symmetries_continuous"}
            in millimetres.
        centre: (3,) centre of the mesh's bounding box, metres.
        mesh: the mesh, metres, for `auto`.

    Raises:
        ToolkitError: an invalid argument, `none` or `auto` together with others, or a file
            without a symmetry.
    """
    discrete: list[list[float]] = []
    continuous: list[ContinuousSymmetry] = []
    alone = next((word for word in ("none", "auto") if word in arguments), None)
    if alone is not None and len(set(arguments)) > 1:
        raise ToolkitError(
            f"'{alone}' contradicts the other symmetries",
            field="--symmetry",
            value=" ".join(arguments),
            hint="remove one of them",
        )
    if alone == "auto" and mesh is not None:
        return symmetry_model(detect_symmetry(mesh).appearance)
    for text in arguments:
        if text == "none":
            continue
        if text.lower().endswith(".json"):
            part = read_symmetry_file(Path(text))
        else:
            part = _named(text, np.asarray(centre, dtype=np.float64))
        discrete += part.discrete
        continuous += part.continuous
    group = closed_group([SE3.from_matrix(T) for T in discrete])
    return SymmetryModel(discrete=[T.flat() for T in group[1:]], continuous=continuous)


def symmetry_model(symmetry: Symmetry) -> SymmetryModel:
    """The document of a symmetry."""
    return SymmetryModel(
        discrete=[list(T) for T in symmetry.discrete],
        continuous=[
            ContinuousSymmetry(axis=list(axis), offset=list(offset))
            for axis, offset in symmetry.continuous
        ],
    )


def symmetry_proposal(mesh: trimesh.Trimesh) -> str | None:
    """A sentence on the turns after which a mesh is the same; None if there are none."""
    found = detect_symmetry(mesh)
    if found.shape.is_trivial:
        return None
    words = symmetry_words(found.appearance)
    if found.appearance == found.shape:
        return f"the mesh is the same after: {words}"
    shape = symmetry_words(found.shape)
    return f"the mesh has the same shape after: {shape}; with its colours: {words}"


def symmetry_doubt(mesh: trimesh.Trimesh, symmetry: SymmetryModel) -> str | None:
    """A sentence if the mesh is not the same after a declared turn; None if it is."""
    found = check_symmetry(mesh, symmetry.symmetry())
    if found is None or found.fits:
        return None
    return (
        f"a declared turn of {np.rad2deg(rotation_angle(found.turn.R)):.0f} deg moves the surface "
        f"by {1000 * found.distance_m:.1f} mm (95 % of it by less)"
    )


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
