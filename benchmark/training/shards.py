"""Packed frames on disk: shards of records that are memory-mapped.

<pack>/pack.json          what was packed, and how
<pack>/shard-00000.npy    array of records, one per frame, all of one size
<pack>/shard-00000.json   names of the frames; written last, when the shard is complete
"""

import hashlib
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from benchmark.training.options import ColorWay, DepthKind, RawKind
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import InvalidDocument, read_document
from std_toolkit.io.foreign_files import mapped_npy

PACK = "pack.json"
PACK_AGAIN = "run the same `std-train pack` again"


Side = Annotated[int, msgspec.Meta(ge=1, le=16384)]


class PackSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What decides what is in a pack; it goes on only with the same.

    Attributes:
        split, root: name of the split and folder of its data.
        frames, frames_sha256: number of frames of the split, and a hash over their names.
        size: (width, height) of all maps.
        depth: type of numbers of depth.
        color: how colour was resized.
        shard: frames per shard.
        nocs: whether records hold NOCS and classes; packs of before had neither.
        raw: what raw depth is, see `PackOptions`; packs of before have the sensor's.
    """

    split: str
    root: str
    frames: Annotated[int, msgspec.Meta(ge=0, le=10**9)]
    frames_sha256: str
    size: tuple[Side, Side]
    depth: DepthKind
    color: ColorWay
    shard: Annotated[int, msgspec.Meta(ge=1)]
    nocs: bool = False
    raw: RawKind = "sensor"
    format: int = 1

    @property
    def shards(self) -> int:
        return -(-self.frames // self.shard)


class ShardIndex(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is in a shard.

    Attributes:
        scenes, names, digests: of its frames, in order; a digest is of the packed pixels.
        failed: why frames are not in it, by `scene/name`.
    """

    scenes: list[str]
    names: list[str]
    digests: list[str]
    failed: dict[str, str]

    def __post_init__(self) -> None:
        if not len(self.scenes) == len(self.names) == len(self.digests):
            raise InvalidDocument("scenes, names and digests are of different lengths")


def record_type(setup: PackSetup) -> np.dtype[np.void]:
    """A frame's record.

    color (h, w, 3) uint8 RGB; raw, true (h, w) metres, 0 = none; mask (h, w) uint8 instance ids,
    255 elsewhere; materials (256,) uint8 `Material` by instance id, 255 for ids that there are
    not; K (3, 3) float32 intrinsics at this size.

    With NOCS also: nocs (h, w, 3) uint8, round(255 x), x y z not flipped, 0 in the background;
    classes (256,) uint8 class by instance id, 255 for ids that there are not.
    """
    w, h = setup.size
    fields: list[tuple[Any, ...]] = [
        ("color", "u1", (h, w, 3)),
        ("raw", setup.depth, (h, w)),
        ("true", setup.depth, (h, w)),
        ("mask", "u1", (h, w)),
        ("materials", "u1", (256,)),
        ("K", "f4", (3, 3)),
    ]
    if setup.nocs:
        fields += [("nocs", "u1", (h, w, 3)), ("classes", "u1", (256,))]
    return np.dtype(fields)


def shard_path(folder: Path, number: int) -> Path:
    return folder / f"shard-{number:05d}.npy"


def index_path(folder: Path, number: int) -> Path:
    return shard_path(folder, number).with_suffix(".json")


def read_setup(folder: Path) -> PackSetup:
    """What a folder of packed frames holds.

    Raises:
        ToolkitError: it is none.
    """
    if not (folder / PACK).is_file():
        raise ToolkitError(
            "is no folder of packed frames",
            path=folder,
            hint=f"make one: std-train pack {folder} --split NAME --data ROOT",
        )
    return read_document(folder / PACK, PackSetup)


def open_shard(folder: Path, number: int, setup: PackSetup, frames: int) -> np.ndarray:
    """(n,) records of a shard, mapped into memory.

    Raises:
        ToolkitError: the file is missing, cut off or another's.
    """
    path = shard_path(folder, number)
    if not frames:
        return np.empty(0, record_type(setup))
    try:
        found = mapped_npy(path, record_type(setup))
    except ToolkitError as error:
        raise error.revised(
            problem=f"the shard cannot be read: {error.problem}", hint=PACK_AGAIN
        ) from error
    if found.shape != (frames,):
        raise ToolkitError(
            "the shard is not what pack.json and its own .json say",
            path=path,
            value=(found.shape, frames),
            hint=PACK_AGAIN,
        )
    return found


def digest_of_record(record: np.ndarray) -> str:
    """Digest of the packed pixels of a frame."""
    return hashlib.blake2b(record.tobytes(), digest_size=8).hexdigest()
