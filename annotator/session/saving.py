"""From the state to objects.json, labels.json and annotation.json."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from annotator.session.hands_on import HandsOn
from annotator.session.merging import Version, content
from annotator.session.snapshot import object_table
from annotator.session.state import AnnotationState, ObjectState, Placement
from annotator.session.stored import Stored
from std_toolkit import __version__
from std_toolkit.labels.label import annotated_label
from std_toolkit.scene import (
    Annotation,
    Label,
    LabelProvenance,
    Labels,
    ObjectAnnotation,
    ObjectTable,
    Scene,
)
from std_toolkit.scene.model import ClickedPoint

TOOL = "std-annotate"


@dataclass(frozen=True)
class SaveReport:
    """What saving did.

    Attributes:
        files: names of the documents that were written.
        labelled: names of the objects whose labels were written.
        taken_over: names of what others had changed meanwhile, now in the session too.
        warnings: sentences for people.
    """

    files: tuple[str, ...] = ()
    labelled: tuple[str, ...] = ()
    taken_over: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        if not self.files:
            text = "There is nothing to save."
        elif self.labelled:
            text = f"Saved: labels of {', '.join(self.labelled)}."
        else:
            text = f"Saved: {', '.join(self.files)}."
        if self.taken_over:
            text += f" Others had changed {', '.join(self.taken_over)}: that was taken over."
        return " ".join([text, *self.warnings])


def documents_of(state: AnnotationState, base: Version, hands_on: HandsOn | None) -> Stored:
    """The documents that the state stands for; what it leaves alone stays as it is in `base`.

    Args:
        base: what stands in the scene now.
        hands_on: seconds worked since they were last written, or None if no hand was at work.
    """
    shown = {o.id: o for o in base.state.objects}
    labels, rows = [], []
    for thing in state.objects:
        old = base.stored.labels.of(thing.id)
        if content(thing)["pose"] == content(shown.get(thing.id))["pose"]:
            label = old
        else:
            label = _label(thing, old, hands_on)
        labels += [] if label is None else [label]
        row = _work(thing)
        known = base.stored.annotation.of(thing.id)
        if content(thing)["work"] == content(shown.get(thing.id))["work"]:
            row = known
        if row != ObjectAnnotation(object=thing.id) or known in base.stored.annotation.objects:
            rows.append(row)
    return Stored(
        objects=_kept_table(base.stored.objects, object_table(state)),
        labels=_kept_labels(base.stored.labels, Labels(labels=labels)),
        annotation=_kept_rows(base.stored.annotation, Annotation(objects=rows)),
    )


def write_documents(scene: Scene, new: Stored) -> tuple[str, ...]:
    """Write what changed; the caller holds the scene's lock.

    The order is such that the scene is whole at every moment: a label never stands beside another
    object than its own.

    Returns:
        Names of the files that were written.
    """
    written = []
    models = {o.id: o.model for o in new.objects.objects}
    stays = {o.id for o in scene.objects.objects if models.get(o.id) == o.model}
    kept = Labels(labels=[x for x in scene.labels.labels if x.object in stays])
    if kept != scene.labels:
        scene.save_labels(kept)
        written.append("labels.json")
    work = Annotation(objects=[x for x in scene.annotation.objects if x.object in stays])
    if work != scene.annotation:
        scene.save_annotation(work)
        written.append("annotation.json")
    if new.objects != scene.objects:
        scene.save_objects(new.objects)
        written.append("objects.json")
    if new.labels != scene.labels:
        scene.save_labels(new.labels)
        written.append("labels.json")
    if new.annotation != scene.annotation:
        scene.save_annotation(new.annotation)
        written.append("annotation.json")
    return tuple(dict.fromkeys(written))


def _label(thing: ObjectState, old: Label | None, hands_on: HandsOn | None) -> Label | None:
    if not thing.placements:
        return None
    frame = next(iter(thing.placements))
    if old is not None and old.frame in thing.placements:
        frame = old.frame
    latest = max(thing.placements.values(), key=lambda p: p.time)
    return annotated_label(
        thing.id,
        {f: p.T_cam_obj for f, p in thing.placements.items()},
        frame=frame,
        method=latest.method,
        annotator=latest.annotator,
        provenance=_provenance(thing, latest, old, hands_on),
    )


def _provenance(
    thing: ObjectState, latest: Placement, old: Label | None, hands_on: HandsOn | None
) -> LabelProvenance | msgspec.UnsetType:
    before = old.provenance if old is not None else msgspec.UNSET
    if not latest.time:
        return before  # nobody recorded how the poses that are left came about
    seconds = before.hands_on_s if isinstance(before, LabelProvenance) else None
    if hands_on is not None:
        seconds = round((seconds or 0.0) + hands_on.seconds(thing.id), 1)
    return LabelProvenance(
        time=latest.time,
        tool=TOOL,
        version=__version__,
        refinement=latest.refinement,
        hands_on_s=seconds,
    )


def _work(thing: ObjectState) -> ObjectAnnotation:
    return ObjectAnnotation(
        object=thing.id,
        status=thing.status,
        note=thing.note,
        clicks=[
            ClickedPoint(frame=frame, u=c.u, v=c.v, point=c.point)
            for frame, clicks in sorted(thing.clicks.items())
            for c in clicks
        ],
    )


# What says the same in another order stays as it is, to the byte.


def _kept_table(old: ObjectTable, new: ObjectTable) -> ObjectTable:
    same = sorted(old.models, key=lambda m: m.id) == new.models and (
        sorted(old.objects, key=lambda o: o.id) == new.objects
    )
    return old if same else new


def _kept_labels(old: Labels, new: Labels) -> Labels:
    return old if sorted(old.labels, key=lambda x: x.object) == new.labels else new


def _kept_rows(old: Annotation, new: Annotation) -> Annotation:
    return old if sorted(old.objects, key=lambda x: x.object) == new.objects else new
