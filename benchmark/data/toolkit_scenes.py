"""Scene folders of the toolkit as frames to score.

Frames need sensor depth and ground truth: the maps of `std-curate render`, otherwise those of an
imported recording in `reference/`. In simulated scenes the depth of all pixels, including table and
floor, is ground truth.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data import cleargrasp, dreds_std, loading, splits, true_poses
from benchmark.data.frame import BACKGROUND, DepthFrame, Instance, Material
from benchmark.data.infrared import InfraredPair, infrared_inputs, read_infrared
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.frame_maps import check_fresh
from std_toolkit.geometry.alignment import Similarity
from std_toolkit.geometry.mesh import nocs_frame
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.rendering.ground_truth import info_path, load_nocs, map_paths, read_frame_truth
from std_toolkit.scene.model import MATERIAL_IDS, Frame
from std_toolkit.scene.scene import Scene

# Number of scenes whose documents are kept in memory.
_OPEN_SCENES = 4
_CLEARGRASP = "import:cleargrasp"
_SIMULATED = "simulated:"


@dataclass(frozen=True)
class _Truth:
    """Files of the ground truth of a frame; `rendered` by the toolkit, or imported."""

    depth: Path
    mask: Path
    nocs: Path
    rendered: bool

    def read_nocs(self, mask: NDArray[np.uint8]) -> NDArray[np.float32] | None:
        if not self.nocs.is_file():
            return None
        if self.rendered:
            return load_nocs(self.nocs, (mask.shape[1], mask.shape[0]))
        return loading.read_coord_picture(self.nocs, mask)


@dataclass(frozen=True)
class ToolkitScenes:
    """Frames of toolkit scenes; see `DepthSource`. Frames are named by the stems of their files.

    Attributes:
        left_out: names of skipped frames by scene and missing map, "raw depth" or "ground-truth
            depth".
    """

    name: str
    index: loading.FrameIndex
    left_out: dict[str, dict[str, list[str]]]
    _open: dict[str, Scene] = field(default_factory=dict, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": {}}

    def __len__(self) -> int:
        return len(self.index)

    def keys(self) -> list[splits.FrameKey]:
        return [splits.FrameKey(scene.name, stem) for scene, stem in self.index]

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:
        """See `DepthSource`."""
        scene, frame = self._frame(index)
        camera = scene.camera(frame)
        truth = _fresh_truth(scene, frame)
        true, mask = loading.read_depth_map(truth.depth), loading.read_id_mask(truth.mask)
        mask[mask == 0] = BACKGROUND
        loading.check_same_size(truth.mask, mask, true, "mask")
        size = (true.shape[1], true.shape[0])
        color, raw = loading.NO_COLOR, loading.NO_DEPTH
        if sensor:
            color, raw = scene.read_color(frame), _sensor_depth(scene, frame)
        listed, stem = self.index.at(index)
        key = splits.FrameKey(listed.name, stem)
        try:
            return DepthFrame(
                scene=key.scene,
                name=key.name,
                color=color,
                depth_raw=raw,
                depth_true=true,
                mask=mask,
                camera=camera if camera.size == size else camera.resized(*size),
                instances=_instances(scene, truth),
                nocs=truth.read_nocs(mask) if nocs else None,
            )
        except ToolkitError as error:
            raise loading.about(error, key, truth.mask) from error

    def infrared(self, index: int) -> InfraredPair:
        """See `InfraredSource`."""
        scene, frame = self._frame(index)
        return read_infrared(scene.root, frame.name, frame.id)

    def infrared_files(self, index: int) -> dict[str, Path]:
        """See `InfraredSource`."""
        scene, frame = self._frame(index)
        return infrared_inputs(scene.root, frame.name)

    def known_boxes(self, index: int) -> dict[int, true_poses.KnownBox]:
        """See `BoxSource`; boxes of the scene's meshes, with the rendered poses."""
        scene, frame = self._frame(index)
        poses = {}
        if _fresh_truth(scene, frame).rendered:
            rows = read_frame_truth(scene, frame.id).objects
            poses = {row.object: row.pose.matrix() for row in rows}
        found = {}
        for obj in scene.objects.objects:
            model, mesh = scene.objects.model(obj.model), scene.mesh(obj.model)
            centre, diagonal = nocs_frame(mesh)
            sides = np.array(model.size_m) / diagonal
            handle = true_poses.mesh_handle(mesh) if model.class_id == dreds_std.MUG else None
            RT = None
            if obj.id in poses:
                RT = poses[obj.id] @ Similarity(diagonal, np.eye(3), centre).matrix()
            found[obj.id] = true_poses.KnownBox(sides, RT, handle)
        return found

    def inputs(self, index: int, *, nocs: bool = False) -> dict[str, Path]:
        """See `DepthSource`; what the documents say of a scene counts for each of its frames."""
        scene, frame = self._frame(index)
        found = {name: scene.root / name for name in ("scene.json", "objects.json")}
        found["colour"] = scene.root / frame.color
        if frame.depth is not None:
            found["raw depth"] = scene.root / frame.depth
        truth = _truth_files(scene, frame)
        if truth is not None:
            found |= {"ground-truth depth": truth.depth, "mask": truth.mask}
            if truth.rendered:
                found["record of the ground truth"] = info_path(scene.root, frame.id)
            if nocs:
                found["NOCS"] = truth.nocs
        if nocs:
            for model in scene.objects.models:
                found[f"mesh of {model.id}"] = scene.root / model.mesh
        return found

    def files(self) -> Iterator[splits.SceneFiles]:
        """See `DepthSource`."""
        for scene in self.index.scenes:
            missing = self.left_out.get(scene.name, {})
            lost = {name for names in missing.values() for name in names}
            yield splits.SceneFiles(scene.name, scene.path, len(scene.stems) + len(lost), missing)

    def _frame(self, index: int) -> tuple[Scene, Frame]:
        listed, stem = self.index.at(index)
        scene = self._scene(listed.path)
        frame = next((f for f in scene.frames if f.name == stem), None)
        if frame is None:
            raise ToolkitError("no such frame any more", path=scene.root, value=stem)
        return scene, frame

    def _scene(self, path: str) -> Scene:
        scene = self._open.get(path)
        if scene is None:
            if len(self._open) >= _OPEN_SCENES:
                self._open.pop(next(iter(self._open)))
            scene = self._open[path] = Scene.open(path)
        return scene


