"""REAL275 and CAMERA25, the sets of NOCS: poses and sizes of six classes.

<root>/Real/test/scene_1/0000_color.png, _depth.png, _mask.png, _coord.png, _meta.txt
<root>/CAMERA/val/00000/0000_color.png, ...
<root>/obj_models/real_test/NAME.obj, real_val/NAME_norm.obj; SPLIT/SYNSET/MODEL/model.obj
<root>/gts/real_test/results_real_test_scene_1_0000.pkl, gts/val/results_val_00000_0000.pkl

Depth is in millimetres; a colour image of it means green * 256 + red, and 32001 is nothing. Ids are
in the red channel of the mask, 255 off the objects. Coordinates have a flipped z. A line of the
list of objects is `instance class name`, or of synthetic objects `instance class synset model`,
whose meshes have a flipped z; class 0 is no object.

Labels are similarities that place the normalised mesh: row k of the pickle is the k-th smallest id
of the mask that is an object. Pickles are read without running them. Where there is none, the
similarity is fitted to coordinates and depth, as the authors do. No true depth is published: it is
rendered from the meshes at the labels, and is 0 off the objects.

Source: `dataset.py`, `detect_eval.py` of github.com/hughw19/NOCS_CVPR2019.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.places import whole_number
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
from benchmark.data.frame import BACKGROUND, OTHER, Instance, Material
from benchmark.data.labelled import MeshFile
from benchmark.data.loading import FrameIndex, SceneFolder, read_coord_picture
from benchmark.data.true_poses import LEAST_PIXELS, KnownBox, mesh_handle
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Similarity, ransac_similarity, unproject_depth
from std_toolkit.geometry.mesh import mesh_extents
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.importers.nocs_importer import CAMERA25, REAL275
from std_toolkit.io.plain_pickle import array_in, read_pickle
from std_toolkit.io.regular import read_text
from std_toolkit.scene.model import CATEGORY_CLASS_IDS

Set = Literal["Real", "CAMERA"]

CLASSES = ("bottle", "bowl", "camera", "can", "laptop", "mug")
_CAMERAS = {"Real": REAL275, "CAMERA": CAMERA25}
# Folders of gts/, where the authors publish labels.
_PICKLED = {("Real", "test"): "real_test", ("CAMERA", "val"): "val"}
_COORDINATES, _META = "coordinates", "list of objects"
_SUFFIXES = {COLOR: "color.png", RAW: "depth.png", MASK: "mask.png", _COORDINATES: "coord.png",
             _META: "meta.txt"}  # fmt: skip
_LARGEST_TEXT = 2**20
_KEPT_FRAMES = 2
# Millimetres and 8-bit coordinates are 1 to 2 mm off; a sensor's errors at edges are larger.
_INLIER_M = 0.01
# A similarity that is filed has equal axes; float32 is exact to 1e-6.
_UNEQUAL = 1e-3


@dataclass(frozen=True)
class _Listed:
    """An object of a frame's list.

    Attributes:
        category: name of its class.
        model: name of its mesh.
        mesh: file of it.
        mirrored: whether its z is flipped.
    """

    category: str
    model: str
    mesh: Path
    mirrored: bool


@dataclass(frozen=True)
class _Label:
    """Where an object is: its similarity to the camera, and a mug's handle as filed."""

    placed: Similarity
    handle_visible: bool | None = None


