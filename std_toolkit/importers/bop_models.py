"""Models of a BOP data set: PLY in millimetres, symmetries from models_info.json."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.sidecar import Sidecar
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.se3 import SE3
from std_toolkit.importers.bop_documents import MM, ModelInfo, named
from std_toolkit.importers.mesh_files import mesh_suffix, model_of_mesh
from std_toolkit.importers.protocol import SourceModel
from std_toolkit.io.documents import read_document
from std_toolkit.scene.model import ContinuousSymmetry, SymmetryModel


def read_models(
    top: Path, folder: Path, numbers: list[int], sidecar: Sidecar | None
) -> tuple[dict[int, SourceModel], dict[int, NDArray[np.float64]]]:
    """Models by obj_id, and where the scene's mesh origin lay before BOP's recentring.

    Args:
        top: of the data set, for error messages.
        folder: of the models.
        numbers: obj_ids that the scene needs.
        sidecar: of the toolkit's own export: model ids, categories and mesh origins.

    Returns:
        Models in metres, and per obj_id the (3,) offset in metres such that
        `p_scene = p_bop + offset`.

    Raises:
        ToolkitError: models are missing or damaged.
    """
    if not numbers:
        return {}, {}
    info_path = folder / "models_info.json"
    if not folder.is_dir():
        raise ToolkitError(
            "the data set's models are missing", path=folder, hint="give --models DIR"
        )
    infos = read_document(info_path, dict[str, ModelInfo]) if info_path.is_file() else {}
    models, centres = {}, {}
    for number in numbers:
        exported = None
        if sidecar is not None:
            exported = next((m for m in sidecar.models if m.layout_id == str(number)), None)
            if exported is None:
                raise ToolkitError("std_toolkit.json lacks a model", path=top, value=number)
        centre = np.zeros(3) if exported is None else np.asarray(exported.centre_m)
        mesh = load_mesh(folder / f"obj_{number:06d}.ply", unit="mm")
        mesh.vertices = np.asarray(mesh.vertices) + centre
        known = None
        if sidecar is not None and exported is not None:
            known = sidecar.objects.model(exported.model)
        with named(info_path, str(number)):
            symmetry = symmetry_of(infos.get(str(number)), centre)
        model = model_of_mesh(
            mesh,
            model_id=known.id if known else f"obj_{number:06d}",
            category=known.category if known else "other",
            class_id=known.class_id if known else 0,
            symmetry=symmetry,
            suffix=mesh_suffix(mesh),
        )
        models[number] = SourceModel(model=model, mesh=mesh)
        centres[number] = centre
    return models, centres


def symmetry_of(info: ModelInfo | None, centre: NDArray[np.float64]) -> SymmetryModel:
    """Symmetries in the scene's mesh frame, metres."""
    if info is None:
        return SymmetryModel()
    discrete = []
    for T in info.symmetries_discrete:
        M = np.asarray(T, dtype=np.float64).reshape(4, 4).copy()
        M[:3, 3] *= MM
        S = SE3.from_matrix(M)
        discrete.append(SE3(S.R, S.t + centre - S.R @ centre).flat())
    continuous = []
    for c in info.symmetries_continuous:
        axis = np.asarray(c.axis, dtype=np.float64)
        length = float(np.linalg.norm(axis))
        if not np.isfinite(length) or length == 0:
            raise ToolkitError("a symmetry axis has no direction", value=c.axis)
        offset = np.asarray(c.offset, dtype=np.float64) * MM + centre
        continuous.append(
            ContinuousSymmetry(
                axis=[float(x) for x in axis / length], offset=[float(x) for x in offset]
            )
        )
    return SymmetryModel(discrete=discrete, continuous=continuous)
