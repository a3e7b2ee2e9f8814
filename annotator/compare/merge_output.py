"""Output of a merge as a new scene folder, or as labels in an existing scene."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import msgspec

from annotator.compare.merge_labels import Merge
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import new_folder, sweep_temporaries
from std_toolkit.io.documents import digest_file
from std_toolkit.labels.agreement.annotated_scene import same_shape
from std_toolkit.labels.entry.mesh_copies import plan_mesh_copy, write_mesh_copy
from std_toolkit.project.shared import recording_files
from std_toolkit.scene import Annotation, Labels, ObjectAnnotation, ObjectTable, Scene


def write_scene(merge: Merge, out: Path) -> Scene:
    """Create a new scene with the recording, the camera poses and the merged labels.

    All files are copied, so the folders are independent. The folder appears atomically when it is
    complete.

    Raises:
        ToolkitError: `out` exists, or a file is missing or cannot be written.
    """
    for annotated in merge.annotators:
        if out.resolve().is_relative_to(annotated.scene.root.resolve()):
            raise ToolkitError(
                "the merged scene cannot be inside another scene", path=out, field="--out"
            )
    source = merge.target.scene
    with new_folder(out) as staging:
        for name in recording_files(source):
            _copy(source.root / name, staging / name)
        scene = Scene.create(staging, source.info, source.frame_table, _table(merge, staging))
        if source.poses is not None:
            scene.save_poses(source.poses)
        _save(scene, merge)
        checked = Scene.open(staging)
        _ = checked.labels, checked.annotation
    return Scene.open(out)


def write_into(merge: Merge, *, overwrite: bool = False) -> Scene:
    """Write the merged labels into the target scene, under its lock.

    Raises:
        ToolkitError: the target is one of the merged scenes, has labels and `overwrite` is not set,
            has changed since the merge, or is locked.
    """
    scene = merge.target.scene
    check_target(scene.root, [a.scene.root for a in merge.annotators])
    before = (scene.objects, scene.poses, scene.labels)
    with scene.lock():
        sweep_temporaries(scene.root)
        if (scene.objects, scene.poses, scene.labels) != before:
            raise ToolkitError(
                "the scene was changed meanwhile", path=scene.root, hint="merge again"
            )
        if scene.labels.labels and not overwrite:
            raise ToolkitError(
                "the scene has labels already",
                path=scene.root,
                hint="--overwrite replaces them all, or choose another scene",
            )
        worked = scene.annotation
        scene.save_objects(_table(merge, scene.root))
        _save(scene, merge, worked=worked)
    return scene


def check_target(target: Path, annotators: Sequence[Path]) -> None:
    """Check that the target is not the scene of an annotator.

    Raises:
        ToolkitError: the target is one of them.
    """
    if target.resolve() in [path.resolve() for path in annotators]:
        raise ToolkitError(
            "the merged labels cannot replace those of one of the annotators",
            path=target,
            field="--into",
            hint="give another scene of the recording, or --out for a new one",
        )


def _save(scene: Scene, merge: Merge, *, worked: Annotation | None = None) -> None:
    labels = [x.label for x in merge.objects if x.label is not None]
    scene.save_labels(Labels(labels=sorted(labels, key=lambda x: x.object)))
    scene.save_annotation(_joined(merge.annotation(), worked or Annotation()))


def _joined(merged: Annotation, worked: Annotation) -> Annotation:
    """Combine the merged annotation with the clicks and notes that the scene already had."""
    rows = {row.object: row for row in merged.objects}
    for old in worked.objects:
        row = rows.get(old.object, ObjectAnnotation(object=old.object))
        notes = [row.note] if old.note in row.note else [old.note, *filter(None, [row.note])]
        rows[old.object] = msgspec.structs.replace(row, clicks=old.clicks, note="; ".join(notes))
    return Annotation(objects=[rows[i] for i in sorted(rows)])


def _table(merge: Merge, root: Path) -> ObjectTable:
    """Return objects.json of the merge; copies meshes that the target lacks to `root`."""
    scene = merge.target.scene
    models = {m.id: m for m in scene.objects.models}
    objects = {o.id: o for o in scene.objects.objects}
    # Source scene of the mesh of each model id.
    sources = {m.id: (scene, m) for m in scene.objects.models}
    for merged in merge.objects:
        if merged.object.id in objects:
            continue
        x = merged.labelled[0]
        source, model_id = x.owner.scene, x.model.id
        while model_id in sources and not same_shape(*sources[model_id], source, x.model):
            model_id = f"{model_id}_{x.owner.name}"
        if model_id not in sources:
            files = plan_mesh_copy(source.mesh_path(x.model), unit="m")
            path = write_mesh_copy(root / "models" / model_id, files)
            mesh = path.relative_to(root).as_posix()
            models[model_id] = msgspec.structs.replace(x.model, id=model_id, mesh=mesh)
            sources[model_id] = (source, x.model)
        objects[merged.object.id] = msgspec.structs.replace(merged.object, model=model_id)
    return ObjectTable(
        models=sorted(models.values(), key=lambda m: m.id),
        objects=sorted(objects.values(), key=lambda o: o.id),
    )


def _copy(source: Path, target: Path) -> None:
    digest_file(source)  # raises an error with the path if it is not a readable regular file
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
    with target.open("rb") as file:
        os.fsync(file.fileno())