@dataclass(frozen=True)
class NocsFrames(FieldFrames):
    """Frames of a part of one of the two sets.

    Attributes:
        data: the set.
        part: folder of the scenes.
        top: folder of the set, beside `obj_models` and `gts`.
    """

    data: Set = "Real"
    part: str = "test"
    top: Path = Path()

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        return {what: Path(scene.path) / f"{stem}_{name}" for what, name in _SUFFIXES.items()}

    def documents(self, scene: SceneFolder, stem: str) -> Files:
        listed = self._listed(self.paths(scene, stem)[_META])
        found = {f"mesh of {i}": one.mesh for i, one in listed.items()}
        pickled = self._pickle(scene, stem)
        return found | ({} if pickled is None else {"labels": pickled})

    def raw(self, scene: SceneFolder, stem: str, path: Path) -> NDArray[np.float32]:  # noqa: ARG002
        """See `FieldFrames`; also from two bytes in the colours of an image."""
        return read_field_depth(path, self.unit, two_bytes=True)

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:
        camera, listed = _CAMERAS[self.data], self._listed(files[_META])
        mask = self._mask(files[MASK], listed)
        meshes = self._meshes(scene, stem)
        placed = {
            i: (meshes[i], SE3(label.placed.R, label.placed.t))
            for i, label in self._labels(scene, stem).items()
        }
        true, rendered = render_objects(camera, placed)
        true[(rendered != mask) | (mask == BACKGROUND)] = 0
        instances = tuple(
            Instance(i, _class_id(one.category), Material.RAW, one.category, one.model)
            for i, one in listed.items()
        )
        return Maps(true, mask, camera, instances)

    def coordinates(
        self, scene: SceneFolder, stem: str, mask: NDArray[np.uint8]
    ) -> NDArray[np.float32]:
        """See `FieldFrames`."""
        return read_coord_picture(self.paths(scene, stem)[_COORDINATES], mask)

    def poses(self, index: int) -> dict[int, SE3]:
        """See `FieldFrames`; of the centre of the mesh, with the axes of NOCS."""
        labels = self._labels(*self.index.at(index))
        return {i: SE3(one.placed.R, one.placed.t) for i, one in labels.items()}

    def meshes(self, index: int) -> dict[int, MeshFile]:
        """See `FieldFrames`; scaled to the label's size."""
        return self._meshes(*self.index.at(index))

    def known_boxes(self, index: int) -> dict[int, KnownBox]:
        """See `BoxSource`; sides of the meshes, with the labels' similarities."""
        scene, stem = self.index.at(index)
        listed = self._listed(self.paths(scene, stem)[_META])
        meshes, found = self._meshes(scene, stem), {}
        for i, label in self._labels(scene, stem).items():
            mesh = MeshFile(meshes[i].path, "m", 1.0, meshes[i].mirrored).load()
            handle = mesh_handle(mesh) if listed[i].category == "mug" else None
            sides = np.asarray(mesh_extents(mesh), np.float64)
            found[i] = KnownBox(sides, label.placed.matrix(), handle, label.handle_visible)
        return found

    def _meshes(self, scene: SceneFolder, stem: str) -> dict[int, MeshFile]:
        listed = self._listed(self.paths(scene, stem)[_META])
        return {
            i: MeshFile(listed[i].mesh, "m", label.placed.scale, listed[i].mirrored)
            for i, label in self._labels(scene, stem).items()
        }

    def _mask(self, path: Path, listed: Mapping[int, _Listed]) -> NDArray[np.uint8]:
        ids, camera = read_ids(path, channel=0), _CAMERAS[self.data]
        if ids.shape != (camera.height, camera.width):
            raise ToolkitError(
                f"the camera of the set is known at {camera.width}x{camera.height}", path=path,
                value=f"{ids.shape[1]}x{ids.shape[0]}",
            )  # fmt: skip
        return known_ids(ids, list(listed))

    def _pickle(self, scene: SceneFolder, stem: str) -> Path | None:
        folder = _PICKLED.get((self.data, self.part))
        if folder is None:
            return None
        name = f"results_{folder}_{Path(scene.path).name}_{stem}.pkl"
        path = _beside(self.top, "gts") / folder / name
        return path if path.is_file() else None

    def _labels(self, scene: SceneFolder, stem: str) -> dict[int, _Label]:
        key = f"{scene.path}/{stem}"
        if key not in self._kept:
            while len(self._kept) >= _KEPT_FRAMES:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = self._read_labels(scene, stem)
        found: dict[int, _Label] = self._kept[key]
        return found

    def _read_labels(self, scene: SceneFolder, stem: str) -> dict[int, _Label]:
        files = self.paths(scene, stem)
        mask = self._mask(files[MASK], self._listed(files[_META]))
        ids = [int(i) for i in np.unique(mask) if i != BACKGROUND]
        pickled = self._pickle(scene, stem)
        if pickled is not None:
            return _filed(pickled, ids)
        depth = self.raw(scene, stem, files[RAW])
        if depth.shape != mask.shape:
            raise ToolkitError("is not of the mask's size", path=files[RAW], value=depth.shape)
        nocs = self.coordinates(scene, stem, mask)
        points, found = unproject_depth(depth, _CAMERAS[self.data]), {}
        for i in ids:
            chosen = (mask == i) & (depth > 0)
            if int(chosen.sum()) < LEAST_PIXELS:
                continue
            try:
                fit, _ = ransac_similarity(
                    nocs[chosen].astype(np.float64) - 0.5, points[chosen], threshold_m=_INLIER_M
                )
            except ToolkitError:  # points on a line, or depth of something else
                continue
            found[i] = _Label(fit)
        return found

    def _listed(self, path: Path) -> dict[int, _Listed]:
        """The objects of a frame by id, without those of class 0."""
        found = {}
        for number, line in enumerate(read_text(path, "list", _LARGEST_TEXT).splitlines(), 1):
            words = line.split()
            if not words:
                continue
            number_of, class_of = map(whole_number, (*words, "")[:2])
            if (
                len(words) not in (3, 4)
                or not 0 <= number_of < BACKGROUND
                or not 0 <= class_of <= len(CLASSES)
                or any("/" in w or w.startswith(".") for w in words[2:])
                or number_of in found
            ):
                raise ToolkitError(
                    "expected instance class name, or instance class synset model", path=path,
                    field=f"line {number}", value=line[:60],
                    hint=f"ids below {BACKGROUND}, each once; classes 0 to {len(CLASSES)}",
                )  # fmt: skip
            if class_of:
                found[number_of] = self._named(CLASSES[class_of - 1], words[2:])
        return dict(sorted(found.items()))

    def _named(self, category: str, names: list[str]) -> _Listed:
        models = _beside(self.top, "obj_models")
        if len(names) == 2:
            mesh = models / self.part / names[0] / names[1] / "model.obj"
            return _Listed(category, names[1], mesh, mirrored=True)
        if names[0].endswith(".npz"):
            name = names[0].removesuffix(".npz")
            mesh = models / "real_val" / f"{name}_norm.obj"
            return _Listed(category, name, mesh, mirrored=False)
        mesh = models / f"real_{self.part}" / f"{names[0]}.obj"
        return _Listed(category, names[0], mesh, mirrored=False)


