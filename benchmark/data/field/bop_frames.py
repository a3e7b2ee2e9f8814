"""XYZ-IBD, IPD and PACE, in BOP's layout: raw depth beside depth of the labels.

<root>/val/SCENE/gray_xyz/000000.png, rgb_realsense/, depth_realsense/, mask_visib_realsense/
<root>/val/SCENE/scene_camera_realsense.json, scene_gt_realsense.json
<root>/models/obj_000001.ply                                  millimetres

True depth is not published: it is rendered from the models at the labels, on the visible masks.
Off the objects there is none. Ground truth is public for `val` only.

PACE has one sensor, and files without its name: depth/, mask_visib/, scene_gt.json. Its simulated
depth is in tenths of a millimetre; masks may have three equal channels.

Source: `dataset_params.py` and docs/bop_datasets_format.md of github.com/thodan/bop_toolkit,
github.com/demianhj/XYZ-IBD, github.com/intrinsic-ai/ipd; README of github.com/qq456cvb/PACE.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.data.field.source import (
    COLOR,
    RAW,
    FieldFrames,
    Files,
    Maps,
    read_field_depth,
    read_ids,
    render_objects,
)
from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.data.labelled import MeshFile
from benchmark.data.loading import FrameIndex, SceneFolder
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.importers.bop_documents import BopScene, read_bop_scene, scene_file
from std_toolkit.io.images import image_size

_PICTURES = ("rgb", "gray")
_KEPT_SCENES = 4


@dataclass(frozen=True)
class BopFrames(FieldFrames):
    """Frames of one sensor; a mask id is the place of the object in the frame's list, from 0.

    Attributes:
        root: of the data set.
        sensor: such as `realsense`; "" of a set with one.
        material: of all objects; the layout does not say it.
        depth_unit: metres per number where the set has one; None: `depth_scale` of the frame.
    """

    root: Path = Path()
    sensor: str = ""
    material: Material = Material.RAW
    depth_unit: float | None = None

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        document = self._scene(scene)
        color = next(
            (found for kind in _PICTURES if (found := document.picture(kind, int(stem)))), None
        )
        files = {
            COLOR: color or document.pictures("rgb") / f"{stem}.png",
            RAW: document.picture("depth", int(stem)) or document.pictures("depth") / f"{stem}.png",
        }
        masks = document.pictures("mask_visib")
        rows = document.gt.get(int(stem), [])
        return files | {f"mask {i}": masks / f"{stem}_{i:06d}.png" for i in range(len(rows))}

    def documents(self, scene: SceneFolder, stem: str) -> Files:
        folder = Path(scene.path)
        files = {n: scene_file(folder, n, self.sensor) for n in ("gt", "camera")}
        rows = self._scene(scene).gt.get(int(stem), [])
        return files | {f"model {row.obj_id}": self._model(row.obj_id) for row in rows}

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:
        row = self._scene(scene).cameras[int(stem)]
        camera = Camera(*image_size(files[RAW]), *row.intrinsics)
        rows = self._scene(scene).gt.get(int(stem), [])
        if len(rows) >= BACKGROUND:
            raise ToolkitError("more objects than a mask has ids", path=scene.path, value=len(rows))
        placed = {
            i: (MeshFile(self._model(r.obj_id), "mm"), r.T_cam_obj) for i, r in enumerate(rows)
        }
        mask = np.full((camera.height, camera.width), BACKGROUND, np.uint8)
        for i in placed:
            visible = read_ids(files[f"mask {i}"])
            if visible.shape != mask.shape:
                raise ToolkitError(
                    "is not of the depth's size", path=files[f"mask {i}"], value=visible.shape
                )
            mask[visible > 0] = i
        true, rendered = render_objects(camera, placed)
        true[(rendered != mask) | (mask == BACKGROUND)] = 0
        instances = tuple(
            Instance(i, 0, self.material, model=f"obj_{r.obj_id:06d}") for i, r in enumerate(rows)
        )
        return Maps(true, mask, camera, instances)

    def raw(self, scene: SceneFolder, stem: str, path: Path) -> np.ndarray:
        """See `FieldFrames`; the unit is that of the set, or of the frame."""
        unit = self.depth_unit or self._scene(scene).cameras[int(stem)].depth_scale_m
        return read_field_depth(path, unit)

    def poses(self, index: int) -> dict[int, SE3]:
        """See `FieldFrames`."""
        scene, stem = self.index.at(index)
        rows = self._scene(scene).gt.get(int(stem), [])
        return {i: row.T_cam_obj for i, row in enumerate(rows)}

    def camera_pose(self, index: int) -> SE3 | None:
        """See `FieldFrames`."""
        scene, stem = self.index.at(index)
        found = self._scene(scene).cameras[int(stem)].T_cam_world
        return None if found is None else found.inverse()

    def _model(self, number: int) -> Path:
        return self.root / "models" / f"obj_{number:06d}.ply"

    def _scene(self, scene: SceneFolder) -> BopScene:
        kept = self._kept.get(scene.path)
        if kept is None:
            while len(self._kept) >= _KEPT_SCENES:
                self._kept.pop(next(iter(self._kept)))
            kept = self._kept[scene.path] = read_bop_scene(Path(scene.path), self.sensor)
        found: BopScene = kept
        return found


def open_bop_frames(
    name: str,
    root: Path,
    data: str,
    sensor: str,
    material: Material,
    part: str = "val",
    depth_unit: float | None = None,
) -> BopFrames:
    """List the frames of a sensor.

    Args:
        name: of the split.
        root: folder of the data set, or one above it.
        data: folder name of the data set.
        sensor: of it.
        material: of its objects.
        part: folder of the scenes.
        depth_unit: see `BopFrames`.

    Raises:
        ToolkitError: a document is damaged.
    """
    top = next((p for p in (root / data, root) if (p / part).is_dir()), root)
    scenes = []
    for folder in sorted((top / part).glob("[0-9]*")) if (top / part).is_dir() else ():
        if scene_file(folder, "camera", sensor).is_file():
            ids = sorted(read_bop_scene(folder, sensor).cameras)
            stems = tuple(f"{i:06d}" for i in ids)
            scenes.append(SceneFolder(folder.name, str(folder), stems))
    return BopFrames(
        name,
        FrameIndex(tuple(scenes)),
        root=top,
        sensor=sensor,
        material=material,
        depth_unit=depth_unit,
    )
