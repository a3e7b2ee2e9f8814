"""Packed frames as batches of tensors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from benchmark.data.frame import BACKGROUND, DepthFrame, Instance, Material
from benchmark.training import shards
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.io.documents import read_document
from std_toolkit.log import logger

_TENSORS = ("color", "raw", "true", "mask", "materials", "K")
_OF_POSES = ("nocs", "classes")


class PackedFrame(NamedTuple):
    """A frame's place and name.

    Attributes:
        pack: number of the pack.
        shard, row: its place there.
        scene, name: of the frame, in its split.
        digest: of its packed pixels.
    """

    pack: int
    shard: int
    row: int
    scene: str
    name: str
    digest: str


class PackedFrames(Dataset[dict[str, Tensor]]):
    """The frames of packs; a batch is asked for by the list of its frames.

    A batch holds color (b, h, w, 3) uint8 RGB, raw and true (b, h, w) float32 metres, mask
    (b, h, w) uint8, materials (b, 256) uint8, K (b, 3, 3) float32, as in `record_type`, and index
    (b,) int64; where every pack has NOCS, also nocs (b, h, w, 3) and classes (b, 256) uint8. In a
    `DataLoader` give it a sampler of lists and `batch_size=None`.

    Args:
        folders: packs, of one size.

    Raises:
        ToolkitError: no pack, one that is not finished or empty, or packs of several sizes.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        self.folders = tuple(folders)
        self.setups = tuple(shards.read_setup(folder) for folder in self.folders)
        self.frames: list[PackedFrame] = []
        self._counts: dict[tuple[int, int], int] = {}
        for pack, (folder, setup) in enumerate(zip(self.folders, self.setups, strict=True)):
            if setup.size != self.setups[0].size:
                raise ToolkitError(
                    "packs of several sizes", path=folder, field="size", value=setup.size
                )
            self._list(pack, folder, setup)
        if not self.frames:
            raise ToolkitError("the packs hold no frame", path=self.folders[0])
        self._open: dict[tuple[int, int], np.ndarray] = {}

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of all maps."""
        return self.setups[0].size

    @property
    def has_nocs(self) -> bool:
        """Whether every pack holds NOCS and classes."""
        return all(setup.nocs for setup in self.setups)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, frames: list[int]) -> dict[str, Tensor]:
        records = [self.record(i) for i in frames]
        batch = {
            name: torch.from_numpy(np.stack([record[name] for record in records]))
            for name in (*_TENSORS, *(_OF_POSES if self.has_nocs else ()))
        }
        batch |= {name: batch[name].float() for name in ("raw", "true")}
        return {**batch, "index": torch.tensor(frames)}

    def record(self, index: int) -> Any:
        """The record of a frame, mapped into memory."""
        place = self.frames[index]
        key = (place.pack, place.shard)
        if key not in self._open:
            folder, setup = self.folders[place.pack], self.setups[place.pack]
            self._open[key] = shards.open_shard(folder, place.shard, setup, self._counts[key])
        return self._open[key][place.row]

    def check(self, chosen: Sequence[int]) -> None:
        """Check that frames are those that were packed, by their digests; all bytes are read.

        Raises:
            ToolkitError: a shard is damaged or was changed; names the frame.
        """
        for index in chosen:
            frame = self.frames[index]
            if shards.digest_of_record(self.record(index)) != frame.digest:
                raise ToolkitError(
                    "the packed frame is not the one that was packed",
                    path=shards.shard_path(self.folders[frame.pack], frame.shard),
                    value=f"{frame.scene}/{frame.name}",
                    hint=shards.PACK_AGAIN,
                )

    def key(self, index: int) -> str:
        """A frame's name, for people."""
        frame = self.frames[index]
        return f"{self.folders[frame.pack].name}: {frame.scene}/{frame.name}"

    def scene(self, index: int) -> str:
        """Which scene a frame is of: the same in every pack of the same data."""
        frame = self.frames[index]
        setup = self.setups[frame.pack]
        return f"{setup.root}: {setup.split}: {frame.scene}"

    def frame(self, index: int) -> DepthFrame:
        """A frame as it was packed."""
        place, record = self.frames[index], self.record(index)
        w, h = self.size
        K = record["K"].astype(float)
        known = np.flatnonzero(record["materials"] != BACKGROUND)
        posed = self.setups[place.pack].nocs
        classes = record["classes"] if posed else np.zeros(256, np.uint8)
        return DepthFrame(
            scene=place.scene,
            name=place.name,
            color=np.array(record["color"]),
            depth_raw=record["raw"].astype(np.float32),
            depth_true=record["true"].astype(np.float32),
            mask=np.array(record["mask"]),
            camera=Camera(w, h, K[0, 0], K[1, 1], K[0, 2], K[1, 2]),
            instances=tuple(
                Instance(int(i), int(classes[i]), Material(int(record["materials"][i])))
                for i in known
            ),
            nocs=record["nocs"] / np.float32(255) if posed else None,
        )

    def __getstate__(self) -> dict[str, Any]:
        # A pickled map would be the whole file; every process maps for itself.
        return self.__dict__ | {"_open": {}}

    def _list(self, pack: int, folder: Path, setup: shards.PackSetup) -> None:
        failed = 0
        for shard in range(setup.shards):
            path = shards.index_path(folder, shard)
            if not path.exists():
                raise ToolkitError(
                    f"packing is not finished: {path.name} is missing",
                    path=folder,
                    hint=shards.PACK_AGAIN,
                )
            index = read_document(path, shards.ShardIndex)
            failed += len(index.failed)
            self._counts[pack, shard] = len(index.names)
            rows = zip(index.scenes, index.names, index.digests, strict=True)
            self.frames += [
                PackedFrame(pack, shard, row, *fields) for row, fields in enumerate(rows)
            ]
        if failed:
            logger.warning("%s: %d frames could not be packed and are left out", folder, failed)


def fitting_frames(folders: Sequence[Path], config: Any) -> PackedFrames:
    """The frames of packs for a network of this configuration, which may take any size.

    Raises:
        ToolkitError: no pack, or one of another size than the network's.
    """
    frames, size = PackedFrames(folders), getattr(config, "input_size", None)
    if size is not None and frames.size != size:
        raise ToolkitError(
            f"frames are packed at {frames.size[0]}x{frames.size[1]}, "
            f"the network works at {size[0]}x{size[1]}",
            path=frames.folders[0],
            hint=f"pack them with --size {size[0]} {size[1]}, "
            f"or train with --set input_size={frames.size[0]},{frames.size[1]}",
        )
    return frames


def fitting_frames_with_nocs(folders: Sequence[Path], config: Any) -> PackedFrames:
    """The same for a network that learns poses.

    Raises:
        ToolkitError: as `fitting_frames`, and packs that hold no NOCS.
    """
    frames = fitting_frames(folders, config)
    for folder, setup in zip(frames.folders, frames.setups, strict=True):
        if not setup.nocs:
            raise ToolkitError(
                "the packed frames hold no NOCS",
                path=folder,
                hint="pack them with `std-train pack --nocs`",
            )
    return frames


@dataclass(frozen=True)
class Data:
    """Frames to train on and frames to judge by."""

    training: PackedFrames
    of_training: Sequence[int]
    validation: PackedFrames
    of_validation: Sequence[int]
