"""Shards of an exported BOP split, in the form BOP-webdataset.

`SPLIT_web/shard-NNNNNN.tar` has files SCENE_IMAGE.PART of some images: rgb.png, depth.png,
camera.json, gt.json, gt_info.json, and mask.json and mask_visib.json with run lengths by the index
of the object. `key_to_shard.json` tells in which shard an image is.

Source: bop_toolkit, `bop_toolkit_lib/dataset/bop_webdataset.py` and `bop_imagewise.py`.
"""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit.exporters.bop_exporter import run_lengths
from std_toolkit.io.atomic import atomic_path, write_bytes_atomic
from std_toolkit.io.foreign_files import read_json
from std_toolkit.io.images import read_png

INDEX = "key_to_shard.json"
# Readers take images in the order of the shards: neighbours must not be frames of one recording.
_SEED = 0


def write_shards(split: Path, out: Path, *, images: int) -> list[Path]:
    """Write the shards of a split.

    The same split gives the same bytes. Images are shuffled.

    Args:
        split: folder with scene folders, from `std-curate export` with the layout bop.
        out: folder of the shards.
        images: most images of a shard.

    Returns:
        The files, in order; the index is the last one.
    """
    found = [
        (scene, int(stem))
        for scene in sorted(p.parent for p in split.glob("*/scene_camera.json"))
        for stem in sorted(read_json(scene / "scene_camera.json"), key=int)
    ]
    order = np.random.default_rng(_SEED).permutation(len(found))
    documents: dict[Path, dict[str, Any]] = {}
    index: dict[str, int] = {}
    files = []
    out.mkdir(parents=True, exist_ok=True)
    for shard in range(-(-len(found) // images)):
        path = out / f"shard-{shard:06d}.tar"
        with atomic_path(path) as temporary, tarfile.open(temporary, mode="w") as archive:
            for place in order[shard * images : (shard + 1) * images]:
                scene, image = found[place]
                if scene not in documents:
                    documents[scene] = {
                        part: read_json(scene / f"scene_{part}.json")
                        for part in ("camera", "gt", "gt_info")
                    }
                key = f"{int(scene.name):06d}_{image:06d}"
                index[key] = shard
                for part, data in _parts(scene, image, documents[scene]):
                    entry = tarfile.TarInfo(f"{key}.{part}")
                    entry.size = len(data)
                    archive.addfile(entry, BytesIO(data))
        files.append(path)
    write_bytes_atomic(out / INDEX, _json(dict(sorted(index.items()))))
    return [*files, out / INDEX]


def _parts(scene: Path, image: int, documents: dict[str, Any]) -> Iterator[tuple[str, bytes]]:
    """The files of an image and their ends."""
    stem = f"{image:06d}"
    yield "rgb.png", (scene / "rgb" / f"{stem}.png").read_bytes()
    depth = scene / "depth" / f"{stem}.png"
    if depth.is_file():
        yield "depth.png", depth.read_bytes()
    for part, rows in documents.items():
        yield f"{part}.json", _json(rows[str(image)])
    for kind in ("mask", "mask_visib"):
        masks = {
            str(i): run_lengths(read_png(scene / kind / f"{stem}_{i:06d}.png").astype(bool))
            for i in range(len(documents["gt"][str(image)]))
        }
        yield f"{kind}.json", _json(masks)


def _json(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode()
