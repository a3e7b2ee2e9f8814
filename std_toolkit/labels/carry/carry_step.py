"""Poses of objects carried over from a scene of the same table and objects.

The two worlds are related by what both scenes show (`ways`), and the objects by their meshes and
names. A carried pose is a label like one that was set by hand: nothing is known of it until it is
judged in its own scene.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import mesh_bounds
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.io.documents import utc_text
from std_toolkit.labels.carry.matching import (
    is_kept,
    matched_objects,
    refuse_same,
    wanted_objects,
)
from std_toolkit.labels.carry.options import CarryOptions
from std_toolkit.labels.carry.shared_features import Progress
from std_toolkit.labels.carry.ways import find_relation
from std_toolkit.labels.carry.world_relation import RelationSettings, WorldRelation
from std_toolkit.labels.entry.label import annotated_label, copy_model
from std_toolkit.labels.propagate import place_label
from std_toolkit.scene import Label, LabelProvenance, Object, ObjectTable, Scene
from std_toolkit.scene.document import check_in_front
from std_toolkit.scene.frame_names import frame_title
from std_toolkit.scene.model import Model, pose_from_list
from std_toolkit.scene.scene import require_metres


@dataclass(frozen=True, eq=False)
class CarriedObject:
    """An object with its pose in the scene that it was carried to.

    Attributes:
        source: the object in the scene that the pose is from.
        known: the same object in this scene; None: it is to be added.
        model: its model in this scene; None: it is to be copied.
        frame: id of the frame that sees it best.
        T_cam_obj: pose in this frame, metres.
        deviation_mm: standard deviation of its place that follows from how the scenes are related.
    """

    source: Object
    known: Object | None
    model: Model | None
    frame: int
    T_cam_obj: SE3
    deviation_mm: float

    @property
    def name(self) -> str:
        """Name in this scene."""
        return self.source.name if self.known is None else self.known.name


@dataclass(frozen=True, eq=False)
class CarryPlan:
    """What is carried over from one scene to another.

    Attributes:
        source: the scene that the poses are from.
        relation: how the worlds lie to each other.
        objects: with their poses.
        left_out: name and reason of each of the others.
    """

    source: Scene
    relation: WorldRelation
    objects: tuple[CarriedObject, ...]
    left_out: tuple[tuple[str, str], ...]

    @property
    def method(self) -> str:
        """Method of the labels."""
        return f"carry:{self.relation.by}"

    @property
    def provenance(self) -> str:
        """Sentence on where the poses are from."""
        return f"carried over from {self.source.info.name} {self.relation.sentence()}"

    def notes(self) -> list[str]:
        """Sentences on what to know: of the relation, and each object that was left out."""
        return [*self.relation.notes, *(f"{name}: {why}" for name, why in self.left_out)]

    def copied(self, item: CarriedObject, root: Path, table: ObjectTable) -> Model:
        """The model of an object in this scene; its files are copied if it has none yet.

        Args:
            root: folder of this scene.
            table: its models, including those that were copied before.
        """
        if item.model is not None:
            return item.model
        theirs = self.source.objects.model(item.source.model)
        return copy_model(
            root,
            table,
            self.source.mesh_path(theirs),
            category=theirs.category,
            symmetry=theirs.symmetry,
            model_id=theirs.id,
            number=True,
        )


def carry_labels(
    scene: Scene, source: Scene, options: CarryOptions | None = None, *, annotator: str = ""
) -> CarryPlan:
    """Carry poses over and write them as labels, with missing objects and meshes.

    The labels have no `T_world_obj` and no judgement: propagate and check them. Objects that are
    marked as done are open again.

    Args:
        scene: receives the labels.
        source: the scene that they are from.
        options: the way, and what is carried over.
        annotator: name of who carries them over.

    Raises:
        ToolkitError: see `plan_carry`; nothing has changed then.
    """
    with scene.lock():
        sweep_temporaries(scene.root)
        placed = {scene.objects.object(x.object).name for x in scene.labels.labels}
        ids = {x.object for x in scene.annotation.objects if x.locked}
        locked = {o.name for o in scene.objects.objects if o.id in ids}
        plan = plan_carry(scene, source, options, placed=placed, locked=locked)
        labels, annotation = scene.labels, scene.annotation
        table = scene.objects
        carried: list[Label] = []
        for item in plan.objects:
            model = plan.copied(item, scene.root, table)
            models = [*(m for m in table.models if m.id != model.id), model]
            objects, obj = list(table.objects), item.known
            if obj is None:
                obj = msgspec.structs.replace(
                    item.source, id=free_id(item.source.id, objects), model=model.id
                )
                objects.append(obj)
            table = ObjectTable(
                models=sorted(models, key=lambda m: m.id),
                objects=sorted(objects, key=lambda o: o.id),
            )
            label = annotated_label(
                obj.id,
                {item.frame: item.T_cam_obj.flat()},
                frame=item.frame,
                method=plan.method,
                annotator=annotator,
                provenance=LabelProvenance(
                    time=utc_text(),
                    tool="std-curate",
                    version=__version__,
                    refinement=plan.provenance,
                ),
            )
            carried.append(label)
        if table != scene.objects:
            scene.save_objects(table)
        for label in carried:
            labels = labels.with_label(label)
        scene.save_labels(labels)
        moved = {x.object for x in carried}
        rows = [
            msgspec.structs.replace(row, status="open", judgement=msgspec.UNSET)
            if row.object in moved
            else row
            for row in annotation.objects
        ]
        if rows != annotation.objects:
            scene.save_annotation(msgspec.structs.replace(annotation, objects=rows))
    return plan


def free_id(wanted: int, objects: Collection[Object]) -> int:
    """The id if no object has it, else the smallest free one.

    Raises:
        ToolkitError: all 254 are taken.
    """
    taken = {o.id for o in objects}
    found = next((i for i in (wanted, *range(1, 255)) if i not in taken), None)
    if found is None:
        raise ToolkitError("no object id is free", hint="a scene holds 254 objects at most")
    return found


def plan_carry(
    scene: Scene,
    source: Scene,
    options: CarryOptions | None = None,
    *,
    placed: Collection[str],
    locked: Collection[str] = (),
    progress: Progress = lambda _: None,
    check: Callable[[], None] = lambda: None,
) -> CarryPlan:
    """Relate two scenes, and place the objects of one in the other; writes nothing.

    Args:
        scene: the scene to carry to; its labels are not read.
        source: the scene to carry from.
        options: the way, and what is carried over.
        placed: names of the objects that have a pose in `scene`.
        locked: names of those in `scene` that keep what they have.
        progress: called with the completed fraction, 0 to 1.
        check: called often; raises an error to stop.

    Raises:
        ToolkitError: the scenes are one recording, a scene lacks metric camera poses or labels, no
            object is common to both, the worlds cannot be related, or no object would be in view.
    """
    options = options or CarryOptions()
    refuse_same(scene, source)
    for one in (source, scene):
        if one.poses is None or not one.registered_frames():
            raise ToolkitError(
                "the scene has no camera poses", path=one.root, hint="run `std-curate poses` first"
            )
        require_metres(one)
    left_out: list[tuple[str, str]] = []
    wanted = wanted_objects(source, options, left_out)
    matched = [
        (theirs, known, model)
        for theirs, known, model in matched_objects(scene, source, wanted, options, left_out)
        if not is_kept(theirs if known is None else known, placed, options, left_out, locked)
    ]
    if not matched:
        raise ToolkitError(
            "there is nothing to carry over: " + "; ".join(f"{n}: {why}" for n, why in left_out),
            path=scene.root,
            hint="poses that are here are replaced with --overwrite",
        )
    relation = find_relation(source, scene, options, progress=progress, check=check)
    objects = []
    for theirs, known, model in matched:
        item = _carried(scene, source, relation, theirs, known, model)
        if item is None:
            left_out.append((theirs.name, "it would be in view of no frame"))
        else:
            objects.append(item)
    if not objects:
        raise ToolkitError(
            "no object would be in view of a frame: the scenes show other places, or are related "
            f"wrongly ({relation.sentence()})",
            path=scene.root,
            hint="give three points (--points)",
        )
    return CarryPlan(source, relation, tuple(objects), tuple(left_out))


def _carried(
    scene: Scene,
    source: Scene,
    relation: WorldRelation,
    theirs: Object,
    known: Object | None,
    model: Model | None,
) -> CarriedObject | None:
    """The object in the frame that sees it nearest to the middle; None if none does."""
    T_world_obj = source.T_world_obj(theirs.id)
    if T_world_obj is None:
        label = source.labels.of(theirs.id)
        assert label is not None
        placed = place_label(source, label)
        if placed.T_world_obj is None:
            raise ToolkitError(
                "none of its annotated frames has a camera pose",
                path=source.root,
                value=theirs.name,
            )
        T_world_obj = pose_from_list(placed.T_world_obj)
    T_world_obj = relation.T_b_a @ T_world_obj
    centre = mesh_bounds(source.mesh(theirs.model)).mean(axis=0)
    deviation = relation.deviation_mm(T_world_obj @ centre)
    most = RelationSettings.current().largest_deviation_mm
    if deviation > most:
        raise ToolkitError(
            f"the place of {theirs.name} follows to ± {deviation:.0f} mm only "
            f"({relation.sentence()}), at most {most:g} mm",
            path=scene.root,
            hint="the points are few or lie too near to each other: give points around the objects",
        )
    best: tuple[float, int, SE3] | None = None
    for frame in scene.registered_frames():
        T_world_cam = scene.T_world_cam(frame.id)
        assert T_world_cam is not None
        T_cam_obj = T_world_cam.inverse() @ T_world_obj
        off = _off_centre(scene, frame.id, T_cam_obj, T_cam_obj @ centre)
        if off is not None and (best is None or off < best[0]):
            best = off, frame.id, T_cam_obj
    if best is None:
        return None
    return CarriedObject(theirs, known, model, best[1], best[2], deviation)


def _off_centre(
    scene: Scene, frame: int, T_cam_obj: SE3, point: NDArray[np.float64]
) -> float | None:
    """Distance of a point from the middle of the image, in parts of its half diagonal."""
    camera = scene.camera(scene.frame(frame))
    try:
        check_in_front(T_cam_obj)
    except ToolkitError:
        return None
    if point[2] <= 0:
        return None
    u, v = camera.project(point[None])[0]
    if not (-0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5):
        return None
    return float(np.hypot(u - camera.width / 2, v - camera.height / 2) / np.hypot(*camera.size))


def carry_lines(plan: CarryPlan, scene: Scene) -> list[str]:
    """Lines of text on what was carried over."""
    lines = [plan.provenance]
    for item in plan.objects:
        added = "" if item.known is not None else ", added"
        title = frame_title(scene.frame(item.frame))
        lines.append(f"{item.name}: {title}, ± {item.deviation_mm:.1f} mm{added}")
    return [*lines, *(f"note: {note}" for note in plan.notes())]
