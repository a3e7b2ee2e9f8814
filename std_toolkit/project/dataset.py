"""One data set of all accepted scenes of a project, in the layout of an exporter.

Each scene is exported by its exporter into the staging area, where finished ones are kept if the
run is interrupted. Their files are then joined: hard links where the file system allows it.
"""

from __future__ import annotations

import hashlib
import math
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import msgspec

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError, check_known
from std_toolkit.exporters.bop_metadata import record_lines
from std_toolkit.exporters.bop_shards import write_shards
from std_toolkit.exporters.export_step import export_digest, export_scene
from std_toolkit.exporters.staging import PROGRESS, staging_area
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import (
    digest_bytes,
    digest_files,
    digest_of,
    document_bytes,
    read_document,
    write_document,
)
from std_toolkit.io.foreign_files import read_json
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.artefact import changed_files
from std_toolkit.log import logger
from std_toolkit.options import ExportOptions
from std_toolkit.project.dataset_card import (
    DATASET,
    Dataset,
    DatasetScene,
    card_text,
    labels_of,
    models_of,
)
from std_toolkit.project.record import Project
from std_toolkit.project.status import SceneRow
from std_toolkit.scene.model import Labels
from std_toolkit.scene.scene import Scene
from std_toolkit.scene.sidecar import SIDECAR_NAME, Sidecar

By = Literal["name", "order"]
Split = Literal["train", "val", "test"]
CARD = "README.md"
# Layouts whose scenes lie below the folder of their split already.
_JOINED = ("bop", "nocs")
_PER_SCENE = ("dataset_info.md", "dataset_info.json")


@dataclass(frozen=True)
class _Part:
    """A scene of the data set: its row, its finished export and where its files belong."""

    row: DatasetScene
    root: Path
    sidecar: Sidecar
    prefix: str


def assign_splits(
    names: Sequence[str], shares: Mapping[str, float], by: By
) -> dict[str, list[str]]:
    """Which scenes belong to which split: whole scenes, never frames.

    Args:
        names: of the scenes, in the order of the project.
        shares: fraction by name of the split; their sum is 1.
        by: "name": a scene's split follows from a digest of its name, so that it stays where it is
            when scenes are added; the shares are met on average. "order": the first scenes belong
            to the first split, and so on; the shares are met as well as whole scenes allow.

    Returns:
        Names by split, in the order of `shares`.

    Raises:
        ToolkitError: an unknown split, shares that are no fractions with the sum 1, or a split
            without a scene.

    >>> assign_splits(["a", "b", "c", "d"], {"train": 0.75, "test": 0.25}, "order")
    {'train': ['a', 'b', 'c'], 'test': ['d']}
    """
    for split, share in shares.items():
        check_known(split, get_args(Split), "no such split", field="--split")
        if not (math.isfinite(share) and 0 < share <= 1):
            raise ToolkitError("must be a fraction", field="--split", value=f"{split}={share:g}")
    if abs(sum(shares.values()) - 1) > 1e-6:
        raise ToolkitError(
            "the fractions must add up to 1", field="--split", value=sum(shares.values())
        )
    ends, total = [], 0.0
    for share in shares.values():
        total += share
        ends.append(total)
    found: dict[str, list[str]] = {split: [] for split in shares}
    for place, name in enumerate(names):
        at = _unit(name) if by == "name" else (place + 0.5) / len(names)
        index = next((i for i, end in enumerate(ends) if at < end), len(ends) - 1)
        found[list(shares)[index]].append(name)
    empty = [split for split, scenes in found.items() if not scenes]
    if empty:
        raise ToolkitError(
            f"{empty[0]} gets none of {len(names)} scenes",
            field="--split",
            value=" ".join(f"{k}={v:g}" for k, v in shares.items()),
            hint="give other fractions, --split-by order, or accept more scenes",
        )
    return found


