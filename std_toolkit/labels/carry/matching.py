"""Which objects of two scenes are the same: by their meshes and names."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import mesh_bounds
from std_toolkit.io.documents import digest_file, digest_of
from std_toolkit.labels.carry.options import CarryOptions
from std_toolkit.scene import Label, Object, Scene
from std_toolkit.scene.label_verdicts import label_verdicts
from std_toolkit.scene.model import Model
from std_toolkit.settings import Settings, limit


@dataclass(frozen=True, kw_only=True)
class MatchingSettings(Settings):
    """When two meshes are the same."""

    same_box_mm: float = limit(0.5, unit="mm", source="rounded or decimated copies of one mesh")
    """the boxes of two meshes of one name differ by less, so that they have one frame"""


def refuse_same(scene: Scene, source: Scene) -> None:
    """Raise an error if two scenes are one folder, or one recording: their labels are merged."""
    if scene.root.resolve() == source.root.resolve():
        raise ToolkitError("a scene cannot be carried over to itself", path=scene.root)
    first = [one.color_path(one.frames[0]) for one in (scene, source) if one.frames]
    files = {digest_file(path) for path in first if path.is_file()}
    if len(first) == 2 and len(files) == 1 and all(path.is_file() for path in first):
        raise ToolkitError(
            "the two scenes are one recording",
            path=source.root,
            hint="`std-annotate compare` and `merge` are for labels of several people",
        )


def wanted_objects(
    source: Scene, options: CarryOptions, left_out: list[tuple[str, str]]
) -> list[tuple[Object, Label]]:
    """The labelled objects of the source; a label that is known to be wrong is left out.

    Args:
        source: the scene that poses are carried over from.
        options: names of the objects, if chosen.
        left_out: receives name and reason of each object that is left out.

    Raises:
        ToolkitError: nothing is labelled, or a named object is not.
    """
    labelled = [(o, x) for o in source.objects.objects if (x := source.labels.of(o.id)) is not None]
    if not labelled:
        raise ToolkitError("no object is labelled there", path=source.root)
    if options.objects is not None:
        chosen = {source.objects.object_named(name).name for name in options.objects}
        if missing := sorted(chosen - {o.name for o, _ in labelled}):
            raise ToolkitError("this object has no label there", path=source.root, value=missing[0])
        labelled = [(o, x) for o, x in labelled if o.name in chosen]
    wrong = {v.object for v in label_verdicts(source) if v.grade == "wrong"}
    left_out += [(o.name, "its label there is wrong") for o, _ in labelled if o.id in wrong]
    return [(o, x) for o, x in labelled if o.id not in wrong]


def matched_objects(
    scene: Scene,
    source: Scene,
    wanted: list[tuple[Object, Label]],
    options: CarryOptions,
    left_out: list[tuple[str, str]],
) -> list[tuple[Object, Object | None, Model | None]]:
    """Each object, the same one of this scene, if any, and its model here, if any.

    Objects of one mesh are interchangeable: those without a namesake are paired in their order.

    Raises:
        ToolkitError: the scenes have no mesh in common, and no object is named.
    """
    models = {o.model: same_model(scene, source, source.objects.model(o.model)) for o, _ in wanted}
    if wanted and scene.objects.models and not any(models.values()) and options.objects is None:
        raise ToolkitError(
            "the scenes have no mesh in common",
            path=scene.root,
            value=", ".join(m.id for m in scene.objects.models[:5]),
            hint=f"name the objects to add with --objects ({', '.join(o.name for o, _ in wanted)})",
        )
    table = {o.name: o for o in scene.objects.objects}
    names = {o.name for o, _ in wanted}
    free = [o for o in scene.objects.objects if o.name not in names]
    found: list[tuple[Object, Object | None, Model | None]] = []
    for theirs, _ in wanted:
        model, namesake = models[theirs.model], table.get(theirs.name)
        if namesake is not None and (model is None or namesake.model != model.id):
            left_out.append((theirs.name, f"it has another mesh here ({namesake.model})"))
            continue
        if namesake is None and model is not None:
            namesake = next((o for o in free if o.model == model.id), None)
            free = [o for o in free if o is not namesake]
        found.append((theirs, namesake, model))
    return found


def is_kept(
    obj: Object,
    placed: Collection[str],
    options: CarryOptions,
    left_out: list[tuple[str, str]],
    locked: Collection[str] = (),
) -> bool:
    """Whether an object keeps the pose that it has; it is added to `left_out` then."""
    if obj.name not in locked and (obj.name not in placed or options.overwrite):
        return False
    why = "it is locked" if obj.name in locked else "it has a pose here already"
    left_out.append((obj.name, why))
    return True


def same_model(scene: Scene, source: Scene, model: Model) -> Model | None:
    """The model of this scene with the name and box of another, or with its files; None without."""
    namesake = next((m for m in scene.objects.models if m.id == model.id), None)
    if namesake is not None:
        limit_mm = MatchingSettings.current().same_box_mm
        boxes = [mesh_bounds(one.mesh(model.id)) for one in (scene, source)]
        if 1000 * np.abs(boxes[0] - boxes[1]).max() < limit_mm:
            return namesake
    wanted = _content(source, model)
    return next((m for m in scene.objects.models if _content(scene, m) == wanted), None)


def _content(scene: Scene, model: Model) -> str:
    """Digest of the mesh with its materials and textures, which are in its folder."""
    path = scene.mesh_path(model)
    files = [path]
    if path.parent.name == model.id:
        files = [p for p in path.parent.iterdir() if p.is_file() and not p.name.startswith(".")]
    return digest_of(sorted(digest_file(p) for p in files if p.is_file()))
