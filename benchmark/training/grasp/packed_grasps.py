"""Packed scenes of grasps as batches of tensors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from benchmark.methods.grasp.graspnet.cloud import GraspNetConfig, sampled
from benchmark.training.grasp import pack_files
from benchmark.training.grasp.tabletop import TableObject, look_at_table
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import read_document
from std_toolkit.io.foreign_files import read_npz

_ROWS = ("friction", "widths", "tolerances")
# Points of a frame that are read, for each that the network is shown: every step draws others.
_SHARE = 4
_EVERY = ("points", "object", "row", "row_object", *_ROWS)


class PackedGraspFrame(NamedTuple):
    """A frame's place and name; fields as of `PackedFrame`, but for `number`, the scene's."""

    pack: int
    number: int
    view: int
    scene: str
    name: str
    digest: str


@dataclass(frozen=True)
class PackKind:
    """What a training notes of a pack."""

    split: str
    root: str
    size: tuple[int, int]
    color: str = "none"


class PackedGrasps(Dataset[dict[str, Tensor]]):
    """The frames of packs; a batch is asked for by the list of its frames.

    A batch of b frames of n points, and R rows of known grasps of v views, a turns and d depths
    holds

    - cloud (b, n, 3) float32 metres, camera frame, in random order: more points than the network
      is shown at once,
    - object (b, n) int64: number of the point's object, -1 table,
    - row (b, n) int64: the point's row, -1 where its grasps are not known,
    - row_object (R,) int64: the row's object, numbered through all frames of the batch,
    - turned (O, 3, 3) float32: these objects' rotations to the camera,
    - friction, widths, tolerances (R, v, a, d) uint8, as in `SceneLabels`,
    - index (b,) int64.

    In a `DataLoader` give it a sampler of lists and `batch_size=None`.

    Args:
        folders: packs.
        config: of the network.

    Raises:
        ToolkitError: no pack, an empty one, or one of other views, turns or depths.
    """

    def __init__(self, folders: Sequence[Path], config: GraspNetConfig) -> None:
        self.folders, self.config = tuple(folders), config
        self.packs: list[pack_files.GraspPackSetup] = [
            pack_files.read_setup(folder) for folder in folders
        ]
        self.frames: list[PackedGraspFrame] = []
        self.scenes: dict[tuple[int, int], pack_files.SceneIndex] = {}
        for pack, (folder, setup) in enumerate(zip(folders, self.packs, strict=True)):
            for name in ("views", "angles", "depths"):
                if getattr(setup, name) != getattr(config, name):
                    raise ToolkitError(
                        f"the pack has {getattr(setup, name)}, the network {getattr(config, name)}",
                        path=folder,
                        field=name,
                    )
            self._list(pack, folder, setup)
        if not self.frames:
            raise ToolkitError("there is no packed scene", path=self.folders[0])
        self.size = self.packs[0].size
        self.setups = [
            PackKind(f"grasps of {p.assets} ({p.split}, {p.depth})", str(f.resolve()), p.size)
            for f, p in zip(folders, self.packs, strict=True)
        ]
        self._arrays: dict[tuple[int, int], dict[str, np.ndarray]] = {}

    def _list(self, pack: int, folder: Path, setup: pack_files.GraspPackSetup) -> None:
        numbers = sorted(int(path.stem.partition("-")[2]) for path in folder.glob("scene-*.json"))
        for number in numbers:
            index = read_document(pack_files.index_path(folder, number), pack_files.SceneIndex)
            self.scenes[pack, number] = index
            scene = f"{self._kind(setup)}: {index.seed}"
            self.frames += [
                PackedGraspFrame(pack, number, view, scene, str(view), frame.digest)
                for view, frame in enumerate(index.frames)
            ]

    @staticmethod
    def _kind(setup: pack_files.GraspPackSetup) -> str:
        """Scenes of one seed are the same only if they are drawn from the same."""
        return f"{setup.assets} {setup.split} {setup.objects} {setup.sizes}"

    def __len__(self) -> int:
        return len(self.frames)

    def check(self, chosen: Sequence[int]) -> None:
        """Check that the points of frames are those that were packed, by their digests.

        Raises:
            ToolkitError: a scene is damaged or was changed; names it.
        """
        for index in chosen:
            frame, view = self.frames[index], self._view(index)
            points = self._open(index)["points"][view.begin : view.end]
            if pack_files.digest_of_points(points) != frame.digest:
                raise ToolkitError(
                    "the packed points are not those that were packed",
                    path=pack_files.scene_folder(self.folders[frame.pack], frame.number),
                    value=f"view {frame.view}",
                    hint="delete the scene and its .json, run `std-train pack-grasps` again",
                )

    def scene(self, index: int) -> str:
        """Name of a frame's scene; equal names are the same scene."""
        return self.frames[index].scene

    def key(self, index: int) -> str:
        """Name of a frame."""
        return f"{self.frames[index].scene}/{self.frames[index].name}"

    def __getitem__(self, chosen: list[int]) -> dict[str, Tensor]:
        parts: dict[str, list[Any]] = {name: [] for name in ("cloud", "object")}
        rows: dict[str, list[Any]] = {name: [] for name in ("row", "row_object", "turned", *_ROWS)}
        begun, objects = 0, 0
        for index in chosen:
            arrays, at = self._open(index), self._points(index)
            parts["cloud"].append(torch.from_numpy(np.asarray(arrays["points"][at])))
            parts["object"].append(torch.from_numpy(arrays["object"][at].astype(np.int64)))
            row = np.asarray(arrays["row"][at])
            used = np.unique(row[row >= 0])
            own = np.where(row < 0, -1, begun + np.searchsorted(used, row))
            rows["row"].append(torch.from_numpy(own.astype(np.int64)))
            own = objects + arrays["row_object"][used].astype(np.int64)
            rows["row_object"].append(torch.from_numpy(own))
            for name in _ROWS:
                rows[name].append(torch.from_numpy(arrays[name][used]))
            turned = np.stack([T.R for T in self.poses(index)])
            rows["turned"].append(torch.from_numpy(turned).float())
            begun, objects = begun + len(used), objects + len(turned)
        found = {name: torch.stack(list_) for name, list_ in parts.items()}
        found["row"] = torch.stack(rows.pop("row"))
        found |= {name: torch.cat(list_) for name, list_ in rows.items()}
        return {**found, "index": torch.tensor(chosen)}

    def poses(self, index: int) -> list[SE3]:
        """T_cam_obj of a frame's objects."""
        frame = self.frames[index]
        T_cam_world = _pose(self._view(index).T_world_cam).inverse()
        known = self.scenes[frame.pack, frame.number].objects
        return [T_cam_world @ _pose(o.T_world_obj) for o in known]

    def objects(self, index: int) -> list[TableObject]:
        """The objects of a frame's scene.

        Raises:
            ToolkitError: their meshes cannot be read.
        """
        frame = self.frames[index]
        path = pack_files.scene_folder(self.folders[frame.pack], frame.number) / "meshes.npz"
        known = self.scenes[frame.pack, frame.number].objects
        try:
            kept = read_npz(path)
            meshes = [(kept[f"vertices{k}"], kept[f"faces{k}"]) for k in range(len(known))]
        except KeyError as error:
            raise ToolkitError(f"the meshes lack {error}", path=path) from error
        return [
            TableObject(
                o.name, v.astype(np.float64), f.astype(np.int64), _pose(o.T_world_obj), o.surface
            )
            for o, (v, f) in zip(known, meshes, strict=True)
        ]

    def T_world_cam(self, index: int) -> SE3:
        """Where a frame was seen from."""
        return _pose(self._view(index).T_world_cam)

    def look(self, index: int) -> Any:
        """The depth image that a frame's points were taken from, made again: a `Look`."""
        frame = self.frames[index]
        setup, seed = self.packs[frame.pack], self.scenes[frame.pack, frame.number].seed
        objects, T = self.objects(index), self.T_world_cam(index)
        return look_at_table(objects, setup.camera, T, setup.depth, (seed, frame.view))

    def _view(self, index: int) -> pack_files.PackedView:
        frame = self.frames[index]
        return self.scenes[frame.pack, frame.number].frames[frame.view]

    def _open(self, index: int) -> dict[str, np.ndarray]:
        frame = self.frames[index]
        place = frame.pack, frame.number
        if place not in self._arrays:
            folder = self.folders[frame.pack]
            self._arrays[place] = {
                n: pack_files.open_array(folder, frame.number, n) for n in _EVERY
            }
        return self._arrays[place]

    def _points(self, index: int) -> np.ndarray:
        """(n,) places of a frame's points in its scene's arrays, in an order of its own."""
        view = self._view(index)
        kept = min(self.packs[self.frames[index].pack].points, _SHARE * self.config.points)
        rng = np.random.default_rng(int(self.frames[index].digest, 16))
        return view.begin + sampled(view.end - view.begin, max(kept, self.config.points), rng)

    def __getstate__(self) -> dict[str, Any]:
        # Reading processes open the files themselves.
        return {**self.__dict__, "_arrays": {}}


def _pose(flat: Sequence[float]) -> SE3:
    return SE3.from_matrix(np.asarray(flat).reshape(4, 4))
