"""Recordings exported with a sidecar, which has everything that the layout cannot represent."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.importers.foreign_files import mesh_suffix, model_of_mesh
from std_toolkit.importers.importer import Recording, SourceFile, SourceFrame, SourceModel
from std_toolkit.scene.document import check_name, check_relative
from std_toolkit.scene.sidecar import SIDECAR_NAME, ExportedFrame, ExportedModel, Sidecar


def recording_from_sidecar(
    sidecar: Sidecar,
    top: Path,
    *,
    color: Callable[[str], Path],
    depth: Callable[[str], Path],
    depth_scale: float | None,
    reference: Callable[[str], tuple[tuple[str, Path], ...]],
) -> Recording:
    """A recording of an export in the STD or NOCS layout.

    Args:
        top: folder of the export.
        color, depth: files of a frame, by its stem.
        depth_scale: metres per unit of 16-bit depth files; None for EXR.
        reference: pairs (kind of map, file) of a frame, for "depth", "mask" and "nocs".

    Raises:
        ToolkitError: the sidecar names files outside the export.
    """
    path = top / SIDECAR_NAME
    frames = []
    for i, row in enumerate(sidecar.frames):
        stem = check_name(row.stem, path=path, field=f"frames[{i}].stem")
        frames.append(_frame(row, color(stem), depth(stem), depth_scale, reference(stem)))
    has_depth = any(f.depth is not None for f in frames)
    return Recording(
        source=f"import:{sidecar.layout}",
        cameras={key: model.camera() for key, model in sidecar.scene.cameras.items()},
        frames=tuple(frames),
        # The exported depth already includes the correction factor.
        depth_scale=depth_scale if has_depth else None,
        models=tuple(exported_model(sidecar, m, top) for m in sidecar.models),
        objects=tuple(sidecar.objects.objects),
        poses=sidecar.poses,
        labels=sidecar.labels,
    )


def exported_model(sidecar: Sidecar, row: ExportedModel, top: Path) -> SourceModel:
    """A mesh of the export, converted to the scene's mesh frame and metres.

    Raises:
        ToolkitError: it is missing, damaged or outside the export.
    """
    relative = check_relative(row.path, path=top / SIDECAR_NAME, field="models.path")
    try:
        known = sidecar.objects.model(row.model)
    except ToolkitError as error:
        raise ToolkitError(
            "the table of objects has no such model",
            path=top / SIDECAR_NAME,
            field="models",
            value=row.model,
        ) from error
    # load_mesh converts millimetres; STD's meshes have a unit diagonal.
    mesh = load_mesh(top / relative, unit="mm" if row.metres_per_unit == 0.001 else "m")
    factor = 1.0 if row.metres_per_unit == 0.001 else row.metres_per_unit
    mesh.vertices = np.asarray(mesh.vertices) * factor + np.asarray(row.centre_m)
    model = model_of_mesh(
        mesh,
        model_id=known.id,
        category=known.category,
        class_id=known.class_id,
        symmetry=known.symmetry,
        suffix=mesh_suffix(mesh),
    )
    return SourceModel(model=model, mesh=mesh)


def _frame(
    row: ExportedFrame,
    color: Path,
    depth: Path,
    depth_scale: float | None,
    reference: tuple[tuple[str, Path], ...],
) -> SourceFrame:
    return SourceFrame(
        id=row.id,
        name=row.name,
        color=SourceFile(source=color, target=f"color/{row.name}", kind="color"),
        depth=SourceFile(
            source=depth, target=f"depth/{row.name}", kind="depth", depth_scale=depth_scale
        )
        if row.sensor_depth
        else None,
        camera=row.camera,
        timestamp=row.timestamp,
        reference=reference_files(row.name, reference),
    )


def reference_files(name: str, files: tuple[tuple[str, Path], ...]) -> tuple[SourceFile, ...]:
    """Ground truth of a recording, kept in `reference/`: (kind, file) pairs."""
    return tuple(
        SourceFile(
            source=path,
            target=f"reference/{kind}/{name}",
            kind="map" if kind == "nocs" else kind,  # type: ignore[arg-type]
            background=255 if kind == "mask" else None,
            same_size=False,
        )
        for kind, path in files
    )
