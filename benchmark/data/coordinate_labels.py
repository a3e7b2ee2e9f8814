"""Labels of STD and DREDS: poses fitted to the true coordinates and the true depth.

A download has no poses that can be used; its coordinates and depth say where each object is. For
exact maps of 8 bits, a fit is typically 0.02 mm and 0.02 deg off, and at most 0.8 mm and 0.8 deg
(`true_poses`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from benchmark.data import loading
from benchmark.data.dreds_std import META, LayoutScenes
from benchmark.data.frame import DepthFrame
from benchmark.data.labelled import FrameImages, LabelledFrame, LabelledObject, MeshFile
from benchmark.data.splits import FrameKey
from benchmark.data.true_poses import LEAST_PIXELS, MESH, model_files
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, umeyama, unproject_depth
from std_toolkit.importers import std_objects
from std_toolkit.scene.document import safe_name
from std_toolkit.scene.model import CATEGORY_CLASS_IDS, ContinuousSymmetry, SymmetryModel
from std_toolkit.scene.sidecar import find_sidecar

# Turned about y they look alike, as the paper's evaluation has it.
_ROUND = ("bottle", "bowl", "can")
_TURN = SymmetryModel(continuous=[ContinuousSymmetry(axis=[0.0, 1.0, 0.0], offset=[0.0, 0.0, 0.0])])
_KEPT_FRAMES = 2


@dataclass(frozen=True)
class CoordinateLabels:
    """Labels of a split in one of the two layouts; see `LabelledSet`."""

    source: LayoutScenes
    _kept: dict[int, DepthFrame] = field(default_factory=dict, repr=False, compare=False)

    def keys(self) -> list[FrameKey]:
        """See `LabelledSet`."""
        return self.source.keys()

    def labels(self, index: int) -> LabelledFrame:
        """See `LabelledSet`."""
        frame = self._frame(index)
        folder, stem = self.source.index.at(index)
        top = Path(folder.path)
        if frame.nocs is None:
            raise ToolkitError(
                "the frame has no normalised coordinates, hence no poses",
                path=top / f"{stem}_coord.png",
                hint="only category-known splits have them",
            )
        points = unproject_depth(frame.depth_true, frame.camera)
        lines = std_objects.read_meta(
            loading.first_file(top, (stem + META[0],), "meta file"), any_class=True
        )
        objects = []
        for line in lines:
            chosen = (frame.mask == line.mask_id) & (frame.depth_true > 0)
            if int(chosen.sum()) < LEAST_PIXELS or line.scale is None:
                continue
            try:
                fit = umeyama(frame.nocs[chosen].astype(np.float64) - 0.5, points[chosen])
            except ToolkitError:  # points on a line
                continue
            names = str(line.class_folder), str(line.instance_folder)
            paths = [p for p in model_files(top, *names) if p.name == MESH]
            is_round = any(line.class_id == CATEGORY_CLASS_IDS[c] for c in _ROUND)
            objects.append(
                LabelledObject(
                    safe_name(f"{names[1]}_{line.mask_id}"),
                    safe_name(f"{names[0]}_{names[1]}"),
                    MeshFile(paths[0], diagonal_m=line.scale) if paths else None,
                    SE3(fit.R, fit.t),
                    line.material,
                    _TURN if is_round else SymmetryModel(),
                )
            )
        key = FrameKey(folder.name, stem)
        return LabelledFrame(index, key, tuple(objects), _camera_pose(top, stem))

    def images(self, index: int) -> FrameImages:
        """See `LabelledSet`; the camera is that of the label maps."""
        frame = self._frame(index)
        size = frame.camera.size
        color, depth = frame.color, frame.depth_raw
        if color.shape[1::-1] != size:
            color = cv2.resize(color, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
        if depth.shape[1::-1] != size:
            depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST).astype(np.float32)
        return FrameImages(frame.camera, color, depth)

    def _frame(self, index: int) -> DepthFrame:
        found = self._kept.get(index)
        if found is None:
            while len(self._kept) >= _KEPT_FRAMES:
                self._kept.pop(next(iter(self._kept)))
            found = self._kept[index] = self.source.load(index, nocs=True)
        return found


def _camera_pose(folder: Path, stem: str) -> SE3 | None:
    """Of an export of the toolkit."""
    found = find_sidecar(folder, "std")
    frame = None if found is None else next((f for f in found[0].frames if f.stem == stem), None)
    if frame is None or frame.T_world_cam is None:
        return None
    return SE3.from_matrix(frame.T_world_cam)
