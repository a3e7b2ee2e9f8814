"""GN-Trans: GraspNet-1Billion's scenes rendered anew with glass and metal, by a simulated D415.

<root>/.../00100/0000_color.png, 0000_depth_sim.png, 0000_ir_l.png, 0000_ir_r.png
<graspnet>/virtual_scenes/scene_0100/realsense/0000_depth.png, 0000_label.png     millimetres
<graspnet>/scenes/scene_0100/realsense/meta/0000.mat, camera_poses.npy, cam0_wrt_table.npy
<graspnet>/models/000/nontextured.ply, textured.obj                               metres

Truth, labels and poses are GraspNet's own. The camera of the images is that of the authors'
program, which is not GraspNet's. Whether truth was rendered by the one or the other is not known:
the first frame of a scene tells, by which of them raw and true depth agree; truth of GraspNet's
camera is then sampled for the other, which has the same place. The materials are not filed.

Source: `src/core_multilayers/D415_camera.py` and `eval_mvs_2layer_gsnet.py` of
github.com/jun7-shi/ASGrasp for the cameras; folders from two third parties; GraspNet's from
github.com/graspnet/graspnetAPI. Not checked on the authors' files.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.clearpose import listed_poses, read_mat
from benchmark.data.field.places import camera_of, pose_of
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
from benchmark.data.frame import BACKGROUND, Instance, Material, resize_nearest
from benchmark.data.infrared import InfraredCalibration, InfraredPair, read_pair
from benchmark.data.labelled import MeshFile
from benchmark.data.loading import FrameIndex, SceneFolder, check_same_size
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.foreign_files import read_npy
from std_toolkit.io.regular import MIB
from std_toolkit.scene.pose_model import CameraModel

Part = Literal["train", "test-seen", "test-similar", "test-novel"]

# Scenes of the parts of GraspNet-1Billion.
PARTS: dict[Part, range] = {
    "train": range(100),
    "test-seen": range(100, 130),
    "test-similar": range(130, 160),
    "test-novel": range(160, 190),
}
FRAMES = 256
_CAMERA = Camera(640, 360, 910.813728 / 2, 910.813728 / 2, 319.5, 179.5)
_INFRARED = InfraredCalibration(
    left=CameraModel(width=640, height=360, fx=448.433, fy=448.433, cx=319.5, cy=179.5),
    baseline_m=0.055,
    T_color_left=SE3(np.eye(3), np.array([0.0151, 0, 0])).flat(),
)
_IMAGES = {COLOR: "{}_color.png", RAW: "{}_depth_sim.png"}
_PAIR = {"left infrared image": "{}_ir_l.png", "right infrared image": "{}_ir_r.png"}
_MESHES = ("nontextured.ply", "textured.obj")
_LARGEST_META = 16 * MIB
# Truth is sampled for the other camera where this makes the median error smaller by a fifth.
_CLEARLY = 0.8
_ONE_SURFACE = 1.02  # ratio of depth of neighbours; beyond it there is an edge between them
_TRIED = 5  # frames of a scene, until one has all files


@dataclass(frozen=True)
class _Agreement:
    """Median difference of raw and true depth in metres: pixel by pixel, and of two cameras."""

    same: float
    two: float

    @property
    def is_of_two(self) -> bool:
        return self.two < _CLEARLY * self.same


@dataclass(frozen=True)
class GnTrans(FieldFrames):
    """Frames of some scenes; mask ids are GraspNet's numbers of the objects plus 1.

    Attributes:
        images: folder of the scenes' images.
        graspnet: folder of GraspNet-1Billion.
    """

    images: Path = Path()
    graspnet: Path = Path()

    infrared_is_known: ClassVar[bool] = True  # without a file: the authors' program tells it

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        folder, name = self.images / scene.name, f"scene_{int(scene.name):04d}/realsense"
        virtual = self.graspnet / "virtual_scenes" / name
        files = {what: folder / form.format(stem) for what, form in _IMAGES.items()}
        files[TRUTH] = virtual / f"{stem}_depth.png"
        labels = (
            virtual / f"{stem}_label.png",
            self.graspnet / "scenes" / name / f"label/{stem}.png",
        )
        return files | {MASK: next((p for p in labels if p.is_file()), labels[0])}

    def documents(self, scene: SceneFolder, stem: str) -> Files:
        first = self.paths(scene, scene.stems[0])
        told = {"first raw depth": first[RAW], "first true depth": first[TRUTH]}
        return told | {"camera and poses": self._meta(scene, stem)}

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:
        true, ids = read_field_depth(files[TRUTH], self.unit), read_ids(files[MASK])
        check_same_size(files[MASK], ids, true, "mask")
        camera = _image_camera(true, files[TRUTH])
        found = self._agreement(scene)
        if found is not None and found.is_of_two:
            filed = self._filed_camera(scene, stem, camera)
            true, ids = sampled(true, ids, filed, camera)
        known = [int(i) for i in np.unique(ids) if 0 < i < BACKGROUND]
        instances = tuple(Instance(i, 0, Material.RAW, model=f"{i - 1:03d}") for i in known)
        return Maps(true, known_ids(ids, known), camera, instances)

    def poses(self, index: int) -> dict[int, SE3]:
        """See `FieldFrames`."""
        scene, stem = self.index.at(index)
        path = self._meta(scene, stem)
        return listed_poses(read_mat(path, _LARGEST_META), path, stem)

    def meshes(self, index: int) -> dict[int, MeshFile]:
        """See `FieldFrames`."""
        found = {}
        for i in self.poses(index):
            folder = self.graspnet / "models" / f"{i - 1:03d}"
            places = [folder / name for name in _MESHES]
            found[i] = MeshFile(next((p for p in places if p.is_file()), places[0]))
        return found

    def camera_pose(self, index: int) -> SE3 | None:
        """Return the pose in the frame of the table, whose top is z = 0; None without its files."""
        scene, stem = self.index.at(index)
        top = self._meta(scene, stem).parent.parent
        paths = top / "cam0_wrt_table.npy", top / "camera_poses.npy"
        if not all(path.is_file() for path in paths):
            return None
        first, every = (read_npy(path) for path in paths)
        if every.ndim != 3 or int(stem) >= len(every):
            raise ToolkitError("no camera pose of this image", path=paths[1], value=stem)
        own = every[int(stem)]
        if first.shape != (4, 4) or own.shape != (4, 4):
            raise ToolkitError("must be 4x4", path=paths[0], value=first.shape)
        return pose_of(first[:3, :3], first[:3, 3], paths[0]) @ pose_of(
            own[:3, :3], own[:3, 3], paths[1]
        )

    def infrared(self, index: int) -> InfraredPair:
        """See `InfraredSource`; the cameras are those of the authors' program."""
        left, right = self.infrared_files(index).values()
        for path in (left, right):
            if not path.is_file():
                raise ToolkitError("the frame has no infrared pair: no such file", path=path)
        return read_pair(left, right, _INFRARED, left)

    def infrared_files(self, index: int) -> dict[str, Path]:
        """See `InfraredSource`."""
        scene, stem = self.index.at(index)
        return {w: self.images / scene.name / name.format(stem) for w, name in _PAIR.items()}

    def infrared_images(self, index: int) -> tuple[Path, Path] | None:
        """See `FieldFrames`."""
        left, right = self.infrared_files(index).values()
        return (left, right) if left.is_file() and right.is_file() else None

    def notes(self) -> Sequence[str]:
        """See `FieldFrames`."""
        found = []
        less = [s.name for s in self.index.scenes if len(s.stems) != FRAMES]
        if less:
            found.append(f"scenes without all {FRAMES} frames of GraspNet: {len(less)}")
        try:
            first = self._agreement(self.index.scenes[0])
        except (ToolkitError, IndexError):  # reading the frame says what is wrong with it
            return found
        if first is not None:
            how = "is sampled from GraspNet's camera" if first.is_of_two else "lies as raw depth"
            found.append(
                f"true depth {how}: raw depth differs by {1000 * first.same:.1f} mm (median) pixel "
                f"by pixel, by {1000 * first.two:.1f} mm if truth is of GraspNet's camera"
            )
        return found

    def _agreement(self, scene: SceneFolder) -> _Agreement | None:
        """How raw and true depth of the first whole frame agree; None where nothing tells."""
        if scene.name not in self._kept:
            self._kept[scene.name] = next(
                (self._measured(scene, stem) for stem in scene.stems[:_TRIED]
                 if all(p.is_file() for p in (*self.paths(scene, stem).values(),
                                              self._meta(scene, stem)))),
                None,
            )  # fmt: skip
        found: _Agreement | None = self._kept[scene.name]
        return found

    def _measured(self, scene: SceneFolder, stem: str) -> _Agreement | None:
        files = self.paths(scene, stem)
        true, raw = (read_field_depth(files[w], self.unit) for w in (TRUTH, RAW))
        camera = _image_camera(true, files[TRUTH])
        one = np.zeros(true.shape, np.uint8)
        moved, _ = sampled(true, one, self._filed_camera(scene, stem, camera), camera)
        size = (raw.shape[1], raw.shape[0])
        forms = [resize_nearest(depth, size) for depth in (true, moved)]
        both = (raw > 0) & (forms[0] > 0) & (forms[1] > 0)
        if not both.any():
            return None
        return _Agreement(*(float(np.median(np.abs(raw - d)[both])) for d in forms))

    def _filed_camera(self, scene: SceneFolder, stem: str, like: Camera) -> Camera:
        path = self._meta(scene, stem)
        K = read_mat(path, _LARGEST_META).get("intrinsic_matrix")
        if K is None:
            raise ToolkitError("has no intrinsic_matrix", path=path)
        return camera_of(K, like.size, path)

    def _meta(self, scene: SceneFolder, stem: str) -> Path:
        name = f"scenes/scene_{int(scene.name):04d}/realsense/meta/{stem}.mat"
        return self.graspnet / name


