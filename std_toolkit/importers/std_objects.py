"""Objects of an STD or DREDS download: meta lines, CAD models, poses from NOCS and depth."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, ransac_similarity, unproject_depth
from std_toolkit.geometry.mesh import load_mesh, nocs_frame
from std_toolkit.importers import foreign_files
from std_toolkit.importers.depth_files import read_foreign_depth
from std_toolkit.importers.importer import SourceModel
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.images import image_size, read_png
from std_toolkit.scene.document import check_name, safe_name
from std_toolkit.scene.model import (
    CATEGORY_CLASS_IDS,
    MATERIAL_IDS,
    Label,
    Labels,
    Material,
    Object,
)

MapsOf = Callable[[Path, str], tuple[tuple[str, Path], ...]]
# Number of frames, spread over the recording, in which poses are fitted.
_FITTED_FRAMES = 5
_FEWEST_PIXELS = 100
# 8-bit NOCS is quantised to 0.4 % of the diagonal, 1.2 mm of 0.3 m.
_INLIER_M = 0.005
_CATEGORIES = {number: name for name, number in CATEGORY_CLASS_IDS.items()}
_MATERIALS: dict[int, Any] = {number: name for name, number in MATERIAL_IDS.items()}


@dataclass(frozen=True)
class MetaLine:
    """A line of `_meta.txt`; the folders and the scale are None in the short form."""

    mask_id: int
    class_id: int
    class_folder: str | None
    instance_folder: str | None
    scale: float | None
    material: Material


@dataclass(frozen=True)
class FoundObjects:
    models: tuple[SourceModel, ...] = ()
    objects: tuple[Object, ...] = ()
    labels: Labels | None = None
    notes: list[str] = field(default_factory=list)


def read_meta(path: Path, *, any_class: bool = False) -> list[MetaLine]:
    """Lines of a meta file: 13 fields, or 3 in the short form.

    Args:
        any_class: accept ids from 0, and unknown class numbers as `class_id` 0: category-novel
            sets may use their own numbers.

    Raises:
        ToolkitError: a line is malformed, or an id appears twice.
    """
    try:
        text = path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError) as error:
        raise ToolkitError("cannot read the meta file", path=path) from error
    lines = []
    for i, line in enumerate(text.splitlines()):
        words = line.split()
        if words:
            lines.append(_meta_line(words, path, f"line {i + 1}", any_class))
    ids = [x.mask_id for x in lines]
    if len(set(ids)) != len(ids):
        raise ToolkitError("an id appears twice", path=path, value=ids)
    return lines


def read_objects(
    request: ImportRequest, stems: list[str], layout: str, maps_of: MapsOf, camera: Camera
) -> FoundObjects:
    """Objects with their meshes and poses, as far as the download contains them.

    Raises:
        ToolkitError: a meta file or a mesh is damaged.
    """
    folder = request.source
    with_meta = [s for s in stems if (folder / f"{s}_meta.txt").is_file()]
    if not with_meta:
        return FoundObjects(notes=["no meta files: objects are skipped"])
    metas = {s: read_meta(folder / f"{s}_meta.txt") for s in with_meta}
    meta_lines: dict[int, MetaLine] = {}
    for lines in metas.values():
        for line in lines:
            meta_lines.setdefault(line.mask_id, line)
    cad = _cad_folder(request, meta_lines)
    if cad is None:
        return FoundObjects(
            notes=["no CAD models found: objects are skipped; give their folder with --models"]
        )
    models: dict[str, SourceModel] = {}
    objects, labels = [], []
    for mask_id, line in sorted(meta_lines.items()):
        model = _model(cad, line)
        models.setdefault(model.model.id, model)
        obj = Object(
            id=mask_id,
            name=safe_name(f"{line.instance_folder}_{mask_id}"),
            model=model.model.id,
            material=line.material,
        )
        objects.append(obj)
        frames = [(i, s) for i, s in enumerate(stems) if s in metas]
        label = _fit_label(obj, frames, folder, maps_of, camera, layout)
        if label is not None:
            labels.append(label)
    return FoundObjects(
        tuple(models.values()), tuple(objects), Labels(labels=labels) if labels else None
    )


def _meta_line(words: list[str], path: Path, where: str, any_class: bool) -> MetaLine:
    try:
        long = len(words) >= 6
        if not long and len(words) != 3:
            raise ValueError(f"{len(words)} fields")
        mask_id, class_id = int(words[0]), int(words[1])
        material = int(words[5] if long else words[2])
        scale = float(words[4]) if long else None
    except ValueError as error:
        raise ToolkitError(
            f"a meta line has 13 fields, or 3 in the short form: {error}",
            path=path,
            field=where,
            value=" ".join(words),
        ) from error
    if any_class and class_id not in _CATEGORIES:
        class_id = 0
    lowest = 0 if any_class else 1
    if not lowest <= mask_id <= 254 or class_id not in _CATEGORIES or material not in _MATERIALS:
        raise ToolkitError(
            f"id {lowest}..254, class 0..7, material 0..3",
            path=path,
            field=where,
            value=" ".join(words),
        )
    if scale is not None and not (math.isfinite(scale) and 0.003 < scale < 3):
        raise ToolkitError("implausible scale (metres)", path=path, field=where, value=scale)
    if not long:
        return MetaLine(mask_id, class_id, None, None, None, _MATERIALS[material])
    for name in (words[2], words[3]):
        check_name(name, path=path, field=where)
    return MetaLine(mask_id, class_id, words[2], words[3], scale, _MATERIALS[material])


def _cad_folder(request: ImportRequest, meta_lines: dict[int, MetaLine]) -> Path | None:
    """The folder that contains `<class>/<instance>/model.obj` of every object."""
    if any(x.instance_folder is None for x in meta_lines.values()):
        return None
    source = request.source.resolve()
    places = [request.models] if request.models is not None else []
    for above in (source.parent, source.parent.parent, source.parent.parent.parent):
        top = above / "cad_model"
        if top.is_dir():
            places += [top, *sorted(p for p in top.iterdir() if p.is_dir())]
    for place in places:
        if all(_mesh_path(place, x).is_file() for x in meta_lines.values()):
            return place
    if request.models is not None:
        lost = next(x for x in meta_lines.values() if not _mesh_path(request.models, x).is_file())
        raise ToolkitError("CAD model not found", path=_mesh_path(request.models, lost))
    return None


def _mesh_path(cad: Path, line: MetaLine) -> Path:
    return cad / str(line.class_folder) / str(line.instance_folder) / "model.obj"


def _model(cad: Path, line: MetaLine) -> SourceModel:
    """The mesh at the size of the meta line: centred, with a diagonal of `scale` metres."""
    assert line.scale is not None  # of the long form
    mesh = load_mesh(_mesh_path(cad, line))
    centre, diagonal = nocs_frame(mesh)
    mesh.vertices = (np.asarray(mesh.vertices) - centre) * (line.scale / diagonal)
    model = foreign_files.model_of_mesh(
        mesh,
        model_id=safe_name(f"{line.class_folder}_{line.instance_folder}"),
        category=_CATEGORIES[line.class_id],
        suffix=foreign_files.mesh_suffix(mesh),
    )
    return SourceModel(model=model, mesh=mesh)


def _fit_label(
    obj: Object,
    frames: list[tuple[int, str]],
    folder: Path,
    maps_of: MapsOf,
    camera: Camera,
    layout: str,
) -> Label | None:
    """Pose of an object in some frames, by Umeyama from NOCS to back-projected depth."""
    picks = np.unique(np.linspace(0, len(frames) - 1, _FITTED_FRAMES).round().astype(int))
    poses: dict[int, SE3] = {}
    for pick in picks:
        index, stem = frames[pick]
        pose = fit_pose(dict(maps_of(folder, stem)), obj.id, camera)
        if pose is not None:
            poses[index] = pose
    if not poses:
        return None
    first = min(poses)
    return Label(
        object=obj.id,
        frame=first,
        T_cam_obj=poses[first].flat(),
        method=f"import:{layout}",
        views={str(i): T.flat() for i, T in poses.items() if i != first},
    )


def fit_pose(maps: dict[str, Path], mask_id: int, camera: Camera) -> SE3 | None:
    """T_cam_obj of the object `mask_id`, from its ground-truth depth, mask and NOCS picture.

    The quaternion of the meta file is not used, because its meaning differs between releases.

    Returns:
        None if a map is missing, too little of the object is visible or no fit is found.
    """
    if not {"depth", "mask", "nocs"} <= set(maps):
        return None
    size = image_size(maps["depth"])
    depth = read_foreign_depth(maps["depth"], size=size).values
    mask = foreign_files.read_mask_source(maps["mask"], size=size)
    picture = read_png(maps["nocs"], size=size)
    chosen = (mask == mask_id) & (depth > 0)
    if picture.ndim != 3 or picture.dtype != np.uint8 or chosen.sum() < _FEWEST_PIXELS:
        return None
    nocs = picture[chosen].astype(np.float64) / 255
    nocs[:, 2] = 1 - nocs[:, 2]
    points = unproject_depth(depth, camera.resized(*size))[chosen]
    try:
        fit, inliers = ransac_similarity(nocs - 0.5, points, threshold_m=_INLIER_M)
    except ToolkitError:
        return None
    return SE3(fit.R, fit.t) if inliers.mean() > 0.5 else None
