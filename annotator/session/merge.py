"""Documents of a scene that an annotation reads and writes, and their three-way merge.

The three versions are the scene when we last read or wrote it (base), our state (mine), and the
current scene (theirs). A change of one side is taken from that side. Different changes of both are
a conflict, which the user resolves for one side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import numpy as np

from annotator.session.state import AnnotationState, Cameras, Click, ObjectState, Placement
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.labels.propagate import place_label
from std_toolkit.scene import (
    Annotation,
    Label,
    LabelProvenance,
    Labels,
    ObjectAnnotation,
    ObjectTable,
    Scene,
)
from std_toolkit.scene.document import Document
from std_toolkit.scene.model import annotated_views, pose_from_list, without_derived

Side = Literal["mine", "theirs"]

# Poses whose numbers differ by no more are equal.
_SAME = 1e-9


@dataclass(frozen=True)
class Version:
    """A scene's documents and the corresponding state."""

    stored: Stored
    state: AnnotationState


@dataclass(frozen=True)
class Merged:
    """Merged state of both sides.

    Attributes:
        conflicts: text on each conflict, resolved for one side.
        taken: names of the objects and models taken from the others.
    """

    state: AnnotationState
    conflicts: tuple[str, ...]
    taken: tuple[str, ...]


def content(obj: ObjectState | None) -> dict[str, Any]:
    """Return the saved content of an object, in the parts that are merged separately."""
    if obj is None:
        return {"object": None, "pose": {}, "work": ("open", "", False, {}, msgspec.UNSET)}
    return {
        "object": (obj.name, obj.model, obj.material),
        "pose": {f: p.T_cam_obj for f, p in obj.placements.items()},
        "work": (obj.status, obj.note, obj.locked, obj.clicks, obj.judgement),
    }


def differ(a: AnnotationState, b: AnnotationState) -> bool:
    """Whether saving the two states gives different scenes."""
    if a is b:
        return False
    one, other = _by_id(a), _by_id(b)
    return (
        a.models != b.models
        or one.keys() != other.keys()
        or any(one[i] is not other[i] and content(one[i]) != content(other[i]) for i in one)
    )


def merge(base: Version, mine: AnnotationState, theirs: Version, *, prefer: Side) -> Merged:
    """Merge our state with the changes of the others; conflicts are resolved for `prefer`."""
    if theirs.stored == base.stored and theirs.state == base.state:
        return Merged(mine, (), ())
    old, own, new = _by_id(base.state), _by_id(mine), _by_id(theirs.state)
    objects, conflicts, taken = [], [], []
    for i in sorted({*old, *own, *new}):
        rewritten = _rows(base.stored, i) != _rows(theirs.stored, i)
        obj, clash, took = _merged_object(old.get(i), own.get(i), new.get(i), rewritten, prefer)
        if obj is not None:
            objects.append(obj)
        known = own.get(i) or new.get(i) or old.get(i)
        assert known is not None
        conflicts += [known.name] if clash else []
        taken += [known.name] if took else []
    models, clashes, news = _merged_models(base.state, mine, theirs.state, prefer)
    used = {o.model for o in objects}
    for model in (*mine.models, *theirs.state.models):
        if model.id in used - set(models):
            models[model.id] = model
    repeated = {o.name for o in objects if sum(p.name == o.name for p in objects) > 1}
    if repeated:
        raise ToolkitError(
            "another process added an object of the same name",
            field="object",
            value=sorted(repeated)[0],
            hint="rename yours, then save",
        )
    state = AnnotationState(models=[models[k] for k in sorted(models)], objects=objects)
    return Merged(
        state, (*conflicts, *(f"mesh {m}" for m in clashes)), (*taken, *(f"mesh {m}" for m in news))
    )


def _merged_object(
    old: ObjectState | None,
    own: ObjectState | None,
    new: ObjectState | None,
    rewritten: bool,
    prefer: Side,
) -> tuple[ObjectState | None, bool, bool]:
    """Return the object, whether it is a conflict, and whether any change of theirs was taken.

    Args:
        rewritten: whether the others changed more than data derived from its annotation. An edit
            replaces a pose that was only propagated meanwhile.
    """
    before, ours, others = content(old), content(own), content(new)
    if ours in (before, others):
        return new, False, ours != others
    if not rewritten:
        return own, False, False
    if own is None or new is None:
        # Removed by one side. If it looks partly removed on both sides, our own removal was
        # interrupted while saving.
        cut_off = own is None and all(others[p] in (before[p], ours[p]) for p in before)
        return (own if cut_off or prefer == "mine" else new), not cut_off, False
    sides: dict[str, ObjectState] = {}
    clash = False
    for part in before:
        if ours[part] in (before[part], others[part]):
            sides[part] = new
        elif others[part] == before[part]:
            sides[part] = own
        else:
            clash = True
            sides[part] = own if prefer == "mine" else new
    pose, work = sides["pose"], sides["work"]
    obj = msgspec.structs.replace(
        sides["object"],
        placements=pose.placements,
        status=work.status if pose.placements else "open",
        note=work.note,
        locked=work.locked,
        judgement=work.judgement,
        judged_frame=work.judged_frame,
        clicks=work.clicks,
    )
    return obj, clash, any(side is new for side in sides.values())


