"""PhoCaL: household objects, glass and cutlery among them, by a polarisation camera on an arm.

<root>/sequence_1/rgb/000000.png, depth/, mask/
<root>/sequence_1/rgb_scene_gt.json            {frame: [{cam_R_m2c, cam_t_m2c, class_id, inst_id}]}
<root>/sequence_1/scene_camera.json            {"rgb": {fx, fy, cx, cy, depth_scale}}
<root>/sequence_1/train_test_split.npz         test_idxs: numbers of the frames for tests
<root>/class_obj_taxonomy.json                 {class_id: {class_name, objs: {inst_id: name}}}
<root>/obj_models_small_size/CLASS/NAME.obj    metres

Depth over `depth_scale` is in metres, and so are translations. A mask id is one more than the place
of the object in the frame's list. No true depth is published: it is rendered from the meshes at the
labels, and is 0 off the objects. Materials are not filed: objects of the classes glass and cutlery
count as transparent and specular.

Source: two readers of third parties; the authors published none. Not checked on the authors' files.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from benchmark.data.field.places import camera_of, object_pose, whole_number
from benchmark.data.field.source import (
    COLOR,
    MASK,
    RAW,
    FieldFrames,
    Files,
    Maps,
    known_ids,
    read_field_depth,
    read_ids,
    render_objects,
)
from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.data.labelled import MeshFile
from benchmark.data.loading import FrameIndex, SceneFolder
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.documents import read_document
from std_toolkit.io.foreign_files import read_npz

Part = Literal["train", "test"]

MODELS, OBJECTS = "obj_models_small_size", "class_obj_taxonomy.json"
_MATERIALS = {"glass": Material.TRANSPARENT, "cutlery": Material.SPECULAR}
_FOLDERS = {COLOR: "rgb/{}.png", RAW: "depth/{}.png", MASK: "mask/{}.png"}
_CAMERA, _LABELS, _SPLIT = "scene_camera.json", "rgb_scene_gt.json", "train_test_split.npz"


class _Label(msgspec.Struct, frozen=True):
    cam_R_m2c: Annotated[list[float], msgspec.Meta(min_length=9, max_length=9)]
    cam_t_m2c: Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
    class_id: int
    inst_id: int


class _Camera(msgspec.Struct, frozen=True):
    fx: float
    fy: float
    cx: float
    cy: float
    depth_scale: Annotated[float, msgspec.Meta(gt=0)]


class _Cameras(msgspec.Struct, frozen=True):
    rgb: _Camera


class _Class(msgspec.Struct, frozen=True):
    class_name: str
    objs: dict[str, str]


@dataclass(frozen=True)
class PhoCaL(FieldFrames):
    """Frames of some sequences.

    Attributes:
        root: of the set.
    """

    root: Path = Path()

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        return {what: Path(scene.path) / name.format(stem) for what, name in _FOLDERS.items()}

    def documents(self, scene: SceneFolder, stem: str) -> Files:
        top = Path(scene.path)
        try:
            meshes = {f"mesh {i}": mesh.path for i, mesh in self._meshes(scene, stem).items()}
        except ToolkitError:  # reading the frame says what is wrong with it
            meshes = {}
        return {
            "camera": top / _CAMERA, "labels": top / _LABELS, "objects": self.root / OBJECTS,
            **meshes,
        }  # fmt: skip

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:
        ids = read_ids(files[MASK])
        path = Path(scene.path) / _CAMERA
        c = read_document(path, _Cameras).rgb
        K = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])
        camera = camera_of(K, (ids.shape[1], ids.shape[0]), path)
        poses, meshes = self._poses(scene, stem), self._meshes(scene, stem)
        true, rendered = render_objects(camera, {i: (meshes[i], T) for i, T in poses.items()})
        mask = known_ids(ids, list(poses))
        true[rendered != mask] = 0
        instances = tuple(
            Instance(
                i, 0, _MATERIALS.get(mesh.path.parent.name, Material.RAW), mesh.path.parent.name,
                mesh.path.stem,
            )
            for i, mesh in meshes.items()
        )  # fmt: skip
        return Maps(true, mask, camera, instances)

    def raw(self, scene: SceneFolder, stem: str, path: Path) -> np.ndarray:  # noqa: ARG002
        """See `FieldFrames`; the unit is that of the sequence."""
        scale = read_document(Path(scene.path) / _CAMERA, _Cameras).rgb.depth_scale
        return read_field_depth(path, 1 / scale)

    def poses(self, index: int) -> dict[int, SE3]:
        """See `FieldFrames`."""
        return self._poses(*self.index.at(index))

    def meshes(self, index: int) -> dict[int, MeshFile]:
        """See `FieldFrames`."""
        return self._meshes(*self.index.at(index))

    def _poses(self, scene: SceneFolder, stem: str) -> dict[int, SE3]:
        path = Path(scene.path) / _LABELS
        return {
            i: object_pose(np.reshape(label.cam_R_m2c, (3, 3)), label.cam_t_m2c, path)
            for i, label in self._labels(scene, stem).items()
        }

    def _meshes(self, scene: SceneFolder, stem: str) -> dict[int, MeshFile]:
        path = self.root / OBJECTS
        classes = read_document(path, dict[str, _Class])
        found = {}
        for i, label in self._labels(scene, stem).items():
            known = classes.get(str(label.class_id))
            name = None if known is None else known.objs.get(str(label.inst_id))
            if known is None or name is None:
                raise ToolkitError(
                    "the labels have an object that this file has not", path=path,
                    field=str(label.class_id), value=label.inst_id,
                )  # fmt: skip
            for word in (known.class_name, name):
                if not word or "/" in word or "\\" in word or word.startswith("."):
                    raise ToolkitError("expected the name of a model", path=path, value=word[:60])
            folder = self.root / MODELS / known.class_name
            found[i] = MeshFile(folder / f"{name.removesuffix('.obj')}.obj")
        return found

    def _labels(self, scene: SceneFolder, stem: str) -> dict[int, _Label]:
        """Labels of a frame by mask id."""
        path = Path(scene.path) / _LABELS
        every = read_document(path, dict[str, list[_Label]])
        # Third parties read the number of the frame; names with zeros in front mean the same.
        mine = next((rows for key, rows in every.items() if whole_number(key) == int(stem)), None)
        if mine is None or len(mine) >= BACKGROUND:
            raise ToolkitError(f"no labels of 1 to {BACKGROUND - 1} objects", path=path, field=stem)
        return dict(enumerate(mine, start=1))


def open_phocal(name: str, root: Path, part: Part) -> PhoCaL:
    """List the frames of a part, which is told by each sequence.

    Args:
        name: of the split.
        root: folder of the sequences, or one above it.
        part: whose frames.

    Raises:
        ToolkitError: a sequence does not tell its parts.
    """
    tops = (root, *sorted(p for p in root.iterdir() if p.is_dir()))
    top = next((p for p in tops if any(p.glob("sequence_[0-9]*"))), root)
    scenes = []
    for folder in sorted(top.glob("sequence_[0-9]*"), key=lambda p: natural_key(p.name)):
        stems = {
            path.stem
            for kind in _FOLDERS.values()
            for path in folder.glob(kind.format("*"))
            if whole_number(path.stem) >= 0
        }
        path = folder / _SPLIT
        arrays = read_npz(path)
        if "test_idxs" not in arrays:
            raise ToolkitError("has no test_idxs", path=path, value=sorted(arrays))
        tests = {int(i) for i in np.ravel(arrays["test_idxs"])}
        mine = [s for s in stems if (int(s) in tests) == (part == "test")]
        if mine:
            ordered = tuple(sorted(mine, key=natural_key))
            scenes.append(SceneFolder(folder.name, str(folder), ordered))
    return PhoCaL(name, FrameIndex(tuple(scenes)), root=top)
