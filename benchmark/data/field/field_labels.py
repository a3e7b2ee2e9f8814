"""Labels of the sets in BOP's form, and of the field's sets that have poses; see `LabelledSet`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.data.field.source import FieldFrames, read_field_depth
from benchmark.data.frame import DepthFrame
from benchmark.data.labelled import (
    MATERIALS,
    FrameImages,
    LabelledFrame,
    LabelledObject,
    MeshFile,
    named_mesh,
)
from benchmark.data.loading import FrameIndex, SceneFolder
from benchmark.data.splits import FrameKey
from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry import Camera
from std_toolkit.importers.bop_documents import (
    BopScene,
    GtRow,
    ModelInfo,
    deviations,
    read_bop_scene,
    sensors_of,
)
from std_toolkit.importers.bop_objects import symmetry_of
from std_toolkit.io.documents import read_document
from std_toolkit.io.images import image_size, read_color
from std_toolkit.scene.model import Material, SymmetryModel
from std_toolkit.scene.sidecar import Sidecar, find_sidecar

_KEPT_FRAMES, _KEPT_SCENES = 2, 4
_PICTURES = ("rgb", "gray")


@dataclass(frozen=True)
class FieldLabels:
    """Labels of a split of one of the field's sets.

    Attributes:
        source: the split.
        models: folder of meshes, named after the models or the ids of the masks, in metres.
        material: of objects whose material the set does not state.
    """

    source: FieldFrames
    models: Path | None = None
    material: Material | None = None
    _kept: dict[int, DepthFrame] = field(default_factory=dict, repr=False, compare=False)

    def keys(self) -> list[FrameKey]:
        """See `LabelledSet`."""
        return self.source.keys()

    def labels(self, index: int) -> LabelledFrame:
        """See `LabelledSet`."""
        frame = self._frame(index)
        known = {i.mask_id: i for i in frame.instances}
        meshes, objects = self.source.meshes(index), []
        for number, pose in sorted(self.source.poses(index).items()):
            # A mask of all objects together says the material of each.
            kind = known.get(number) or (frame.instances[0] if len(known) == 1 else None)
            model = (kind.model if kind else "") or f"{number:06d}"
            mesh = meshes.get(number)
            if self.models is not None:
                own = named_mesh(self.models, (model, str(number)))
                mesh = mesh if own is None else MeshFile(own)
            stated = None if kind is None else MATERIALS[kind.material]
            material = self.material if stated in (None, "raw") and self.material else stated
            objects.append(
                LabelledObject(f"{model}_{number}", model, mesh, pose, material or "raw")
            )
        key = self.source.keys()[index]
        return LabelledFrame(index, key, tuple(objects), self.source.camera_pose(index))

    def images(self, index: int) -> FrameImages:
        """See `LabelledSet`."""
        frame = self._frame(index)
        return FrameImages(frame.camera, frame.color, frame.depth_raw)

    def _frame(self, index: int) -> DepthFrame:
        found = self._kept.get(index)
        if found is None:
            while len(self._kept) >= _KEPT_FRAMES:
                self._kept.pop(next(iter(self._kept)))
            found = self._kept[index] = self.source.load(index)
        return found


@dataclass(frozen=True)
class BopLabels:
    """Labels of scenes in BOP's form; images, depth and masks may be missing.

    Attributes:
        index: scenes and images.
        models: folder of the models, millimetres.
        material: of objects; exports of the toolkit state it themselves.
        sensor: of sets with several.
        depth_unit: metres per number; None: `depth_scale` of the frame.
    """

    index: FrameIndex
    models: Path
    material: Material = "diffuse"
    sensor: str = ""
    depth_unit: float | None = None
    _kept: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    def keys(self) -> list[FrameKey]:
        """See `LabelledSet`."""
        return [FrameKey(scene.name, stem) for scene, stem in self.index]

    def labels(self, index: int) -> LabelledFrame:
        """See `LabelledSet`."""
        folder, stem = self.index.at(index)
        number = int(stem)
        scene, sidecar = self._scene(folder.path)
        rows = scene.gt.get(number, [])
        exported = {}
        if sidecar is not None:
            found = next((f for f in sidecar.frames if f.id == number), None)
            exported = {} if found is None else {o.mask_id: o.object for o in found.objects}
        seen: Counter[int] = Counter()
        objects = []
        for k, row in enumerate(rows):
            seen[row.obj_id] += 1
            name, material = f"obj_{row.obj_id:06d}_{seen[row.obj_id]}", self.material
            if sidecar is not None and k in exported:
                item = sidecar.objects.object(exported[k])
                name, material = item.name, item.material
            objects.append(self._object(row, name, material))
        pose = scene.cameras[number].T_cam_world
        return LabelledFrame(
            index,
            FrameKey(folder.name, stem),
            tuple(objects),
            None if pose is None else pose.inverse(),
            self._color(scene, number) is not None,
        )

    def images(self, index: int) -> FrameImages:
        """See `LabelledSet`."""
        folder, stem = self.index.at(index)
        number = int(stem)
        scene, _ = self._scene(folder.path)
        path = self._color(scene, number)
        if path is None:
            raise ToolkitError(
                "no colour image of this frame", path=scene.pictures("rgb"), value=stem
            )
        row = scene.cameras[number]
        camera = Camera(*image_size(path), *row.intrinsics)
        depth = scene.picture("depth", number)
        sensor = (
            None if depth is None else read_field_depth(depth, self.depth_unit or row.depth_scale_m)
        )
        if sensor is not None and sensor.shape != (camera.height, camera.width):
            raise ToolkitError("is not of the colour image's size", path=depth, value=sensor.shape)
        return FrameImages(camera, read_color(path, size=camera.size), sensor)

    def _object(self, row: GtRow, name: str, material: Material) -> LabelledObject:
        path = self.models / f"obj_{row.obj_id:06d}.ply"
        mesh = MeshFile(path, "mm") if path.is_file() else None
        off = float(deviations(row.filed_pose.R[None])[0])
        model = f"obj_{row.obj_id:06d}"
        return LabelledObject(
            name, model, mesh, row.T_cam_obj, material, self._symmetry(row.obj_id), off
        )

    def _symmetry(self, number: int) -> SymmetryModel:
        path = self.models / "models_info.json"
        if "models" not in self._kept:
            self._kept["models"] = (
                read_document(path, dict[str, ModelInfo]) if path.is_file() else {}
            )
        with located(path, str(number)):
            return symmetry_of(self._kept["models"].get(str(number)), np.zeros(3))

    @staticmethod
    def _color(scene: BopScene, number: int) -> Path | None:
        return next(filter(None, (scene.picture(kind, number) for kind in _PICTURES)), None)

    def _scene(self, path: str) -> tuple[BopScene, Sidecar | None]:
        kept = self._kept.get(path)
        if kept is None:
            scenes = [k for k in self._kept if k != "models"]
            for old in scenes[: max(len(scenes) - _KEPT_SCENES + 1, 0)]:
                del self._kept[old]
            folder = Path(path)
            found = find_sidecar(folder, "bop")
            kept = read_bop_scene(folder, self.sensor), None if found is None else found[0]
            self._kept[path] = kept
        scene, sidecar = kept
        return scene, sidecar


def open_bop_labels(root: Path, models: Path | None, material: Material | None) -> BopLabels:
    """List the scenes of a set in BOP's form that have labels.

    Args:
        root: folder of the set, of one of its splits, or of a scene.
        models: folder of the models; default: `models/` of the set.
        material: of the objects (diffuse).

    Raises:
        ToolkitError: no such scene, several sensors, or no models.
    """
    documents = sorted(root.rglob("scene_gt*.json")) if root.is_dir() else []
    # Beside it lie scene_gt_info.json and files of more sensors.
    folders = sorted({p.parent for p in documents if "info" not in p.name})
    if not folders:
        raise ToolkitError("no scene_gt.json here", path=root, hint="give the folder of the set")
    sensors = sorted({s for f in folders for s in sensors_of(f)})
    if len(sensors) > 1:
        raise ToolkitError(
            f"scenes of {len(sensors)} sensors", path=root, value=", ".join(sensors),
            hint="give one of the splits of `std-bench list splits`",
        )  # fmt: skip
    sensor = sensors[0] if sensors else ""
    if models is None:
        tops = (root, *list(root.resolve().parents)[:2])
        models = next((t / "models" for t in tops if (t / "models").is_dir()), None)
    if models is None or not models.is_dir():
        raise ToolkitError("the models of the set are missing", path=models or root,
                           hint="give --models DIR")  # fmt: skip
    parts = len({f.parent for f in folders}) > 1
    scenes = []
    for folder in folders:
        ids = sorted(read_bop_scene(folder, sensor).gt)
        name = f"{folder.parent.name}_{folder.name}" if parts else folder.name
        scenes.append(SceneFolder(name, str(folder), tuple(f"{i:06d}" for i in ids)))
    return BopLabels(FrameIndex(tuple(scenes)), models, material or "diffuse", sensor)
