"""Saving of the labels with working times, and propagation to all frames of the scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import msgspec

from annotator.session.merge import Stored, Version, content
from annotator.session.state import (
    AnnotationState,
    Cameras,
    Judged,
    ObjectState,
    Placement,
    object_table,
)
from std_toolkit import __version__
from std_toolkit.geometry import SE3
from std_toolkit.labels.entry.label import annotated_label
from std_toolkit.log import collected_warnings
from std_toolkit.scene import (
    Annotation,
    Label,
    LabelProvenance,
    Labels,
    ObjectAnnotation,
    ObjectTable,
    Scene,
)
from std_toolkit.scene.judgement import Judgement, kept_judgement
from std_toolkit.scene.model import ClickedPoint

if TYPE_CHECKING:
    from std_toolkit.options import PropagateOptions

TOOL = "std-annotate"

# Longer pauses between edits count with this time: the annotator may be away.
LONGEST_PAUSE_S = 30.0


@dataclass(frozen=True)
class SaveReport:
    """Result of saving.

    Attributes:
        files: names of the written documents.
        labelled: names of the objects whose labels were written.
        taken_over: names of objects and models changed by others meanwhile and merged into the
            session.
        warnings: sentences to report.
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
            text += f" Changes by others were merged: {', '.join(self.taken_over)}."
        return " ".join([text, *self.warnings])


def documents_of(
    state: AnnotationState,
    base: Version,
    hands_on: WorkTimer | None,
    cameras: Cameras,
    judged: Mapping[int, Judged] = MappingProxyType({}),
) -> Stored:
    """Return the documents of the state; unchanged parts stay as in `base`.

    Judgements whose pose was left behind are dropped.

    Args:
        base: the current documents of the scene.
        hands_on: working time since they were last written, or None without manual work.
        cameras: camera poses of the scene.
        judged: what was measured of the present poses, by object id.
    """
    shown = {o.id: o for o in base.state.objects}
    labels, rows = [], []
    for obj in state.objects:
        old = base.stored.labels.of(obj.id)
        if content(obj)["pose"] == content(shown.get(obj.id))["pose"]:
            label = old
        else:
            label = _label(obj, old, hands_on)
        if label is not None:
            T = cameras.T_world_obj(state, obj.name)
            measured = judged.get(obj.id)
            label = _with_judgement(label, old, T, measured)
            labels.append(label)
        found = cameras.judgement(state, obj.name, judged.get(obj.id))
        row = _work(obj, found or msgspec.UNSET)
        known = base.stored.annotation.of(obj.id)
        same = content(obj)["work"] == content(shown.get(obj.id))["work"]
        if same and row.judgement == known.judgement:
            row = known
        if row != ObjectAnnotation(object=obj.id) or known in base.stored.annotation.objects:
            rows.append(row)
    return Stored(
        objects=_kept_table(base.stored.objects, object_table(state)),
        labels=_kept_labels(base.stored.labels, Labels(labels=labels)),
        annotation=_kept_rows(base.stored.annotation, Annotation(objects=rows)),
    )


