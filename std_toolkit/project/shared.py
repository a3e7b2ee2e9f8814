"""What the scenes of a project share: meshes with symmetries and materials, and recordings.

The library is a folder with an objects.json as in a scene: `models` has the meshes with their
symmetries, `objects` one row for each material in which a mesh was seen.
"""

from __future__ import annotations

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.frame_files import place_file
from std_toolkit.io.atomic import new_folder, write_bytes_atomic
from std_toolkit.io.documents import digest_file, read_document, write_document
from std_toolkit.io.locks import lock_holder
from std_toolkit.jobs.artefact import record_path
from std_toolkit.labels.entry.label import copy_model
from std_toolkit.project.record import Project, ProjectScene
from std_toolkit.scene.model import Labels, Model, Object, ObjectTable
from std_toolkit.scene.scene import Scene

TABLE = "objects.json"

# Folders of recording and reconstruction, beside images and meshes.
_FOLDERS = ("reference", "poses")
_BOARD = "board.json"


def recording_files(scene: Scene) -> list[str]:
    """The scene-relative paths of the files of the unlabelled scene, without its documents."""
    names = [f.color for f in scene.frames]
    names += [f.depth for f in scene.frames if f.depth is not None]
    for model in scene.objects.models:
        folder = scene.mesh_path(model).parent
        # Materials and textures are in the folder of the mesh.
        beside = sorted(folder.iterdir()) if folder.parent.name == "models" else []
        files = [p for p in beside if p.is_file() and not p.name.startswith(".")]
        names += [p.relative_to(scene.root).as_posix() for p in files] or [model.mesh]
    for folder_name in _FOLDERS:
        found = sorted(p for p in (scene.root / folder_name).rglob("*") if p.is_file())
        names += [p.relative_to(scene.root).as_posix() for p in found]
    # With its record, the pose step detects that the poses are up to date.
    for path in (scene.root / _BOARD, record_path(scene.root, "poses")):
        if path.is_file():
            names.append(path.relative_to(scene.root).as_posix())
    return list(dict.fromkeys(names))


def make_second(project: Project, item: ProjectScene) -> Scene:
    """Make the copy of a scene that another person labels without seeing the first labels.

    It has recording, camera poses, meshes and the list of objects, and neither labels nor anything
    that was made of them or imported beside them. Images and meshes are hard links where the file
    system allows it. The folder appears when it is complete.

    Raises:
        ToolkitError: the folder exists, or a file is missing or cannot be written.
    """
    source = Scene.open(project.folder(item))
    with new_folder(project.second(item)) as staging:
        for name in recording_files(source):
            if not name.startswith("reference/"):
                digest_file(source.root / name)  # an error with the path if it cannot be read
                place_file(source.root / name, staging / name, "hard")
        scene = Scene.create(staging, source.info, source.frame_table, source.objects)
        if source.poses is not None:
            scene.save_poses(source.poses)
        scene.save_labels(Labels())
    return Scene.open(project.second(item))


def read_library(project: Project) -> ObjectTable:
    """The meshes of the library; empty before any.

    Raises:
        ToolkitError: its objects.json is damaged.
    """
    path = project.root / project.record.library / TABLE
    return read_document(path, ObjectTable) if path.is_file() else ObjectTable()


def share_meshes(project: Project) -> list[str]:
    """Collect the meshes of all scenes in the library, and give scenes without labels all of them.

    A scene that somebody annotates is given nothing yet.

    Returns:
        A sentence for each model that differs from that of the same name in the library, and for
        each scene or mesh that could not be read or written.

    Raises:
        ToolkitError: the library cannot be read or written.
    """
    told: list[str] = []
    with project.locked():
        table = library = read_library(project)
        for item in project.record.scenes:
            try:
                scene = Scene.open(project.folder(item))
            except ToolkitError as error:
                told.append(f"{item.name}: {error}")
                continue
            table, differing = _collected(project, scene, table)
            told += [f"{item.name}: {line}" for line in differing]
        if table != library:
            write_document(project.root / project.record.library / TABLE, table)
        for item in project.record.scenes:
            try:
                _give(project, item, table)
            except ToolkitError as error:
                told.append(f"{item.name}: {error}")
    return list(dict.fromkeys(told))


def _collected(project: Project, scene: Scene, table: ObjectTable) -> tuple[ObjectTable, list[str]]:
    """The library with the models of a scene, whose files are written, and what differs."""
    told = []
    models = {m.id: m for m in table.models}
    objects = list(table.objects)
    root = project.root / project.record.library
    for model in scene.objects.models:
        known = models.get(model.id)
        if known is None:
            try:
                models[model.id] = copy_model(
                    root,
                    ObjectTable(),
                    scene.mesh_path(model),
                    category=model.category,
                    symmetry=model.symmetry,
                    model_id=model.id,
                )
            except ToolkitError as error:
                told.append(str(error))
                continue
        elif differs := _difference(model, known):
            told.append(f"{model.id} has another {differs} than in the library")
    seen = {(o.model, o.material) for o in objects}
    for item in scene.objects.objects:
        if item.model in models and (item.model, item.material) not in seen and len(seen) < 254:
            seen.add((item.model, item.material))
            first = all(o.model != item.model for o in objects)
            name = item.model if first else f"{item.model}_{item.material}"
            objects.append(
                Object(id=len(objects) + 1, name=name, model=item.model, material=item.material)
            )
    return ObjectTable(models=sorted(models.values(), key=lambda m: m.id), objects=objects), told


def _difference(model: Model, known: Model) -> str:
    same = {
        "size": all(abs(a - b) < 1e-4 for a, b in zip(model.size_m, known.size_m, strict=True)),
        "symmetry": model.symmetry == known.symmetry,
        "category": model.category == known.category,
    }
    return " and ".join(name for name, equal in same.items() if not equal)


def _give(project: Project, item: ProjectScene, table: ObjectTable) -> None:
    """Add the models of the library to a scene that nobody labelled."""
    scene = Scene.open(project.folder(item))
    missing = [m for m in table.models if m.id not in {x.id for x in scene.objects.models}]
    if not missing or scene.labels.labels or lock_holder(scene.root, "annotate.lock"):
        return
    with scene.lock():
        if scene.labels.labels:  # in the meantime
            return
        for model in missing:
            folder = (project.root / project.record.library / model.mesh).parent
            for file in sorted(p for p in folder.iterdir() if p.is_file()):
                target = scene.root / "models" / model.id / file.name
                write_bytes_atomic(target, file.read_bytes())
        models = sorted([*scene.objects.models, *missing], key=lambda m: m.id)
        scene.save_objects(ObjectTable(models=models, objects=scene.objects.objects))
