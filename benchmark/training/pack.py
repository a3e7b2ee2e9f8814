"""Packs the frames of a split for training: resized once, then read without decoding."""

from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from benchmark.data.frame import BACKGROUND, DepthFrame, Material, resize_nearest
from benchmark.data.splits import names_digest, open_split
from benchmark.training import shards
from benchmark.training.options import PackOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path, sweep_temporaries
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.io.locks import hold_lock
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.jobs.artefact import begin, check_begun
from std_toolkit.jobs.outcome import error_of
from std_toolkit.log import logger

_WAYS = {"cubic": cv2.INTER_CUBIC, "area": cv2.INTER_AREA}


@dataclass(frozen=True)
class Packed:
    """What became of a split.

    Attributes:
        frames: in the pack now.
        failed: why frames are not, by `scene/name`, and shards that could not be written.
    """

    frames: int
    failed: dict[str, str]


def pack_split(
    folder: Path,
    split: str,
    root: Path,
    options: PackOptions | None = None,
    jobs: JobOptions | None = None,
) -> Packed:
    """Pack what is not packed yet; frames that could not be read are tried again.

    Raises:
        ToolkitError: no such data, or the folder holds another pack or something else.
    """
    options = options or PackOptions()
    source = open_split(split, root)
    setup = shards.PackSetup(
        split=split,
        root=str(root.resolve()),
        frames=len(source),
        frames_sha256=names_digest(source.keys()),
        **{field.name: getattr(options, field.name) for field in fields(PackOptions)},
    )
    check_begun(folder / shards.PACK, hint="choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    with hold_lock(folder, "lock", doing="packing into", what="folder"):
        begin(folder / shards.PACK, setup, what="this pack was", hint="choose another folder")
        sweep_temporaries(folder)
        left = [number for number in range(setup.shards) if not _is_whole(folder, number, setup)]
        report = run_jobs(
            partial(_pack_shard, folder, setup, root), left, name=f"pack {split}", options=jobs
        )
    frames, failed = 0, {f"shard {key}": error for key, error in report.failed.items()}
    for number in range(setup.shards):
        if shards.index_path(folder, number).exists():
            index = read_document(shards.index_path(folder, number), shards.ShardIndex)
            frames += len(index.names)
            failed |= index.failed
    return Packed(frames, failed)


def record_of(frame: DepthFrame, setup: shards.PackSetup) -> np.ndarray:
    """() the record of a frame.

    Raises:
        ToolkitError: NOCS is wanted of a frame that has none.
    """
    record = np.zeros((), shards.record_type(setup))
    if setup.color == "nearest":
        record["color"] = resize_nearest(frame.color, setup.size)
    else:
        record["color"] = cv2.resize(frame.color, setup.size, interpolation=_WAYS[setup.color])
    record["true"] = resize_nearest(frame.depth_true, setup.size)
    record["mask"] = resize_nearest(frame.mask, setup.size)
    materials = np.full(256, BACKGROUND, np.uint8)
    for instance in frame.instances:
        materials[instance.mask_id] = instance.material
    record["materials"] = materials
    if setup.raw == "cut":
        unmeasured = np.isin(materials, (Material.SPECULAR, Material.TRANSPARENT))
        record["raw"] = np.where(unmeasured[record["mask"]], 0, record["true"])
    else:
        record["raw"] = resize_nearest(frame.depth_raw, setup.size)
    record["K"] = frame.camera.resized(*setup.size).K
    if setup.nocs:
        if frame.nocs is None:
            raise ToolkitError("the frame has no NOCS map", path=frame.key, hint="pack it without")
        record["nocs"] = np.rint(255 * resize_nearest(frame.nocs, setup.size))
        classes = np.full(256, BACKGROUND, np.uint8)
        for instance in frame.instances:
            classes[instance.mask_id] = instance.class_id
        record["classes"] = classes
    return record


def _is_whole(folder: Path, number: int, setup: shards.PackSetup) -> bool:
    """Whether a shard needs not be packed: no frame failed, and it holds what was packed."""
    path = shards.index_path(folder, number)
    if not path.exists():
        return False
    try:
        index = read_document(path, shards.ShardIndex)
        records = shards.open_shard(folder, number, setup, len(index.names))
    except ToolkitError as error:
        logger.warning("%s; packed again", error)
        return False
    if [shards.digest_of_record(r) for r in records] != index.digests:
        logger.warning("%s: was changed; packed again", shards.shard_path(folder, number))
        return False
    return not index.failed


def _pack_shard(folder: Path, setup: shards.PackSetup, root: Path, number: int) -> int:
    source = open_split(setup.split, root)
    keys = source.keys()
    cv2.setNumThreads(1)
    index = shards.ShardIndex(scenes=[], names=[], digests=[], failed={})
    records = []
    for i in range(number * setup.shard, min((number + 1) * setup.shard, setup.frames)):
        try:
            record = record_of(source.load(i, nocs=setup.nocs), setup)
        except Exception as error:  # a damaged file can raise anything in the libraries below
            index.failed[str(keys[i])] = error_of(error).error or type(error).__name__
            continue
        records.append(record)
        index.scenes.append(keys[i].scene)
        index.names.append(keys[i].name)
        index.digests.append(shards.digest_of_record(record))
    # An earlier index must not vouch for the new records.
    shards.index_path(folder, number).unlink(missing_ok=True)
    with atomic_path(shards.shard_path(folder, number)) as temporary:
        np.save(temporary, np.array(records, shards.record_type(setup)))
    write_document(shards.index_path(folder, number), index)
    return len(records)