def _image_camera(true: NDArray[np.float32], path: Path) -> Camera:
    height, width = true.shape
    if width * _CAMERA.height != height * _CAMERA.width:
        raise ToolkitError(
            f"the camera of GN-Trans is known at {_CAMERA.width}x{_CAMERA.height}", path=path,
            value=f"{width}x{height}",
        )  # fmt: skip
    return _CAMERA if _CAMERA.size == (width, height) else _CAMERA.resized(width, height)


def sampled(
    depth: NDArray[np.float32], ids: NDArray[np.integer[Any]], of: Camera, wanted: Camera
) -> tuple[NDArray[np.float32], NDArray[np.integer[Any]]]:
    """Return maps of one camera for another one in the same place: z-depth stays as it is.

    Ids are those of the nearest pixel. So is depth at edges; on a surface it is interpolated, in
    1 / z, which is linear on a plane.

    Args:
        depth, ids: (H, W) metres and numbers of the camera `of`.
        wanted: the other one.

    Returns:
        (H, W) of `wanted`; 0 outside.
    """
    columns = (np.arange(wanted.width) - wanted.cx) / wanted.fx * of.fx + of.cx
    rows = (np.arange(wanted.height) - wanted.cy) / wanted.fy * of.fy + of.cy
    inside = np.logical_and.outer(
        (rows > -0.5) & (rows < of.height - 0.5), (columns > -0.5) & (columns < of.width - 0.5)
    )
    near = np.ix_(_within(np.rint(rows), of.height), _within(np.rint(columns), of.width))
    nearest, found = np.where(inside, depth[near], 0), np.where(inside, ids[near], 0)
    down, across = rows - np.floor(rows), columns - np.floor(columns)
    corners, same = [], np.ones(inside.shape, bool)
    total = np.zeros(inside.shape)
    for y, of_row in ((0, 1 - down), (1, down)):
        for x, of_column in ((0, 1 - across), (1, across)):
            at = np.ix_(_within(np.floor(rows) + y, of.height),
                        _within(np.floor(columns) + x, of.width))  # fmt: skip
            corners.append(depth[at])
            same &= (ids[at] == found) & (depth[at] > 0)
            total += np.outer(of_row, of_column) / np.where(depth[at] > 0, depth[at], 1)
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    smooth = inside & same & (high < _ONE_SURFACE * low)
    return np.where(smooth, 1 / np.where(smooth, total, 1), nearest).astype(np.float32), found


