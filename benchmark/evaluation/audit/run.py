"""`std-bench audit`: judges the labels of a set scene by scene, and writes what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmark.data.field.label_sets import open_labels
from benchmark.data.labelled import LabelledFrame, LabelledSet
from benchmark.evaluation.audit.judged import JudgedGroup, audited
from benchmark.evaluation.audit.record import (
    FRAMES_CSV,
    LABELS_CSV,
    OBJECTS_CSV,
    PICTURES,
    Audit,
    AuditedLabel,
    AuditedObject,
    AuditedScene,
    Disagreement,
    plain,
)
from benchmark.evaluation.audit.rigid import Group, groups_of
from benchmark.evaluation.audit.unseen import unseen
from benchmark.evaluation.batches import chosen_frames
from benchmark.evaluation.manifest import circumstances
from benchmark.evaluation.query_options import AUDIT_FILE, AuditOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import ROTATION_TOLERANCE
from std_toolkit.io.atomic import write_bytes_atomic, write_csv_atomic
from std_toolkit.io.documents import write_document
from std_toolkit.jobs import run_jobs
from std_toolkit.log import logger
from std_toolkit.options import CheckOptions
from std_toolkit.settings import changed

SIZES = ("error_mm", "error_deg", "across_mm")


@cache
def _open(options: AuditOptions) -> LabelledSet:
    """The set, listed once in a process."""
    return open_labels(options.set, options.split, models=options.models, material=options.material)


def run_audit(options: AuditOptions) -> Audit:
    """Judge the labels of a set and write audit.json and the tables.

    Raises:
        ToolkitError: the set cannot be read, or none of its scenes can be judged.
    """
    source = _open(options)
    chosen: dict[str, list[int]] = {}
    for index, key in enumerate(source.keys()):
        chosen.setdefault(key.scene, []).append(index)
    unknown = sorted(set(options.scenes) - set(chosen))
    if unknown:
        raise ToolkitError(
            "no such scene in this set", field="scene", value=unknown[0],
            hint=", ".join(list(chosen)[:8]),
        )  # fmt: skip
    names = list(options.scenes or chosen)
    work = []
    for name in names:
        mine = chosen[name]
        picked = (mine[i] for i in chosen_frames(len(mine), options.frames))
        work.append(_Scene(name, tuple(picked), len(mine)))
    read = run_jobs(_Groups(options), work, name="labels", key=str, options=options.jobs)
    if not read.results:
        read.raise_if_failed()
    groups = [item for found in read.results.values() for item in found.groups]
    done = run_jobs(_Judge(options), groups, name="audit", key=str, options=options.jobs)
    if not done.results:
        done.raise_if_failed()
    audit = _assembled(options, list(read.results.values()), done.results, done.failed)
    for scene, error in read.failed.items():
        logger.warning("scene %s is left out: %s", scene, error)
    pictures = {n: data for group in done.results.values() for n, data in group.pictures.items()}
    write(options.out, audit, pictures)
    return audit


@dataclass(frozen=True)
class _Scene:
    name: str
    indices: tuple[int, ...]
    frames: int

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class _Item:
    """A group of frames of a scene, by number."""

    scene: _Scene
    indices: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.scene.name}, {'' if len(self.indices) > 1 else 'frame '}{self.indices[0]}"


@dataclass(frozen=True)
class _Read:
    """What the labels of a scene say without images."""

    scene: AuditedScene
    groups: list[_Item]


@dataclass(frozen=True)
class _Groups:
    """Reads the labels of a scene."""

    options: AuditOptions

    def __call__(self, scene: _Scene) -> _Read:
        source = _open(self.options)
        frames, problems = [], []
        for index in scene.indices:
            try:
                frames.append(source.labels(index))
            except ToolkitError as error:
                problems.append(str(error))
        if not frames:
            raise ToolkitError(problems[0] if problems else "no frame", value=scene.name)
        groups = groups_of(frames)
        about = _about(scene, frames, groups, problems)
        items = [_Item(scene, tuple(f.index for f in g.frames)) for g in groups]
        return _Read(about, items)


@dataclass(frozen=True)
class _Judge:
    """Judges a group of frames."""

    options: AuditOptions

    def __call__(self, item: _Item) -> JudgedGroup:
        source = _open(self.options)
        whole = 1 < len(item.indices) == len(item.scene.indices)
        found = [
            audited(item.scene.name, group, source, CheckOptions(), whole=whole)
            for group in groups_of([source.labels(i) for i in item.indices])
        ]
        return JudgedGroup.joined(found)


def _about(
    scene: _Scene, frames: Sequence[LabelledFrame], groups: Sequence[Group], problems: list[str]
) -> AuditedScene:
    labels = [o for f in frames for o in f.objects]
    off = np.array([o for g in groups for o in g.off.values()]).reshape(-1, 2)
    rough = [o.rotation_off for o in labels if o.rotation_off > ROTATION_TOLERANCE]
    typical = [round(float(x), 3) for x in np.median(off, axis=0)] if len(off) else [None, None]
    most = [round(float(x), 3) for x in off.max(axis=0)] if len(off) else [None, None]
    return AuditedScene(
        scene=plain(scene.name),
        frames=scene.frames,
        looked_at=len(frames),
        cameras=next((g.cameras for g in groups if g.cameras != "none"), "none"),
        alone=sum(g.cameras == "none" for g in groups),
        labels=len(labels),
        off_mm=typical[0],
        off_deg=typical[1],
        off_most_mm=most[0],
        off_most_deg=most[1],
        rough=len(rough),
        rough_most=float(f"{max(rough, default=0.0):.3g}"),
        without_mesh=sorted({o.name for o in labels if o.mesh is None}),
        without_images=sum(not f.has_images for f in frames),
        problems=problems,
    )


def _assembled(
    options: AuditOptions,
    read: Sequence[_Read],
    judged: dict[str, JudgedGroup],
    failed: dict[str, str],
) -> Audit:
    scenes = []
    labels: list[AuditedLabel] = []
    found: list[Disagreement] = []
    for one in read:
        mine = [judged[str(item)] for item in one.groups if str(item) in judged]
        unread = [f"{item}: {failed[str(item)]}" for item in one.groups if str(item) in failed]
        labels += [row for group in mine for row in group.labels]
        found += [row for group in mine for row in group.disagreements]
        problems = one.scene.problems + unread + [p for group in mine for p in group.problems]
        without = sum(group.without_depth for group in mine)
        scenes.append(msgspec.structs.replace(one.scene, problems=problems, without_depth=without))
    audit = Audit(
        set=plain(options.name or options.set.resolve().name),
        split=options.split,
        root=str(options.set),
        limits={k: float(v) for k, v in asdict(CheckOptions()).items()} | changed(),
        scenes=scenes,
        labels=labels,
        disagreements=found,
        unseen=[],
        **circumstances(),
    )
    return msgspec.structs.replace(audit, unseen=unseen(audit))


def write(folder: Path, audit: Audit, pictures: Mapping[str, bytes]) -> None:
    """Write audit.json, the tables and the pictures by name."""
    for name, data in pictures.items():
        write_bytes_atomic(folder / PICTURES / name, data)
    tables: dict[str, tuple[type, Sequence[msgspec.Struct]]] = {
        LABELS_CSV: (AuditedLabel, audit.labels),
        OBJECTS_CSV: (AuditedObject, audit.objects()),
        FRAMES_CSV: (Disagreement, audit.disagreements),
    }
    for name, (kind, rows) in tables.items():
        columns = [c for f in msgspec.structs.fields(kind) for c in _columns(f.name)]
        write_csv_atomic(folder / name, columns, map(flat, rows))
    write_document(folder / AUDIT_FILE, audit)


def _columns(name: str) -> list[str]:
    return [name, f"{name}_low", f"{name}_high"] if name in SIZES else [name]


def flat(row: msgspec.Struct) -> dict[str, Any]:
    """A row of a table: sizes with their bounds in columns of their own."""
    found: dict[str, Any] = {}
    for name, value in msgspec.to_builtins(row).items():
        if name in SIZES:
            numbers = value or {"value": None, "low": None, "high": None}
            found |= dict(zip(_columns(name), numbers.values(), strict=True))
        else:
            found[name] = value
    return found