def _class_id(category: str) -> int:
    """The benchmark's number: it has no laptop."""
    return CATEGORY_CLASS_IDS.get(category, OTHER)


def _beside(top: Path, name: str) -> Path:
    return next((p / name for p in (top, top.parent) if (p / name).is_dir()), top.parent / name)


def _filed(path: Path, ids: list[int]) -> dict[int, _Label]:
    """Labels of the objects of a mask, in the order of their ids."""
    document: Any = read_pickle(path)
    if not isinstance(document, dict):
        raise ToolkitError("expected gt_RTs (n, 4, 4)", path=path)
    try:
        matrices = array_in(document["gt_RTs"], path, "gt_RTs").reshape(-1, 4, 4)
        shown = document.get("handle_visibility")
    except (KeyError, ValueError) as error:
        raise ToolkitError("expected gt_RTs (n, 4, 4)", path=path) from error
    handles = None if shown is None else array_in(shown, path, "handle_visibility").ravel()
    for field, rows in (("gt_RTs", matrices), ("handle_visibility", handles)):
        if rows is not None and len(rows) != len(ids):
            raise ToolkitError(
                f"the mask has {len(ids)} objects", path=path, field=field, value=len(rows),
                hint="mask, list and labels must come from the same frame",
            )  # fmt: skip
    return {
        i: _Label(
            _similarity(matrices[k], path), None if handles is None else bool(handles[k])
        )
        for k, i in enumerate(ids)
    }  # fmt: skip


def _similarity(matrix: NDArray[np.float64], path: Path) -> Similarity:
    A = matrix[:3, :3]
    scale = float(np.cbrt(np.linalg.det(A))) if np.isfinite(matrix).all() else 0.0
    if not scale > 0 or np.abs(A @ A.T / scale**2 - np.eye(3)).max() > _UNEQUAL:
        raise ToolkitError(
            "not a rotation with a scale", path=path, field="gt_RTs", value=A.round(3).tolist()
        )
    return Similarity(scale, SE3(A / scale, matrix[:3, 3]).R, matrix[:3, 3])


def open_nocs(name: str, root: Path, data: Set, part: str) -> NocsFrames:
    """List the frames of a part, those with a colour image.

    Args:
        name: of the split.
        root: folder with `Real` or `CAMERA`, that folder, or one above it.
        data: the set.
        part: `train` or `test` of Real, `train` or `val` of CAMERA.
    """
    folders = (data, data.lower())
    above = (root, *sorted(p for p in root.iterdir() if p.is_dir()))
    tops = [p / folder for p in above for folder in folders]
    if root.name in folders:
        tops.insert(0, root)
    top = next((p for p in tops if (p / part).is_dir()), root / data)
    scenes = []
    inside = (top / part).iterdir() if (top / part).is_dir() else ()
    for folder in sorted((p for p in inside if p.is_dir()), key=lambda p: natural_key(p.name)):
        suffix = f"_{_SUFFIXES[COLOR]}"
        stems = [p.name.removesuffix(suffix) for p in folder.glob(f"*{suffix}")]
        if stems:
            ordered = tuple(sorted(stems, key=natural_key))
            scenes.append(SceneFolder(folder.name, str(folder), ordered))
    return NocsFrames(name, FrameIndex(tuple(scenes)), data=data, part=part, top=top)
