"""ClearPose: 63 transparent objects with an L515, under six test conditions.

<root>/setN/sceneM/000000-color.png, -depth.png, -depth_true.png, -label.png, -normal_true.png
<root>/setN/sceneM/metadata.mat            poses and intrinsics of every frame of the scene
<root>/model/NAME/NAME.obj

Depth is in millimetres. True depth is the rendered CAD surface pasted over the sensor's own depth:
off the objects it is the sensor. Labels 1 to 63 are transparent; above them are opaque objects of
YCB and HOPE. The test frames of the paper were drawn at random and are not published.

Source: README, `data/preprocess.py` and the loaders of github.com/opipari/ClearPose, and the first
author's fork github.com/cxt98/TransCG (`datasets/clearpose_dataset.py`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.places import camera_of, pose_of, whole_number
from benchmark.data.field.source import (
    COLOR,
    MASK,
    RAW,
    TRUTH,
    FieldFrames,
    Files,
    Maps,
    known_ids,
    read_field_depth,
    read_ids,
)
from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.data.loading import FrameIndex, SceneFolder, check_same_size
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.regular import MIB, read_regular

TRANSPARENT = range(1, 64)
METADATA = "metadata.mat"
_LARGEST_METADATA = 512 * MIB
_FILES = {
    COLOR: "-color.png", RAW: "-depth.png", TRUTH: "-depth_true.png", MASK: "-label.png"
}  # fmt: skip
_KEPT_SCENES = 4

_ALL: range | None = None
# Set, scenes of it (None for all), by part.
PARTS: dict[str, tuple[tuple[int, Sequence[int] | None], ...]] = {
    "train": ((1, range(1, 5)), *((s, range(1, 6)) for s in range(4, 8))),
    "heavy-occlusion": ((2, _ALL), (3, _ALL)),
    "new-background": ((1, (5,)), *((s, (6,)) for s in range(4, 8))),
    "opaque-distractor": ((8, (1, 2, 3)),),
    "translucent-cover": ((8, (4,)), (9, (7, 8))),
    "non-planar": ((8, (5,)), (9, (11, 12))),
    "filled-liquid": ((8, (6,)), (9, (9, 10))),
}
PARTS["test"] = tuple(scenes for name, part in PARTS.items() if name != "train" for scenes in part)


@dataclass(frozen=True)
class _Row:
    """What metadata.mat says of a frame."""

    K: Any
    poses: dict[int, SE3]
    T_cam_world: NDArray[np.float64] | None


@dataclass(frozen=True)
class ClearPose(FieldFrames):
    """Frames of some scenes."""

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        return {what: Path(scene.path) / f"{stem}{end}" for what, end in _FILES.items()}

    def documents(self, scene: SceneFolder, stem: str) -> Files:  # noqa: ARG002
        return {"metadata": Path(scene.path) / METADATA}

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:
        true, labels = read_field_depth(files[TRUTH], self.unit), read_ids(files[MASK])
        check_same_size(files[MASK], labels, true, "mask")
        found = [int(i) for i in np.unique(labels) if i > 0]
        if found and found[-1] >= BACKGROUND:
            raise ToolkitError("labels are below 255", path=files[MASK], value=found[-1])
        instances = tuple(
            Instance(i, 0, Material.TRANSPARENT if i in TRANSPARENT else Material.RAW)
            for i in found
        )
        path = Path(scene.path) / METADATA
        camera = camera_of(self._row(scene, stem).K, (true.shape[1], true.shape[0]), path)
        return Maps(true, known_ids(labels, found), camera, instances)

    def poses(self, index: int) -> dict[int, SE3]:
        """See `FieldFrames`; of transparent and opaque objects by their label."""
        return self._row(*self.index.at(index)).poses

    def camera_pose(self, index: int) -> SE3 | None:
        """Return the camera's matrix of the frame as filed; whose frame it maps is not verified."""
        row = self._row(*self.index.at(index))
        return None if row.T_cam_world is None else SE3.from_matrix(row.T_cam_world)

    def _row(self, scene: SceneFolder, stem: str) -> _Row:
        kept = self._kept.get(scene.path)
        if kept is None:
            while len(self._kept) >= _KEPT_SCENES:
                self._kept.pop(next(iter(self._kept)))
            kept = self._kept[scene.path] = read_metadata(Path(scene.path) / METADATA)
        if stem not in kept:
            path = Path(scene.path) / METADATA
            raise ToolkitError("tells nothing of the frame", path=path, field=stem)
        found: _Row = kept[stem]
        return found


