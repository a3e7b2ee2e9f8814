"""TRansPose: 99 transparent objects by two RGB-D cameras and a thermal one on an arm.

<root>/sequences/[train/|test/]SEQUENCE/cam_R/rgb/000001.png
.../cam_R/depth/raw/000001.png, fixed/, rendered/        millimetres: sensor, repaired, truth
.../cam_R/mask/000001_000003.png                          frame and place in its list, not the model
.../cam_R/pose/000001.json                                by place: obj_id, obj_name, rot, tra
.../cam_R/camera_info.json                                "intrinsic": 9 numbers
.../extrinsic.json, World2EEs.json                        cameras from the hand, the hand by frame
<root>/models/NAME/NAME.obj

The test part is downloaded as seq_test_NN/sequences/seq_test_NN/. The thermal images are not read.
The unit of `tra` is not stated: it is told by how far the objects are, logged, and one in a
sequence.

Source: a loader for depth completion, a reader of poses, a converter to BOP and a program that
aligns the thermal images, of four third parties; the authors published none. Not checked on the
authors' files.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.data.field.places import camera_of, pose_of, unit_of_place, whole_number
from benchmark.data.field.source import (
    COLOR,
    RAW,
    TRUTH,
    FieldFrames,
    Files,
    Maps,
    read_field_depth,
    read_ids,
)
from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.data.labelled import MeshFile
from benchmark.data.loading import SceneFolder, check_same_size, index_of
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.documents import read_document

Side = Literal["right", "left"]
Part = Literal["train", "test"]

OBJECTS = 99
_CAMERA = {"right": "cam_R", "left": "cam_L"}
_LABELS = "poses"
_FOLDERS = {
    COLOR: "rgb/{}.png", RAW: "depth/raw/{}.png", TRUTH: "depth/rendered/{}.png",
    _LABELS: "pose/{}.json",
}  # fmt: skip
_DEEPEST = 5

_Nine = Annotated[list[float], msgspec.Meta(min_length=9, max_length=9)]
_Three = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
_Sixteen = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]


class _Object(msgspec.Struct, frozen=True):
    rot: _Nine
    tra: _Three
    obj_name: str


class _Info(msgspec.Struct, frozen=True):
    intrinsic: _Nine


class _Extrinsic(msgspec.Struct, frozen=True):
    T_EE2cam_R: _Sixteen | None = None
    T_EE2cam_L: _Sixteen | None = None


class _Hand(msgspec.Struct, frozen=True):
    rot: _Nine
    tra: _Three


@dataclass(frozen=True)
class TRansPose(FieldFrames):
    """Frames of one RGB-D camera; a mask id is the place of the object in the frame's list.

    Attributes:
        side: the camera.
        models: folder of the meshes.
    """

    side: Side = "right"
    models: Path = Path()

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        top = Path(scene.path) / _CAMERA[self.side]
        files = {what: top / name.format(stem) for what, name in _FOLDERS.items()}
        try:
            places = list(_objects(files[_LABELS]))
        except ToolkitError:  # reading the frame says what is wrong with it
            places = []
        return files | {f"mask {i}": top / f"mask/{stem}_{i:06d}.png" for i in places}

    def documents(self, scene: SceneFolder, stem: str) -> Files:  # noqa: ARG002
        return {"camera": self._info(scene)}

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:  # noqa: ARG002
        true = read_field_depth(files[TRUTH], self.unit)
        objects = _objects(files[_LABELS])
        mask = np.full(true.shape, BACKGROUND, np.uint8)
        for i in objects:
            inside = read_ids(files[f"mask {i}"])
            check_same_size(files[f"mask {i}"], inside, true, "mask")
            mask[inside > 0] = i
        K = np.reshape(read_document(self._info(scene), _Info).intrinsic, (3, 3))
        camera = camera_of(K, (true.shape[1], true.shape[0]), self._info(scene))
        instances = tuple(
            Instance(i, 0, Material.TRANSPARENT, model=o.obj_name) for i, o in objects.items()
        )
        return Maps(true, mask, camera, instances)

    def poses(self, index: int) -> dict[int, SE3]:
        """See `FieldFrames`; `rot` is row by row."""
        scene, stem = self.index.at(index)
        path = Path(scene.path) / _CAMERA[self.side] / _FOLDERS[_LABELS].format(stem)
        found = {}
        for i, o in _objects(path).items():
            t = np.array(o.tra) * unit_of_place(o.tra, path, Path(scene.path))
            found[i] = pose_of(np.reshape(o.rot, (3, 3)), t, path)
        return found

    def meshes(self, index: int) -> dict[int, MeshFile]:
        """See `FieldFrames`."""
        scene, stem = self.index.at(index)
        path = Path(scene.path) / _CAMERA[self.side] / _FOLDERS[_LABELS].format(stem)
        return {
            i: MeshFile(self.models / o.obj_name / f"{o.obj_name}.obj")
            for i, o in _objects(path).items()
        }

    def camera_pose(self, index: int) -> SE3 | None:
        """Return the pose of the hand times that of the camera in it, in the arm's frame.

        The units are not stated. An arm reaches less than 10 m, and its hand is not within 10 mm of
        its base; a camera is less than a metre from the hand, and not within a millimetre.
        """
        scene, stem = self.index.at(index)
        hand, fixed = Path(scene.path) / "World2EEs.json", Path(scene.path) / "extrinsic.json"
        if not (hand.is_file() and fixed.is_file()):
            return None
        extrinsic = read_document(fixed, _Extrinsic)
        mounted = extrinsic.T_EE2cam_R if self.side == "right" else extrinsic.T_EE2cam_L
        at = read_document(hand, dict[str, _Hand]).get(stem)
        if mounted is None or at is None:
            return None
        T = np.reshape(mounted, (4, 4))
        T_world_hand = pose_of(np.reshape(at.rot, (3, 3)), _metres(at.tra, 10), hand)
        return T_world_hand @ pose_of(T[:3, :3], _metres(T[:3, 3], 1), fixed)

    def notes(self) -> Sequence[str]:
        """See `FieldFrames`."""
        meshes = sum(1 for _ in self.models.glob("*/*.obj"))
        return (f"meshes: {meshes} here; the set has {OBJECTS} objects",)

    def _info(self, scene: SceneFolder) -> Path:
        return Path(scene.path) / _CAMERA[self.side] / "camera_info.json"


def _metres(t: ArrayLike, farthest_m: float) -> NDArray[np.float64]:
    """A translation in metres: numbers beyond what it can be in metres are millimetres."""
    found = np.asarray(t, np.float64)
    return found if np.linalg.norm(found) < farthest_m else found / 1000


def _objects(path: Path) -> dict[int, _Object]:
    """Objects of a frame by their place in the list."""
    found = {}
    for key, item in read_document(path, dict[str, _Object]).items():
        if not 0 <= whole_number(key) < BACKGROUND:
            raise ToolkitError(f"expected a number below {BACKGROUND}", path=path, field=key)
        if not item.obj_name or "/" in item.obj_name or item.obj_name.startswith("."):
            raise ToolkitError(
                "expected the name of a model", path=path, field=f"{key}.obj_name",
                value=item.obj_name[:60],
            )  # fmt: skip
        found[int(key)] = item
    return dict(sorted(found.items()))


def open_transpose(name: str, root: Path, side: Side, part: Part) -> TRansPose:
    """List the frames of a camera.

    Args:
        name: of the split.
        root: folder of the set, or one above it.
        side: the camera.
        part: `test` are the sequences in a folder `test` or named seq_test_NN, `train` all others.
    """
    camera, scenes = _CAMERA[side], []
    for folder in sorted(_sequences(root, camera, _DEEPEST), key=lambda p: natural_key(str(p))):
        words = folder.relative_to(root).parts
        is_test = any(w == "test" or w.startswith("seq_test") for w in words or (folder.name,))
        if is_test != (part == "test"):
            continue
        stems = {
            path.stem
            for kind in _FOLDERS.values()
            for path in (folder / camera / Path(kind).parent).glob(f"*{Path(kind).suffix}")
        }
        if stems:
            ordered = tuple(sorted(stems, key=natural_key))
            scenes.append((folder, ordered))
    return TRansPose(name, index_of(root, scenes), side=side, models=_models(root))


def _sequences(folder: Path, camera: str, depth: int) -> Iterator[Path]:
    if (folder / camera).is_dir():
        yield folder
        return
    if depth == 0 or folder.name == "models":
        return
    with os.scandir(folder) as entries:
        below = sorted(folder / e.name for e in entries if e.is_dir())
    for path in below:
        yield from _sequences(path, camera, depth - 1)


def _models(root: Path) -> Path:
    places = (root, *root.glob("*/"), *root.glob("*/*/"))
    return next((p / "models" for p in places if (p / "models").is_dir()), root / "models")