def _within(places: NDArray[np.float64], size: int) -> NDArray[np.intp]:
    return places.clip(0, size - 1).astype(np.intp)


def open_gn_trans(name: str, root: Path, part: Part) -> GnTrans:
    """List the frames of a part of GraspNet's scenes.

    Args:
        name: of the split.
        root: folder in which, or one or two below which, both the images and GraspNet lie.
        part: key of `PARTS`.
    """
    tops = [root, *_folders(root), *(p for top in _folders(root) for p in _folders(top))]
    graspnet = next((p for p in tops if (p / "virtual_scenes").is_dir()), root)
    images, scenes = root, []
    for top in tops:
        scenes = [s for f in _folders(top) if (s := _scene(f, root, PARTS[part])) is not None]
        if scenes:
            images = top
            break
    return GnTrans(name, FrameIndex(tuple(scenes)), images=images, graspnet=graspnet)


def _scene(folder: Path, root: Path, wanted: range) -> SceneFolder | None:
    if not re.fullmatch(r"\d{5}", folder.name) or int(folder.name) not in wanted:
        return None
    stems = {
        path.name.removesuffix(form.format(""))
        for form in _IMAGES.values()
        for path in folder.glob(form.format("[0-9][0-9][0-9][0-9]"))
    }
    return SceneFolder(folder.name, str(root), tuple(sorted(stems))) if stems else None


def _folders(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_dir())
