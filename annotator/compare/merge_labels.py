"""Merge of the labels of several annotators of one recording, and the resolution rules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations
from string import ascii_uppercase
from typing import Literal

from annotator.compare.joint_label import joint_label
from annotator.compare.unsaved_work import work_notes
from annotator.options import MergeOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Symmetry
from std_toolkit.geometry.symmetry import common_symmetry
from std_toolkit.io.documents import utc_text
from std_toolkit.labels.agreement import annotated_scene
from std_toolkit.labels.agreement.comparison import ObjectAgreement, agreement_of
from std_toolkit.labels.agreement.options import CompareOptions
from std_toolkit.labels.agreement.shared_recording import shared_recording
from std_toolkit.scene import Annotation, Label, Object, ObjectAnnotation, Scene

Outcome = Literal["merged", "taken", "open"]


@dataclass(frozen=True, eq=False)
class MergedObject:
    """Merge result of one object.

    Attributes:
        object: its row in the target scene.
        labelled: labels of all annotators.
        used: labels used for the result; empty if the object is open.
        outcome: "merged" from several labels, "taken" from one, or "open": without a label.
        apart_m: largest MSSD between two of `labelled`; NaN for a single one or if not comparable.
        note: text on the reason.
        label: resulting label; None if the object is open.
    """

    object: Object
    labelled: tuple[annotated_scene.LabelledObject, ...]
    used: tuple[annotated_scene.LabelledObject, ...]
    outcome: Outcome
    apart_m: float
    note: str
    label: Label | None


@dataclass(frozen=True, eq=False)
class Merge:
    """Merge that is not yet written.

    Attributes:
        target: scene with the frames and camera poses of the labels.
        annotators: the scenes that are merged.
        objects: sorted by object id.
        notes: sentences to report.
    """

    target: annotated_scene.AnnotatedScene
    annotators: tuple[annotated_scene.AnnotatedScene, ...]
    objects: tuple[MergedObject, ...]
    notes: tuple[str, ...]

    @property
    def open(self) -> tuple[MergedObject, ...]:
        """Objects that need a manual decision."""
        return tuple(x for x in self.objects if x.outcome == "open")

    def annotation(self) -> Annotation:
        """Contents of annotation.json; an object is done if all annotators used marked it done."""
        return Annotation(
            objects=[
                ObjectAnnotation(
                    object=x.object.id,
                    status="done" if x.used and all(map(_is_done, x.used)) else "open",
                    note="; ".join(
                        [x.note, *_notes_of(x.labelled)] if x.note else _notes_of(x.labelled)
                    ),
                )
                for x in self.objects
            ]
        )


def merge_labels(
    scenes: Sequence[Scene],
    options: MergeOptions | None = None,
    *,
    target: Scene | None = None,
    time: str | None = None,
) -> Merge:
    """Merge the labels of several annotators, without writing.

    Args:
        scenes: two or more, named "A", "B", ... in this order.
        target: scene of the same recording that receives the labels; default: the recording and
            camera poses of the first scene.
        time: UTC, ISO 8601, for the provenance; default: now.

    Raises:
        ToolkitError: there are fewer than two scenes, the recordings differ, or an option names an
            unknown annotator or object.
    """
    options = options or MergeOptions()
    compare = options
    time = time or utc_text()
    if not 2 <= len(scenes) <= len(ascii_uppercase):
        raise ToolkitError("a merge needs two to 26 scenes", value=len(scenes))
    place, annotators, notes = _shared(scenes, target, options)
    check_names(options, annotators)
    groups: list[list[annotated_scene.LabelledObject]] = []
    for annotated in annotators:
        matching = annotated_scene.match_objects([g[0] for g in groups], annotated.objects)
        for match in matching.matches:
            groups[[g[0] for g in groups].index(match.a)].append(match.b)
            if match.by == "place":
                notes.append(
                    f"{match.a.name} of {match.a.owner.name} is matched with {match.b.name} of "
                    f"{match.b.owner.name}: same mesh, nearest position"
                )
        groups += [[x] for x in matching.only_b]
    notes += [note for annotated in annotators for note in work_notes(annotated)]
    if not groups:
        raise ToolkitError("none of the scenes has labels", path=scenes[0].root)
    check_taken(options, groups)
    rows = _object_rows(place.scene, groups)
    merged = [
        _merged(group, row, place, options, compare, time)
        for group, row in zip(groups, rows, strict=True)
    ]
    merged.sort(key=lambda x: x.object.id)
    return Merge(place, tuple(annotators), tuple(merged), tuple(notes))


def _shared(
    scenes: Sequence[Scene], target: Scene | None, options: MergeOptions
) -> tuple[annotated_scene.AnnotatedScene, list[annotated_scene.AnnotatedScene], list[str]]:
    base = target or scenes[0]
    base_name = "the target" if target else "A"
    annotators, notes = [], []
    for name, scene in zip(ascii_uppercase, scenes, strict=False):
        frames = {f.id: f.id for f in base.frames}
        if scene is not base:
            shared = shared_recording(base, scene, (base_name, name))
            frames = shared.frames
            notes += list(shared.notes)
        annotators.append(annotated_scene.AnnotatedScene(name, scene, frames, options.as_annotated))
    roots = [a.scene.root.resolve() for a in annotators]
    for i, root in enumerate(roots):
        if root in roots[:i]:
            raise ToolkitError("this scene is given twice", path=scenes[i].root)
    place = annotated_scene.AnnotatedScene(base_name, base, {f.id: f.id for f in base.frames})
    return place, annotators, list(dict.fromkeys(notes))


def _merged(
    group: Sequence[annotated_scene.LabelledObject],
    row: Object,
    target: annotated_scene.AnnotatedScene,
    options: MergeOptions,
    compare: CompareOptions,
    time: str,
) -> MergedObject:
    pairs = [
        agreement_of(annotated_scene.Match(x, y, "name"), compare)
        for x, y in combinations(group, 2)
    ]
    used, note = chosen_labels(group, pairs, options)
    apart = max((p.worst_m for p in pairs), default=float("nan"))
    label = None
    if used:
        try:
            _check_mesh(used[0], row, target.scene)
            symmetry = _symmetry_of(used)
            label = joint_label(used, target, object_id=row.id, symmetry=symmetry, time=time)
        except ToolkitError as error:
            used, note = (), f"cannot be transferred: {error}"
    outcome: Outcome = "open" if label is None else "merged" if len(used) > 1 else "taken"
    return MergedObject(row, tuple(group), tuple(used), outcome, apart, note, label)


def _symmetry_of(members: Sequence[annotated_scene.LabelledObject]) -> Symmetry:
    return reduce(
        lambda a, b: common_symmetry(a, b, members[0].outline), (m.symmetry for m in members)
    )


def _object_rows(
    target: Scene, groups: Sequence[Sequence[annotated_scene.LabelledObject]]
) -> list[Object]:
    """Return the row of each object in the target scene; new objects get free ids."""
    table = {o.name: o for o in target.objects.objects}
    taken = {o.id for o in table.values()}
    rows = []
    for group in groups:
        names = [x.name for x in group if x.name in table]
        row = table.get(names[0]) if names else None
        if row is None:
            obj = group[0].object
            free = (i for i in (obj.id, *range(1, 255)) if i not in taken)
            number = next(free, None)
            if number is None:
                raise ToolkitError("no object id is free", value=obj.name)
            taken.add(number)
            row = Object(id=number, name=obj.name, model=obj.model, material=obj.material)
        rows.append(row)
    return rows


def _check_mesh(x: annotated_scene.LabelledObject, row: Object, target: Scene) -> None:
    """Check that an unlabelled object of this name in the target has the same mesh."""
    known = next((o for o in target.objects.objects if o.id == row.id), None)
    if known is None or x.owner.scene is target:
        return
    if not annotated_scene.same_shape(
        x.owner.scene, x.model, target, target.objects.model(known.model)
    ):
        raise ToolkitError("the object has another mesh in the merged scene", field=row.name)


def _is_done(x: annotated_scene.LabelledObject) -> bool:
    return x.owner.scene.annotation.of(x.object.id).status == "done"


def _notes_of(labelled: Sequence[annotated_scene.LabelledObject]) -> list[str]:
    notes = []
    for x in labelled:
        note = x.owner.scene.annotation.of(x.object.id).note
        if note:
            notes.append(f"{x.owner.name}: {note}")
    return notes


def chosen_labels(
    group: Sequence[annotated_scene.LabelledObject],
    pairs: Sequence[ObjectAgreement],
    options: MergeOptions,
) -> tuple[Sequence[annotated_scene.LabelledObject], str]:
    """Return the labels to use, and the reason; none if a manual decision is needed."""
    by_owner = {x.owner.name: x for x in group}
    wanted = options.take.get(group[0].name)
    if wanted is not None:
        return [by_owner[wanted]], f"taken from {wanted}, as asked"
    apart = [p for p in pairs if p.verdict != "agree"]
    if len(group) > 1 and not apart:
        return group, ""
    why = "; ".join(_why(p) for p in apart)
    if len(group) == 1:
        why = f"labelled by {group[0].owner.name} only"
        if options.single:
            return group, why
    elif options.majority:
        agreed = _majority(group, apart)
        if agreed:
            outvoted = [x.owner.name for x in group if x not in agreed]
            return agreed, f"outvoted: {', '.join(outvoted)} ({why})"
    if options.prefer in by_owner:
        return [by_owner[options.prefer]], f"taken from {options.prefer}, preferred ({why})"
    return [], why


def _why(pair: ObjectAgreement) -> str:
    names = f"{pair.a.owner.name} and {pair.b.owner.name}"
    if pair.difference is None:
        return f"{names}: {pair.mostly}"
    return f"{names} are {1000 * pair.worst_m:.1f} mm apart, {pair.mostly}"


def _majority(
    group: Sequence[annotated_scene.LabelledObject], apart: Sequence[ObjectAgreement]
) -> Sequence[annotated_scene.LabelledObject]:
    """Return the largest set of pairwise agreeing labels, if unique and more than half."""
    foes = {frozenset((p.a.owner.name, p.b.owner.name)) for p in apart}
    for size in range(len(group) - 1, len(group) // 2, -1):
        found = [
            members
            for members in combinations(group, size)
            if not any(
                frozenset((x.owner.name, y.owner.name)) in foes for x, y in combinations(members, 2)
            )
        ]
        if found:
            return found[0] if len(found) == 1 else ()
    return ()


def check_names(
    options: MergeOptions, annotators: Sequence[annotated_scene.AnnotatedScene]
) -> None:
    """Raise ToolkitError for an option that names an unknown annotator."""
    known = [a.name for a in annotators]
    asked = {"--prefer": options.prefer, **{f"--take {k}": v for k, v in options.take.items()}}
    for field_name, name in asked.items():
        if name is not None and name not in known:
            raise ToolkitError(
                "no such annotator",
                field=field_name,
                value=name,
                hint=f"{known[0]} to {known[-1]}, in the order of the folders",
            )


def check_taken(
    options: MergeOptions, groups: Sequence[Sequence[annotated_scene.LabelledObject]]
) -> None:
    """Raise ToolkitError for `take` of an unknown or unlabelled object."""
    by_name = {g[0].name: g for g in groups}
    for name, owner in options.take.items():
        if name not in by_name:
            raise ToolkitError(
                "no such labelled object",
                field="--take",
                value=name,
                hint=f"known: {', '.join(sorted(by_name))}",
            )
        have = [x.owner.name for x in by_name[name]]
        if owner not in have:
            raise ToolkitError(
                f"{owner} did not label it",
                field="--take",
                value=name,
                hint=f"labelled by {', '.join(have)}",
            )