def write_documents(scene: Scene, new: Stored) -> tuple[str, ...]:
    """Write the changed documents; the caller holds the scene's lock.

    The order keeps the scene consistent at every moment: a label never refers to a wrong object.

    Returns:
        Names of the written files.
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


def _label(obj: ObjectState, old: Label | None, hands_on: WorkTimer | None) -> Label | None:
    if not obj.placements:
        return None
    frame = next(iter(obj.placements))
    if old is not None and old.frame in obj.placements:
        frame = old.frame
    latest = max(obj.placements.values(), key=lambda p: p.time)
    return annotated_label(
        obj.id,
        {f: p.T_cam_obj for f, p in obj.placements.items()},
        frame=frame,
        method=latest.method,
        annotator=latest.annotator,
        provenance=_provenance(obj, latest, old, hands_on),
    )


def _with_judgement(
    label: Label, old: Label | None, T_world_obj: SE3 | None, measured: Judged | None
) -> Label:
    """The label with a judgement that holds for its pose: the stored one, or a new one."""
    kept: Judgement | msgspec.UnsetType = msgspec.UNSET
    if old is not None:
        kept = old.judgement if label is old else kept_judgement(old.judgement, T_world_obj)
    if measured is not None and measured.frame is None:
        new = kept_judgement(measured.judgement, T_world_obj)
        stale = isinstance(kept, msgspec.UnsetType) or kept.inputs != measured.judgement.inputs
        kept = new if stale and not isinstance(new, msgspec.UnsetType) else kept
    return msgspec.structs.replace(label, judgement=kept) if kept != label.judgement else label


def _provenance(
    obj: ObjectState, latest: Placement, old: Label | None, hands_on: WorkTimer | None
) -> LabelProvenance | msgspec.UnsetType:
    before = old.provenance if old is not None else msgspec.UNSET
    if not latest.time:
        return before  # the origin of the remaining poses was not recorded
    seconds = before.hands_on_s if isinstance(before, LabelProvenance) else None
    if hands_on is not None:
        seconds = round((seconds or 0.0) + hands_on.seconds(obj.id), 1)
    return LabelProvenance(
        time=latest.time,
        tool=TOOL,
        version=__version__,
        refinement=latest.refinement,
        hands_on_s=seconds,
    )


def _work(obj: ObjectState, judgement: Judgement | msgspec.UnsetType) -> ObjectAnnotation:
    return ObjectAnnotation(
        object=obj.id,
        status=obj.status,
        note=obj.note,
        locked=obj.locked,
        judgement=judgement,
        clicks=[
            ClickedPoint(frame=frame, u=c.u, v=c.v, point=c.point)
            for frame, clicks in sorted(obj.clicks.items())
            for c in clicks
        ],
    )


# Equal content in a different order keeps the file bytes.


def _kept_table(old: ObjectTable, new: ObjectTable) -> ObjectTable:
    same = sorted(old.models, key=lambda m: m.id) == new.models and (
        sorted(old.objects, key=lambda o: o.id) == new.objects
    )
    return old if same else new


def _kept_labels(old: Labels, new: Labels) -> Labels:
    return old if sorted(old.labels, key=lambda x: x.object) == new.labels else new


def _kept_rows(old: Annotation, new: Annotation) -> Annotation:
    return old if sorted(old.objects, key=lambda x: x.object) == new.objects else new


class WorkTimer:
    """Working time in seconds by object id.

    The time between two edits is assigned to the object of the second (split evenly among several).
    Pauses count with at most `LONGEST_PAUSE_S`, and the time before the first edit does not count,
    so the sum is a lower bound of the working time.
    """

    def __init__(self) -> None:
        self._last: datetime | None = None
        self._seconds: dict[int, float] = {}

    def edited(self, time: str, objects: Iterable[int]) -> None:
        """Record an edit, undo or redo at `time` (UTC, ISO 8601)."""
        now, numbers = datetime.fromisoformat(time), list(objects)
        if self._last is not None:
            gap = min(max((now - self._last).total_seconds(), 0.0), LONGEST_PAUSE_S)
            for i in numbers:
                self._seconds[i] = self._seconds.get(i, 0.0) + gap / len(numbers)
        self._last = now

    def saved(self, objects: Iterable[int]) -> None:
        """Reset the time of these objects after it was saved."""
        for i in objects:
            self._seconds.pop(i, None)

    def pause(self) -> None:
        """Ignore the time until the next edit, because the annotator left."""
        self._last = None

    def seconds(self, object_id: int) -> float:
        return round(self._seconds.get(object_id, 0.0), 1)


@dataclass(frozen=True)
class PropagationResult:
    """Result of propagating labels.

    Attributes:
        lines: one or more lines of text on each label.
        warnings: sentences on what to inspect, such as a label whose refinement did not converge.
    """

    lines: tuple[str, ...]
    warnings: tuple[str, ...]


def propagate_saved_labels(
    root: Path, options: PropagateOptions | None = None
) -> PropagationResult:
    """Propagate the saved labels of a scene folder to all its frames.

    Takes up to minutes, and may run in any thread. A session on the scene must be reloaded
    afterwards and must not be edited meanwhile.

    Raises:
        ToolkitError: as `std_toolkit.labels.propagate.propagate_labels`.
    """
    from std_toolkit.labels.propagate import label_lines, propagate_labels

    scene = Scene.open(root)
    with collected_warnings() as warnings:
        labels = propagate_labels(scene, options)
    lines = tuple(line.strip() for line in label_lines(scene, labels))
    return PropagationResult(lines, tuple(warnings))