def _unit(name: str) -> float:
    """A number in [0, 1) that depends on the name alone, in every version of the toolkit."""
    digest = hashlib.blake2b(name.encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") / 2**64


def export_project(
    project: Project,
    rows: Sequence[SceneRow],
    format_name: str,
    out: Path,
    *,
    licence: str,
    shares: Mapping[str, float],
    by: By = "name",
    shard_images: int = 0,
    options: ExportOptions | None = None,
    jobs: JobOptions | None = None,
) -> Dataset:
    """Write one data set of all accepted scenes.

    Args:
        project: the project.
        rows: its board, of the files as they are.
        format_name: name of an exporter.
        out: folder of the data set; the same one is kept, an interrupted one is gone on with.
        licence: of the images, labels and meshes, for the card.
        shares, by: see `assign_splits`.
        shard_images: most images of a shard beside each split of BOP; 0 for no shards.
        options: of the exports of the scenes; number, name and split of each are set here.
        jobs: where the frames are written.

    Returns:
        dataset.json.

    Raises:
        ToolkitError: no scene is accepted, two scenes have different meshes of one name, a split
            is empty, a scene cannot be exported, `out` has other content, or the layout has no
            shards.
    """
    if shard_images and format_name != "bop":
        raise ToolkitError(
            "only bop has shards", field="--shards", value=format_name, hint="give --format bop"
        )
    options = options or ExportOptions()
    accepted = [row.name for row in rows if row.stage == "accepted"]
    if not accepted:
        raise ToolkitError(
            "no scene is accepted",
            path=project.root,
            hint="see `std-curate project status`, and accept scenes with `project review`",
        )
    if not licence.strip():
        raise ToolkitError("needed", field="--licence", hint="such as CC-BY-4.0")
    scenes = {
        item.name: Scene.open(project.folder(item))
        for item in project.record.scenes
        if item.name in accepted
    }
    splits = assign_splits(accepted, shares, by)
    models = _common_models(scenes)
    numbers = {item.name: i for i, item in enumerate(project.record.scenes, 1)}
    own = {
        name: replace(
            options,
            split=cast(Split, split),
            scene_number=numbers[name],
            scene_name=name,
            model_ids=models,
            overwrite=True,  # of the part in the staging area
        )
        for split, names in splits.items()
        for name in names
    }
    digests = {n: export_digest(scenes[n], format_name, out, own[n]) for n in scenes}
    digest = digest_of(
        project.record.name, digests, splits, licence, by, list(shares.items()), shard_images
    )
    if (kept := _same(out, digest)) is not None:
        logger.info("%s: this data set already exists", out)
        return kept
    with staging_area(out, overwrite=options.overwrite, mark=DATASET) as staging:
        parts = []
        for name, scene in scenes.items():
            root = staging / PROGRESS / "scenes" / name
            sidecar = export_scene(scene, format_name, root, options=own[name], jobs=jobs)
            parts.append(_part(name, own[name], root, sidecar))
        _clear(staging)
        joined = _join(parts, staging)
        for split in splits if shard_images else ():
            shards = write_shards(staging / split, staging / f"{split}_web", images=shard_images)
            joined |= digest_files(staging, shards)
        dataset = Dataset(
            name=project.record.name,
            layout=format_name,
            tool=__version__,
            licence=licence,
            rule=_rule(shares, by),
            digest=digest,
            splits=splits,
            scenes=[p.row for p in parts],
            models=models_of([p.sidecar for p in parts]),
            labels=labels_of([p.sidecar for p in parts]),
            files=joined,
        )
        card = card_text(dataset).encode()
        write_bytes_atomic(staging / CARD, card)
        files = {**dataset.files, CARD: digest_bytes(card)}
        dataset = msgspec.structs.replace(dataset, files=dict(sorted(files.items())))
        write_document(staging / DATASET, dataset)
    return dataset


def _part(name: str, options: ExportOptions, root: Path, sidecar: Sidecar) -> _Part:
    prefix = "" if sidecar.layout in _JOINED else f"{options.split}/"
    if sidecar.layout not in (*_JOINED, "std"):
        prefix += f"{name}/"  # of a plug-in nothing is known but that one scene is complete
    row = DatasetScene(
        name=name,
        split=options.split,
        folder=f"{prefix}{sidecar.folder}",
        frames=len(sidecar.frames),
        objects=len(sidecar.objects.objects),
    )
    return _Part(row, root, _without_names(sidecar), prefix)


def _without_names(sidecar: Sidecar) -> Sidecar:
    """The sidecar without who labelled; a merged label names its annotators in two places."""
    labels = []
    for label in sidecar.labels.labels:
        provenance = label.provenance
        if provenance and any(
            n and n in provenance.refinement for n in label.annotator.split(", ")
        ):
            provenance = msgspec.structs.replace(provenance, refinement="")
        labels.append(msgspec.structs.replace(label, annotator="", provenance=provenance))
    return msgspec.structs.replace(sidecar, labels=Labels(labels=labels))


def _common_models(scenes: Mapping[str, Scene]) -> tuple[str, ...]:
    """Ids of the models with a label in any scene, sorted; their positions are BOP's numbers.

    Raises:
        ToolkitError: two scenes have different meshes or symmetries of one id.
    """
    first: dict[str, tuple[str, str]] = {}
    for name, scene in scenes.items():
        labelled = {scene.objects.object(x.object).model for x in scene.labels.labels}
        for model in scene.objects.models:
            if model.id not in labelled:
                continue
            content = digest_of(scene.mesh_digest(model.id), model.symmetry, model.category)
            other, known = first.setdefault(model.id, (name, content))
            if content != known:
                raise ToolkitError(
                    f"the model {model.id} has another mesh, symmetry or category than in {other}",
                    path=scene.root / "objects.json",
                    field="models",
                    value=model.id,
                    hint="use the mesh of the library in both, or rename the model",
                )
    return tuple(sorted(first))


def _same(out: Path, digest: str) -> Dataset | None:
    """The data set at `out` if it is complete and of this digest."""
    try:
        found = read_document(out / DATASET, Dataset)
    except ToolkitError:
        return None
    return found if found.digest == digest and not changed_files(out, found.files) else None


def _clear(staging: Path) -> None:
    """Remove what an interrupted run joined."""
    for path in staging.iterdir():
        if path.name != PROGRESS:
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _join(parts: Sequence[_Part], staging: Path) -> dict[str, str]:
    """Put the files of all parts in their places; returns the digest of each by its path.

    Raises:
        ToolkitError: two scenes write different files of one name.
    """
    files: dict[str, str] = {}
    joined: dict[str, Any] = {}
    for part in parts:
        own: dict[str, str] = {}
        for name, content in part.sidecar.files.items():
            target = part.prefix + name
            if name in _PER_SCENE:
                target = f"{part.row.folder}/{name}"
            elif part.sidecar.layout == "bop" and name in _BOP_JOINED:
                _add(joined, name, part)
                continue
            known = files.setdefault(target, content)
            if known != content:
                raise ToolkitError(
                    "two scenes write different files of this name",
                    path=target,
                    value=part.row.name,
                )
            own[name] = content
            if not (staging / target).exists():
                _link(part.root / name, staging / target)
        sidecar = document_bytes(msgspec.structs.replace(part.sidecar, files=own))
        files[f"{part.row.folder}/{SIDECAR_NAME}"] = digest_bytes(sidecar)
        write_bytes_atomic(staging / part.row.folder / SIDECAR_NAME, sidecar)
    for name, value in joined.items():
        data = record_lines(value)
        write_bytes_atomic(staging / name, data)
        files[name] = digest_bytes(data)
    return files


# Documents of a whole data set of BOP: models by number, the camera of the first scene, targets.
_BOP_JOINED = (
    "models/models_info.json",
    "models_eval/models_info.json",
    "camera.json",
    "test_targets_bop19.json",
    "test_targets_bop24.json",
)


def _add(joined: dict[str, Any], name: str, part: _Part) -> None:
    value = read_json(part.root / name)
    if name.startswith("test_targets"):
        if part.row.split != "train":
            name = name.replace("test", part.row.split, 1)
            joined[name] = [*joined.get(name, []), *value]
    elif name == "camera.json":
        joined.setdefault(name, value)
    else:
        joined.setdefault(name, {}).update(value)


def _link(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:  # the file system has no links
        shutil.copyfile(source, target)


def _rule(shares: Mapping[str, float], by: By) -> str:
    told = ", ".join(f"{split} {share:g}" for split, share in shares.items())
    how = {
        "name": "by a digest of its name: it stays in its split when scenes are added",
        "order": "in the order in which the scenes were added",
    }
    return f"whole scenes, never frames: {told} of the scenes; each is assigned {how[by]}"
