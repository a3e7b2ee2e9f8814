"""dataset.json and README.md of a data set: splits, licence and statistics; no names of people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.scene.document import Count, Document, NonNegative
from std_toolkit.scene.judgement import GRADES
from std_toolkit.scene.model import pose_from_list
from std_toolkit.scene.sidecar import Sidecar

DATASET = "dataset.json"

# Directions from which an object may be seen, evenly spread: about 15 degrees apart.
_DIRECTIONS = 162


class DatasetScene(Document, frozen=True, kw_only=True):
    """A scene of a data set.

    Attributes:
        name: of the scene in its project.
        split: "train", "val" or "test".
        folder: of its frames, relative to the data set; its `std_toolkit.json` lies there.
        frames, objects: how many were exported.
    """

    name: str
    split: str
    folder: str
    frames: Count
    objects: Count


class DatasetModel(Document, frozen=True, kw_only=True):
    """A model of a data set.

    Attributes:
        model: its id in the scenes.
        layout_id: its name or number in the layout.
        category: such as "mug".
        materials: of its objects.
        scenes, objects: in how many scenes it is, and as how many objects.
        poses: number of poses, one for each object and frame.
        visible: mean visible fraction over the poses.
        nearest_m, farthest_m: distance of its origin from the camera.
        viewpoints: of 162 directions that are spread evenly about it, from how many it was seen;
            a symmetry of the model is not regarded.
    """

    model: str
    layout_id: str
    category: str
    materials: list[str]
    scenes: Count
    objects: Count
    poses: Count
    visible: NonNegative
    nearest_m: NonNegative
    farthest_m: NonNegative
    viewpoints: Count


class DatasetLabels(Document, frozen=True, kw_only=True):
    """What the check says of the exported labels.

    Attributes:
        grades: number of labels by verdict.
        deviation_mm, deviation_deg: median and largest standard deviation of the measured pose
            along its weakest direction; null if it is known of no label.
    """

    grades: dict[str, Count]
    deviation_mm: list[float] | None
    deviation_deg: list[float] | None


class Dataset(Document, frozen=True, kw_only=True):
    """dataset.json at the top of a data set of many scenes; written last.

    Attributes:
        name: of the project.
        layout: name of the exporter.
        tool: version of the toolkit.
        licence: as it was given.
        rule: how scenes were assigned to splits.
        digest: of everything that determines the data set.
        splits: names of the scenes by split.
        scenes, models, labels: what is in it.
        files: digest of the content of every other file by path.
    """

    format: Literal["std-toolkit-dataset"] = "std-toolkit-dataset"
    format_version: Literal[1] = 1
    name: str
    layout: str
    tool: str
    licence: str
    rule: str
    digest: str
    splits: dict[str, list[str]]
    scenes: list[DatasetScene]
    models: list[DatasetModel]
    labels: DatasetLabels
    files: dict[str, str]


def models_of(sidecars: Sequence[Sidecar]) -> list[DatasetModel]:
    """Statistics of the models over exported scenes, sorted by id."""
    found = []
    ids = sorted({m.model for sidecar in sidecars for m in sidecar.models})
    for model_id in ids:
        materials: set[str] = set()
        layout_id = category = ""
        scenes = objects = 0
        directions: list[NDArray[np.float64]] = []
        distances: list[float] = []
        visible: list[float] = []
        for sidecar in sidecars:
            mine = {o.id: o for o in sidecar.objects.objects if o.model == model_id}
            row = sidecar.model(model_id)
            if row is None or not mine:
                continue
            layout_id, category = row.layout_id, sidecar.objects.model(model_id).category
            scenes, objects = scenes + 1, objects + len(mine)
            materials |= {o.material for o in mine.values()}
            for pose in (o for f in sidecar.frames for o in f.objects if o.object in mine):
                seen = pose_from_list(pose.T_cam_obj).inverse().t  # the camera in the mesh frame
                distances.append(float(np.linalg.norm(seen)))
                directions.append(seen / max(distances[-1], 1e-9))
                visible.append(pose.visible_fraction)
        found.append(
            DatasetModel(
                model=model_id,
                layout_id=layout_id,
                category=category,
                materials=sorted(materials),
                scenes=scenes,
                objects=objects,
                poses=len(distances),
                visible=round(float(np.mean(visible or [0.0])), 4),
                nearest_m=round(min(distances, default=0.0), 4),
                farthest_m=round(max(distances, default=0.0), 4),
                viewpoints=_covered(directions),
            )
        )
    return found


def _covered(directions: list[NDArray[np.float64]]) -> int:
    """Of evenly spread directions, how many are the nearest one of a view."""
    if not directions:
        return 0
    # A Fibonacci sphere.
    k = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1 - 2 * k / _DIRECTIONS, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z**2)
    spread = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    return len(set((np.stack(directions) @ spread.T).argmax(axis=1).tolist()))


def labels_of(sidecars: Sequence[Sidecar]) -> DatasetLabels:
    """Verdicts and deviations of the exported labels."""
    rows = []
    for sidecar in sidecars:
        if not isinstance(sidecar.quality, msgspec.UnsetType):
            gone = {x.object for x in sidecar.left_out_objects}
            rows += [row for row in sidecar.quality.labels if row.object not in gone]
    return DatasetLabels(
        grades={grade: sum(row.grade == grade for row in rows) for grade in GRADES},
        deviation_mm=_median_and_largest(row.deviation_mm for row in rows),
        deviation_deg=_median_and_largest(row.deviation_deg for row in rows),
    )


def _median_and_largest(values: Iterable[float | None]) -> list[float] | None:
    known = [value for value in values if value is not None]
    return [round(float(np.median(known)), 4), round(max(known), 4)] if known else None


def card_text(dataset: Dataset) -> str:
    """README.md: what a reader needs to know before the download."""
    frames = sum(s.frames for s in dataset.scenes)
    labels = dataset.labels
    lines = [
        f"# {dataset.name}",
        "",
        f"{len(dataset.scenes)} scenes, {frames} frames, {len(dataset.models)} models, "
        f"{sum(m.poses for m in dataset.models)} poses; layout `{dataset.layout}`, written by "
        f"std-toolkit {dataset.tool}.",
        "",
        f"**Licence:** {dataset.licence}",
        "",
        "Every scene was accepted by a reviewer: the check calls no label wrong, and the reviewer "
        "gave a reason to keep each label that it doubts or knows nothing of.",
        "",
        "## Splits",
        "",
        f"Rule: {dataset.rule}.",
        "",
        "| split | scenes | frames | objects |",
        "|---|---|---|---|",
    ]
    for split, names in dataset.splits.items():
        rows = [s for s in dataset.scenes if s.split == split]
        counts = (len(names), sum(s.frames for s in rows), sum(s.objects for s in rows))
        lines.append(f"| {split} | {' | '.join(map(str, counts))} |")
    lines += ["", "| scene | split | folder | frames | objects |", "|---|---|---|---|---|"]
    lines += [
        f"| {s.name} | {s.split} | {s.folder} | {s.frames} | {s.objects} |" for s in dataset.scenes
    ]
    lines += [
        "",
        "## Objects",
        "",
        f"`viewpoints`: of {_DIRECTIONS} directions spread evenly about the model, from how many "
        "it was seen.",
        "",
        "| model | id | category | materials | scenes | objects | poses | visible | distance m "
        "| viewpoints |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for m in dataset.models:
        cells = (
            m.model, m.layout_id, m.category, ", ".join(m.materials), str(m.scenes),
            str(m.objects), str(m.poses), f"{m.visible:.2f}",
            f"{m.nearest_m:.2f} to {m.farthest_m:.2f}", str(m.viewpoints),
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    told = ", ".join(f"{n} {grade}" for grade, n in labels.grades.items() if n)
    lines += ["", "## Labels", "", f"Verdicts of the check: {told or 'none'}.", ""]
    for values, unit in ((labels.deviation_mm, "mm"), (labels.deviation_deg, "deg")):
        if values is not None:
            lines.append(
                f"- Standard deviation along the weakest direction: median {values[0]:.2f} {unit}, "
                f"largest {values[1]:.2f} {unit}."
            )
    lines += [
        "",
        "`std_toolkit.json` beside the frames of each scene has its labels, camera poses,",
    ]
    lines += ["verdicts and the digests of its files.", ""]
    return "\n".join(lines)
