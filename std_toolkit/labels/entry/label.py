"""Adding objects and annotated poses to a scene, for the command line and the GUI."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain, count
from pathlib import Path
from typing import get_args

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import load_mesh, mesh_bounds, mesh_diameter
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.entry.mesh_copies import plan_mesh_copy, write_mesh_copy
from std_toolkit.scene.document import check_in_front, check_name, safe_name
from std_toolkit.scene.model import (
    CATEGORY_CLASS_IDS,
    Label,
    LabelProvenance,
    Material,
    Model,
    Object,
    ObjectTable,
    Pose16,
    SymmetryModel,
    without_derived,
)
from std_toolkit.scene.scene import Scene

MATERIALS: tuple[str, ...] = get_args(Material)


def add_model(
    scene: Scene,
    mesh: Path | str,
    *,
    mesh_unit: str = "m",
    category: str | None = None,
    symmetry: SymmetryModel | None = None,
    model_id: str | None = None,
) -> Model:
    """Copy a mesh with its textures into the scene and add it to objects.json.

    The caller holds the scene's lock. Arguments and errors are those of `copy_model`.
    """
    model = copy_model(
        scene.root,
        scene.objects,
        mesh,
        mesh_unit=mesh_unit,
        category=category,
        symmetry=symmetry,
        model_id=model_id,
    )
    models = [m for m in scene.objects.models if m.id != model.id]
    scene.save_objects(
        ObjectTable(
            models=sorted([*models, model], key=lambda m: m.id), objects=scene.objects.objects
        )
    )
    return model


def copy_model(
    root: Path,
    objects: ObjectTable,
    mesh: Path | str,
    *,
    mesh_unit: str = "m",
    category: str | None = None,
    symmetry: SymmetryModel | None = None,
    model_id: str | None = None,
    number: bool = False,
    faces: int | None = None,
) -> Model:
    """Copy a mesh with its textures into a scene folder; objects.json is not changed.

    The caller holds the scene's lock.

    Args:
        root: the scene folder.
        objects: existing models of the scene.
        mesh: file to copy to `models/<id>/`; stored in metres.
        mesh_unit: unit of the file: "m", "cm" or "mm".
        category: category such as "mug"; default: that of the existing model, else "other".
        symmetry: symmetry in the mesh frame, metres; default: that of the existing model, else
            none.
        model_id: id of the model; default: from the file name.
        number: if another mesh already has this id, use the next of `mug_2`, `mug_3`, ... that is
            free or belongs to this mesh.
        faces: decimate a mesh of more faces to this number; see `plan_mesh_copy`.

    Returns:
        The model, with its size and diameter. An existing model with this id and mesh is returned
        unchanged, except for a given category and symmetry.

    Raises:
        ToolkitError: an unreadable mesh, one of implausible size (a wrong unit), or a model of
            this id with another mesh.
    """
    source = Path(mesh)
    model_id = check_name(model_id or safe_name(source.stem), field="model")
    if category is not None:
        check_name(category, field="category")
    files = plan_mesh_copy(source, unit=mesh_unit, faces=faces)
    if number:
        model_id = _free_id(root, objects, model_id, files)
    relative = f"models/{model_id}/{next(iter(files))}"
    known = next((m for m in objects.models if m.id == model_id), None)
    if known is not None and not _same_mesh(root, known, relative, files):
        raise ToolkitError(
            "a model with this id has another mesh",
            path=source,
            value=model_id,
            hint="choose another id, such as --model mug_2",
        )
    path = write_mesh_copy(root / "models" / model_id, files)
    loaded = load_mesh(path)
    low, high = mesh_bounds(loaded)
    class_id = CATEGORY_CLASS_IDS.get(category or "other", 0)
    if category is None and known is not None:
        category, class_id = known.category, known.class_id
    return Model(
        id=model_id,
        mesh=relative,
        category=category or "other",
        class_id=class_id,
        # A flat mesh (a printed sheet) has an extent of zero; the document requires a size.
        size_m=[float(max(x, 1e-9)) for x in high - low],
        diameter_m=mesh_diameter(loaded),
        symmetry=symmetry or (known.symmetry if known is not None else SymmetryModel()),
    )


def add_object(
    scene: Scene,
    name: str,
    *,
    model: str,
    material: str = "diffuse",
    object_id: int | None = None,
) -> Object:
    """Add a physical object to objects.json, or change the material of an existing one.

    The caller holds the scene's lock.

    Args:
        name: name, unique in the scene.
        model: id of a model of the scene.
        material: "raw", "diffuse", "specular" or "transparent"; selects the evidence for
            refinement.
        object_id: 1..254; default: the smallest free one.

    Raises:
        ToolkitError: unknown model or material, or an object with this name has another model.
    """
    check_name(name, field="object")
    scene.objects.model(model)
    if material not in MATERIALS:
        raise ToolkitError(
            "unknown material", value=material, hint=f"one of {', '.join(MATERIALS)}"
        )
    table = scene.objects.objects
    known = next((o for o in table if o.name == name), None)
    if known is not None and known.model != model:
        raise ToolkitError(
            f"this object has model {known.model}",
            field="object",
            value=name,
            hint="choose another name",
        )
    taken = {o.id for o in table}
    number = known.id if known is not None else object_id
    if number is None:
        number = next((i for i in range(1, 255) if i not in taken), None)
    if number is None or not 1 <= number <= 254 or (known is None and number in taken):
        raise ToolkitError(
            "no such free object id", field="object_id", value=number, hint="ids are 1 to 254"
        )
    obj = Object(id=number, name=name, model=model, material=material)  # type: ignore[arg-type]
    others = [o for o in table if o.id != number]
    scene.save_objects(
        ObjectTable(models=scene.objects.models, objects=sorted([*others, obj], key=lambda o: o.id))
    )
    return obj


def set_pose(
    scene: Scene,
    object_name: str,
    frame: int,
    T_cam_obj: SE3,
    *,
    method: str = "file",
    annotator: str = "",
    as_view: bool = False,
) -> Label:
    """Annotate an object's pose in one frame.

    Results of an earlier annotation (world pose, refinement, covariance) are removed: propagate
    again. An identical annotation changes nothing. The caller holds the scene's lock.

    Args:
        object_name: name of an object of the scene.
        frame: id of the annotated frame; it need not be registered (yet).
        T_cam_obj: mesh frame to that frame's camera, metres.
        method: source of the pose: "file", "pnp", "import:bop", "gui".
        annotator: name of the annotator.
        as_view: keep the label's frame and add this one as another annotated view. Otherwise the
            annotation replaces all earlier ones of the object.

    Raises:
        ToolkitError: unknown object or frame, or a pose behind the camera or out of reach.
    """
    target = scene.objects.object_named(object_name)
    scene.frame(frame)
    check_in_front(T_cam_obj)
    old = scene.labels.of(target.id)
    poses = {frame: T_cam_obj.flat()}
    if as_view and old is not None:
        poses = {old.frame: old.T_cam_obj, **{int(k): T for k, T in old.views.items()}, **poses}
    if as_view and old is not None and old.frame != frame:
        label = annotated_label(
            target.id,
            poses,
            frame=old.frame,
            method=old.method,
            annotator=old.annotator,
            provenance=old.provenance,
        )
    else:
        label = annotated_label(target.id, poses, frame=frame, method=method, annotator=annotator)
    if old is not None and label == without_derived(old):
        return old
    scene.save_labels(scene.labels.with_label(label))
    return label


def annotated_label(
    object_id: int,
    poses: Mapping[int, Pose16],
    *,
    frame: int,
    method: str,
    annotator: str = "",
    provenance: LabelProvenance | msgspec.UnsetType = msgspec.UNSET,
) -> Label:
    """A new label from annotations, without derived results.

    Args:
        poses: T_cam_obj by frame id, 16 numbers each.
        frame: frame of the label; the others become its views.
    """
    return Label(
        object=object_id,
        frame=frame,
        T_cam_obj=poses[frame],
        method=method,
        annotator=annotator,
        views={str(f): poses[f] for f in sorted(poses) if f != frame},
        provenance=provenance,
    )


def _free_id(root: Path, objects: ObjectTable, wanted: str, files: dict[str, bytes]) -> str:
    """`wanted`, with a number if this is a model with another mesh."""
    table = {m.id: m for m in objects.models}
    for i in chain([wanted], (f"{wanted}_{k}" for k in count(2))):
        if i not in table or _same_mesh(root, table[i], f"models/{i}/{next(iter(files))}", files):
            return i
    raise AssertionError("numbers do not end")


def _same_mesh(root: Path, known: Model, relative: str, files: dict[str, bytes]) -> bool:
    if known.mesh != relative:
        return False
    path = root / relative
    return path.is_file() and path.read_bytes() == next(iter(files.values()))