def read_metadata(path: Path) -> dict[str, _Row]:
    """Read metadata.mat: intrinsics and poses by frame.

    Raises:
        ToolkitError: unreadable, or a frame without intrinsics or with poses of another number.
    """
    table = read_mat(path, _LARGEST_METADATA)
    return {
        name: _row_of(value, path, name) for name, value in table.items() if isinstance(value, dict)
    }


def read_mat(path: Path, largest_bytes: int) -> dict[str, Any]:
    """Read the variables of a file of MATLAB 5.

    Raises:
        ToolkitError: unreadable, larger, or damaged.
    """
    from io import BytesIO

    from scipy.io import loadmat

    data = read_regular(path, "metadata", largest_bytes)
    try:
        found: dict[str, Any] = loadmat(BytesIO(data), simplify_cells=True)
    except Exception as error:  # damaged files fail in any way
        line = " ".join(str(error).split())[:160]
        raise ToolkitError(f"no file of MATLAB 5: {line}", path=path) from error
    return found


def _row_of(value: Mapping[str, Any], path: Path, name: str) -> _Row:
    # The README calls the field otherwise than the loaders do.
    K = value.get("intrinsic_matrix", value.get("camera_intrinsics"))
    if K is None:
        raise ToolkitError("has no intrinsic_matrix", path=path, field=name)
    camera = value.get("rotation_translation_matrix")
    filed = None
    if camera is not None:
        filed = np.eye(4)
        try:
            filed[:3] = np.asarray(camera, np.float64)[:3, :4]
        except (ValueError, TypeError, IndexError) as error:
            raise ToolkitError(
                "must be 3x4", path=path, field=f"{name}.rotation_translation_matrix"
            ) from error
    return _Row(K, listed_poses(value, path, name), filed)


def listed_poses(value: Mapping[str, Any], path: Path, name: str) -> dict[int, SE3]:
    """Return the poses (3, 4, n) of `cls_indexes`, by these.

    Raises:
        ToolkitError: numbers of another count, or no poses.
    """
    try:
        ids = np.atleast_1d(np.asarray(value.get("cls_indexes", ()), np.float64)).ravel()
        poses = np.asarray(value.get("poses", np.zeros((3, 4, 0))), dtype=np.float64)
        # MATLAB drops a last dimension of 1.
        poses = poses.reshape(3, 4, -1) if poses.size else np.zeros((3, 4, 0))
    except (ValueError, TypeError) as error:
        raise ToolkitError("expected poses (3, 4, n)", path=path, field=f"{name}.poses") from error
    if not (np.isfinite(ids).all() and (ids % 1 == 0).all()):
        raise ToolkitError(
            "expected a number for each object", path=path, field=f"{name}.cls_indexes",
            value=ids.tolist()[:20],
        )  # fmt: skip
    if poses.shape[2] != len(ids):
        raise ToolkitError(
            f"{len(ids)} objects and {poses.shape[2]} poses", path=path, field=f"{name}.poses"
        )
    return {int(i): pose_of(poses[:, :3, k], poses[:, 3, k], path) for k, i in enumerate(ids)}


def open_clearpose(name: str, root: Path, part: str) -> ClearPose:
    """List the frames of a part of the set.

    Args:
        name: of the split.
        root: folder of `set1` to `set9`, or one above it.
        part: key of `PARTS`.
    """
    scenes = []
    for number, wanted in PARTS[part]:
        top = next((p for p in (root, *_folders(root)) if (p / f"set{number}").is_dir()), None)
        for folder in _folders(top / f"set{number}") if top else []:
            scene = whole_number(folder.name.removeprefix("scene"))
            if scene < 0 or (wanted is not None and scene not in wanted):
                continue
            stems = {
                path.name.removesuffix(end)
                for end in _FILES.values()
                for path in folder.glob(f"*{end}")
            }
            if stems:
                key = f"set{number}_{folder.name}"
                scenes.append(SceneFolder(key, str(folder), tuple(sorted(stems, key=natural_key))))
    return ClearPose(name, FrameIndex(tuple(scenes)))


def _folders(folder: Path) -> list[Path]:
    return sorted((p for p in folder.iterdir() if p.is_dir()), key=lambda p: natural_key(p.name))