def _merged_models(
    base: AnnotationState, mine: AnnotationState, theirs: AnnotationState, prefer: Side
) -> tuple[dict[str, Any], list[str], list[str]]:
    old, own, new = ({m.id: m for m in s.models} for s in (base, mine, theirs))
    models, conflicts, taken = {}, [], []
    for key in sorted({*old, *own, *new}):
        before, ours, others = old.get(key), own.get(key), new.get(key)
        chosen = ours
        if ours == before:
            chosen = others
            taken += [key] if others != before else []
        elif others not in (before, ours):
            conflicts.append(key)
            chosen = ours if prefer == "mine" else others
        if chosen is not None:
            models[key] = chosen
    return models, conflicts, taken


def _rows(stored: Stored, object_id: int) -> tuple[Any, ...]:
    """Return the data of an object that others may have changed, without derived data."""
    label = stored.labels.of(object_id)
    row = next((o for o in stored.objects.objects if o.id == object_id), None)
    return row, None if label is None else without_derived(label), stored.annotation.of(object_id)


def _by_id(state: AnnotationState) -> dict[int, ObjectState]:
    return {o.id: o for o in state.objects}


class Stored(Document, frozen=True, kw_only=True):
    """Contents of objects.json, labels.json and annotation.json at one time."""

    objects: ObjectTable
    labels: Labels
    annotation: Annotation

    @staticmethod
    def of(scene: Scene) -> Stored:
        """Read the documents; raises ToolkitError for an unreadable one."""
        return Stored(objects=scene.objects, labels=scene.labels, annotation=scene.annotation)


@dataclass(frozen=True)
class Opened:
    """State read from documents, with warnings.

    Attributes:
        warnings: sentences on data that could not be read exactly.
    """

    state: AnnotationState
    warnings: tuple[str, ...]


def state_of(scene: Scene, cameras: Cameras, stored: Stored) -> Opened:
    """Return the state of the documents; reads no images.

    A propagated label is placed by its world pose. A label annotated in several frames and not yet
    propagated is placed by the pose that agrees best with all of them.
    """
    warnings: list[str] = []
    objects = []
    for obj in stored.objects.objects:
        label = stored.labels.of(obj.id)
        work = stored.annotation.of(obj.id)
        placements: dict[int, Placement] = {}
        if label is not None:
            placements, problem = _placements(scene, cameras, label)
            if problem:
                warnings.append(f"{obj.name}: {problem}")
        clicks: dict[int, list[Click]] = {}
        for click in work.clicks:
            clicks.setdefault(click.frame, []).append(
                Click(u=click.u, v=click.v, point=click.point)
            )
        objects.append(
            ObjectState(
                id=obj.id,
                name=obj.name,
                model=obj.model,
                material=obj.material,
                status=work.status if placements else "open",
                note=work.note,
                locked=work.locked,
                judgement=work.judgement,
                judged_frame=_judged_frame(work, placements),
                placements=placements,
                clicks=dict(sorted(clicks.items())),
            )
        )
    state = AnnotationState(
        models=sorted(stored.objects.models, key=lambda m: m.id),
        objects=sorted(objects, key=lambda o: o.id),
    )
    return Opened(state, tuple(warnings))


def _judged_frame(
    work: ObjectAnnotation, placements: dict[int, Placement]
) -> int | msgspec.UnsetType:
    judged = placements and not isinstance(work.judgement, msgspec.UnsetType)
    return next(iter(placements)) if judged else msgspec.UNSET


def _placements(
    scene: Scene, cameras: Cameras, label: Label
) -> tuple[dict[int, Placement], str | None]:
    annotated = {label.frame: label.T_cam_obj, **{int(k): T for k, T in label.views.items()}}
    if not cameras.posed:
        return {f: _placement(label, T) for f, T in sorted(annotated.items())}, None
    usable = [f for f in annotated if f in cameras.frame_set]
    frame = usable[0] if usable else label.frame
    if label.T_world_obj is None and len(usable) <= 1:
        # Also if its frame has no camera pose: the label then holds in that frame only.
        return {frame: _placement(label, annotated[frame])}, None
    problem = None
    if label.T_world_obj is not None:
        T_world_obj = pose_from_list(label.T_world_obj)
    else:
        T_world_obj, problem = _fused(scene, cameras, label, frame)
    if not usable:
        # Propagated from a frame that has since lost its camera pose.
        frame = cameras.frames[0]
    T_world_cam = cameras.T_world_cam(frame)
    assert T_world_cam is not None
    T_cam_obj = (T_world_cam.inverse() @ T_world_obj).flat()
    if usable and np.abs(np.subtract(T_cam_obj, annotated[frame])).max() <= _SAME:
        T_cam_obj = annotated[frame]
    return {frame: _placement(label, T_cam_obj)}, problem


def _fused(scene: Scene, cameras: Cameras, label: Label, frame: int) -> tuple[SE3, str | None]:
    try:
        placed = place_label(scene, label)
        assert placed.T_world_obj is not None
        return pose_from_list(placed.T_world_obj), None
    except ToolkitError as error:
        T_world_cam = cameras.T_world_cam(frame)
        assert T_world_cam is not None
        problem = f"shown as annotated in frame {frame} only, not in all its frames: {error}"
        return T_world_cam @ annotated_views(label)[frame], problem


def _placement(label: Label, T_cam_obj: list[float]) -> Placement:
    known = label.provenance if isinstance(label.provenance, LabelProvenance) else None
    refinement = known.refinement if known is not None else ""
    if label.refined and T_cam_obj != label.T_cam_obj:
        refinement = "adjusted over several frames when it was propagated"
    return Placement(
        T_cam_obj=T_cam_obj,
        method=label.method,
        refinement=refinement,
        annotator=label.annotator,
        time=known.time if known is not None else "",
    )