def open_scenes(name: str, top: Path, *, depth: int = 3) -> ToolkitScenes:
    """Open all toolkit scenes at and below a folder.

    Args:
        name: name of the split.
        depth: maximum depth of folders.

    Raises:
        ToolkitError: documents of a scene are damaged, or there is no scene.
    """
    paths = scene_folders(top, depth)
    if not paths:
        raise ToolkitError(
            "no toolkit scene here: no folder holds a scene.json",
            path=top,
            hint="`std-curate import` makes scenes of recordings; `std-restore` restores the depth "
            "of recordings without ground truth",
        )
    names = Counter(p.name for p in paths)
    folders, left_out = [], {}
    for path in paths:
        unique = names[path.name] == 1 or path == top
        scene_name = path.name if unique else "_".join(path.relative_to(top).parts)
        listed, missing = _list_frames(Scene.open(path))
        if missing:
            left_out[scene_name] = missing
        folders.append(loading.SceneFolder(scene_name, str(path), listed))
    return ToolkitScenes(name, loading.FrameIndex(tuple(folders)), left_out)


def scene_folders(top: Path, depth: int = 3) -> list[Path]:
    """Return the folders of all toolkit scenes at and below a folder, in natural order."""
    return sorted(_scene_folders(top, depth), key=lambda p: natural_key(str(p)))


def _scene_folders(folder: Path, depth: int) -> Iterator[Path]:
    if (folder / "scene.json").is_file():
        yield folder
    elif depth > 0:
        try:
            below = [p for p in folder.iterdir() if not p.name.startswith(".") and p.is_dir()]
        except OSError as error:
            raise ToolkitError(f"cannot read the folder: {error.strerror}", path=folder) from error
        for path in below:
            yield from _scene_folders(path, depth - 1)


def _list_frames(scene: Scene) -> tuple[tuple[str, ...], dict[str, list[str]]]:
    counted: list[str] = []
    missing: dict[str, list[str]] = {"raw depth": [], "ground-truth depth": []}
    for frame in scene.frames:
        if frame.depth is None:
            missing["raw depth"].append(frame.name)
        elif _truth_files(scene, frame) is None:
            missing["ground-truth depth"].append(frame.name)
        else:
            counted.append(frame.name)
    return tuple(counted), {what: names for what, names in missing.items() if names}


def _truth_files(scene: Scene, frame: Frame) -> _Truth | None:
    reference = {
        kind: scene.root / "reference" / kind / f"{frame.name}{suffix}"
        for kind, suffix in (("depth", ".exr"), ("mask", ".png"), ("nocs", ".png"))
    }
    if info_path(scene.root, frame.id).is_file():
        maps = map_paths(scene.root, frame.id)
        dense = scene.info.source.startswith(_SIMULATED) and reference["depth"].is_file()
        depth = reference["depth"] if dense else maps["depth"]
        return _Truth(depth, maps["mask"], maps["nocs"], rendered=True)
    if reference["depth"].is_file() and reference["mask"].is_file():
        return _Truth(reference["depth"], reference["mask"], reference["nocs"], rendered=False)
    return None


def _fresh_truth(scene: Scene, frame: Frame) -> _Truth:
    found = _truth_files(scene, frame)
    if found is None:
        raise ToolkitError(
            "the frame has no ground truth any more", path=scene.root, value=frame.name
        )
    if found.rendered:
        check_fresh(scene, read_frame_truth(scene, frame.id))
    return found


def _sensor_depth(scene: Scene, frame: Frame) -> NDArray[np.float32]:
    if frame.depth is not None and frame.depth.endswith(".exr"):
        path = scene.root / frame.depth
        depth = loading.read_depth_map(path) * np.float32(scene.info.depth_correction)
        loading.check_proportions(path, depth, scene.camera(frame).size)
        return depth
    read = scene.read_depth(frame)
    if read is None:
        raise ToolkitError("the frame has no sensor depth", path=scene.root, value=frame.name)
    return read


def _instances(scene: Scene, truth: _Truth) -> tuple[Instance, ...]:
    if not truth.rendered and scene.info.source == _CLEARGRASP:
        return (cleargrasp.TRANSPARENT,)
    models = {m.id: m for m in scene.objects.models}
    return tuple(
        Instance(
            mask_id=obj.id,
            class_id=models[obj.model].class_id,
            material=Material(MATERIAL_IDS[obj.material]),
            category=models[obj.model].category,
            model=obj.model,
        )
        for obj in scene.objects.objects
    )
