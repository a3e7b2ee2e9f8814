"""HouseCat6D: household objects, glass and cutlery among them, by a polarisation camera.

<root>/scene01/rgb/000000.png, depth/, instance/, pol/, labels/000000_label.pkl
<root>/scene01/intrinsics.txt                  3x3
<root>/scene01/meta.txt                        instance_id class_id CLASS-NAME
<root>/obj_models_small_size_final/CLASS/CLASS-NAME.obj       metres, centred

Depth is in millimetres in the colour camera; ids are in the red channel of `instance`. Labels are
pickles: they are read without running them. No true depth is published: it is rendered from the
meshes at the labels, and is 0 off the objects. Materials are not filed: objects of the classes
glass and cutlery count as transparent and specular.

Source: README, `visualization/` and `VI-Net/provider/housecat6d_dataset.py` of
github.com/Junggy/HouseCat6D.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.places import camera_of, object_pose, whole_number
from benchmark.data.field.source import (
    COLOR,
    MASK,
    RAW,
    FieldFrames,
    Files,
    Maps,
    known_ids,
    read_ids,
    render_objects,
)
from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.data.labelled import MeshFile
from benchmark.data.loading import FrameIndex, SceneFolder
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.plain_pickle import array_in, read_pickle
from std_toolkit.io.regular import read_text

CLASSES = (
    "box", "bottle", "can", "cup", "remote", "teapot", "cutlery", "glass", "shoe", "tube"
)  # fmt: skip
MODELS = "obj_models_small_size_final"
_MATERIALS = {"glass": Material.TRANSPARENT, "cutlery": Material.SPECULAR}
_LABEL = "label"
_FOLDERS = {COLOR: "rgb/{}.png", RAW: "depth/{}.png", MASK: "instance/{}.png",
            _LABEL: "labels/{}_label.pkl"}  # fmt: skip
_LARGEST_TEXT = 2**20


@dataclass(frozen=True)
class _Named:
    """An object of a scene: its class, and its name."""

    category: str
    model: str


@dataclass(frozen=True)
class HouseCat6D(FieldFrames):
    """Frames of some scenes.

    Attributes:
        root: of the set.
    """

    root: Path = Path()

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        return {what: Path(scene.path) / name.format(stem) for what, name in _FOLDERS.items()}

    def documents(self, scene: SceneFolder, stem: str) -> Files:  # noqa: ARG002
        top = Path(scene.path)
        meshes = {f"mesh of {o.model}": self._mesh(o) for o in self._objects(scene).values()}
        return {"intrinsics": top / "intrinsics.txt", "objects": top / "meta.txt", **meshes}

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:  # noqa: ARG002
        ids = read_ids(files[MASK], channel=0)
        path = Path(scene.path) / "intrinsics.txt"
        try:
            K = np.loadtxt(path, dtype=np.float64)
        except (OSError, ValueError) as error:
            raise ToolkitError("no 3x3 matrix", path=path) from error
        camera = camera_of(K, (ids.shape[1], ids.shape[0]), path)
        objects, poses = self._objects(scene), _labels(files[_LABEL])
        unknown = [i for i in poses if i not in objects]
        if unknown:
            raise ToolkitError(
                "the labels have an instance that meta.txt has not", path=files[_LABEL],
                field="instance_ids", value=unknown[0],
            )  # fmt: skip
        placed = {i: (MeshFile(self._mesh(objects[i])), T) for i, T in poses.items()}
        true, rendered = render_objects(camera, placed)
        mask = known_ids(ids, list(poses))
        true[rendered != mask] = 0
        instances = tuple(
            Instance(
                i, 0, _MATERIALS.get(objects[i].category, Material.RAW), objects[i].category,
                objects[i].model,
            )
            for i in poses
        )  # fmt: skip
        return Maps(true, mask, camera, instances)

    def poses(self, index: int) -> dict[int, SE3]:
        """See `FieldFrames`; axes of the meshes as filed, which are not those of NOCS."""
        scene, stem = self.index.at(index)
        return _labels(self.paths(scene, stem)[_LABEL])

    def meshes(self, index: int) -> dict[int, MeshFile]:
        """See `FieldFrames`."""
        scene, _ = self.index.at(index)
        return {i: MeshFile(self._mesh(named)) for i, named in self._objects(scene).items()}

    def _mesh(self, named: _Named) -> Path:
        return self.root / MODELS / named.category / f"{named.model}.obj"

    def _objects(self, scene: SceneFolder) -> dict[int, _Named]:
        path = Path(scene.path) / "meta.txt"
        found = {}
        for number, line in enumerate(read_text(path, "list", _LARGEST_TEXT).splitlines(), 1):
            words = line.split()
            if not words:
                continue
            mask_id, class_of = map(whole_number, (*words, "")[:2])
            right = len(words) == 3 and 0 <= mask_id < BACKGROUND
            if not right or not 1 <= class_of <= len(CLASSES) or "/" in words[2]:
                raise ToolkitError(
                    "expected instance_id class_id CLASS-NAME", path=path, field=f"line {number}",
                    value=line[:60],
                )  # fmt: skip
            found[mask_id] = _Named(CLASSES[class_of - 1], words[2])
        return found


def _labels(path: Path) -> dict[int, SE3]:
    """Poses by instance id; row i of the arrays is the i-th of `instance_ids`."""
    document: Any = read_pickle(path)

    def array(field: str) -> NDArray[np.float64]:
        if not isinstance(document, dict):
            raise ValueError
        return array_in(document[field], path, field)

    try:
        ids = array("instance_ids").ravel()
        R = array("rotations").reshape(-1, 3, 3)
        t = array("translations").reshape(-1, 3)
    except (KeyError, ValueError) as error:
        raise ToolkitError(
            "expected instance_ids, rotations (n, 3, 3) and translations (n, 3)", path=path
        ) from error
    if not len(ids) == len(R) == len(t):
        raise ToolkitError(f"{len(ids)} ids, {len(R)} rotations, {len(t)} translations", path=path)
    if not ((ids >= 0) & (ids < BACKGROUND) & (ids % 1 == 0)).all() or len(set(ids)) < len(ids):
        raise ToolkitError(
            f"expected ids below {BACKGROUND}, each once", path=path, field="instance_ids",
            value=ids.tolist()[:20],
        )  # fmt: skip
    return {int(i): object_pose(R[k], t[k], path) for k, i in enumerate(ids)}


def open_housecat(name: str, root: Path, part: str) -> HouseCat6D:
    """List the frames of a part: `train`, `val` or `test`.

    Args:
        name: of the split.
        root: folder of the scenes, or one above it.
        part: whose scenes.
    """
    prefix = "scene" if part == "train" else f"{part}_scene"
    tops = (root, *sorted(p for p in root.iterdir() if p.is_dir()))
    top = next((p for p in tops if any(p.glob(f"{prefix}[0-9]*"))), root)
    scenes = []
    for folder in sorted(top.glob(f"{prefix}[0-9]*"), key=lambda p: natural_key(p.name)):
        stems = {
            path.name.removesuffix(name.partition("{}")[2])
            for name in _FOLDERS.values()
            for path in folder.glob(name.format("*"))
        }
        if stems:
            ordered = tuple(sorted(stems, key=natural_key))
            scenes.append(SceneFolder(folder.name, str(folder), ordered))
    return HouseCat6D(name, FrameIndex(tuple(scenes)), root=top)
