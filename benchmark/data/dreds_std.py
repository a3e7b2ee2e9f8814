"""Scenes in the layouts of DREDS and STD: downloaded, exported or simulated.

<scene>/NNNN_color.png                     colour
<scene>/NNNN_simDepthImage.exr             raw depth of DREDS, of the label maps' size
<scene>/NNNN_depth_415.exr                 raw depth of STD, of the colour image's size
<scene>/NNNN_depth_120.exr, _depth_0.exr   ground truth of DREDS-CatKnown, of DREDS-CatNovel: dense
<scene>/NNNN_gt_depth.exr                  ground truth of STD: on the objects only
<scene>/NNNN_mask.exr, _mask.png           instance ids, 255 elsewhere
<scene>/NNNN_meta.txt                      a line per instance
<scene>/NNNN_coord.png                     NOCS, of the category-known sets

The layouts do not store intrinsics. They are read from the sidecar of a toolkit export, or from
the record that `std-sim` writes in `parameters/`; otherwise they are the constants of the released
code, with the principal point in the image centre.

Source: the loaders of github.com/PKU-EPIC/DREDS, described in data_spec.md, sections 6.2 and 11.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmark.data import loading
from benchmark.data.frame import BACKGROUND, DepthFrame, Instance, Material
from benchmark.data.splits import FrameKey, SceneFiles
from benchmark.data.true_poses import KnownBox, model_files, model_handle, model_sides
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.importers import intrinsics, std_importer, std_objects
from std_toolkit.io.images import read_color
from std_toolkit.scene.model import CATEGORY_CLASS_IDS, MATERIAL_IDS
from std_toolkit.scene.sidecar import SIDECAR_NAME, find_sidecar

COLOR = ("_color.png",)

META = ("_meta.txt",)

NOCS = ("_coord.png",)

MASKS = ("_mask.exr", "_mask.png")

MUG = CATEGORY_CLASS_IDS["mug"]


@dataclass(frozen=True)
class SceneCamera:
    """Cameras of the label maps of a scene.

    Attributes:
        usual: camera of every frame that is not in `by_stem`.
        by_stem: cameras of single frames.
        given: whether it was read from a file and is valid for one image size only; otherwise it
            is the constant of the layout.
        without_depth: stems of frames whose raw depth is a placeholder.
        file: that tells the cameras: the sidecar of an export, or the record of `std-sim`; None for
            the constants of the layout.
    """

    usual: Camera
    by_stem: dict[str, Camera] = field(default_factory=dict)
    given: bool = False
    without_depth: frozenset[str] = frozenset()
    file: Path | None = None

    def of(self, stem: str, size: tuple[int, int], *, path: Path) -> Camera:
        """Return the camera of a frame with label maps of `size`; `path` is one of them.

        Raises:
            ToolkitError: the intrinsics are for another size.
        """
        camera = self.by_stem.get(stem, self.usual)
        if camera.size == size:
            return camera
        if self.given:
            raise ToolkitError(
                f"label maps are of another size than their camera, {camera.width}x{camera.height}",
                path=path,
                value=f"{size[0]}x{size[1]}",
            )
        if camera.width * size[1] != camera.height * size[0]:
            raise ToolkitError(
                f"images of this layout are {camera.width}:{camera.height}",
                path=path,
                value=f"{size[0]}x{size[1]}",
                hint="without a sidecar or a record in parameters/, intrinsics of no other "
                "proportions are known",
            )
        return camera.resized(*size)


def read_scene_camera(folder: Path, layout: std_importer.Layout) -> SceneCamera:
    """Read the cameras of a scene folder.

    Raises:
        ToolkitError: a sidecar or record is damaged.
    """
    width, height = layout.focal_size
    fx, fy = layout.focal
    constant = Camera(width, height, fx, fy, width / 2 - 0.5, height / 2 - 0.5)
    found = find_sidecar(folder, layout.name)
    if found is not None:
        sidecar = found[0]
        cameras = {k: v.camera() for k, v in sidecar.label_cameras.items()}
        for key, model in sidecar.scene.cameras.items():
            cameras.setdefault(key, model.camera())
        by_stem = {frame.stem: cameras[frame.camera] for frame in sidecar.frames}
        return SceneCamera(
            next(iter(by_stem.values()), constant),
            by_stem,
            given=True,
            without_depth=frozenset(f.stem for f in sidecar.frames if not f.sensor_depth),
            file=found[1] / SIDECAR_NAME,
        )
    place = folder.resolve()
    for top in list(place.parents)[:4]:
        record = top / "parameters" / place.parent.name / f"{place.name}.json"
        if record.is_file():
            read = intrinsics.read_intrinsics(str(record))
            if read.size is None:
                raise ToolkitError("the record tells no image size", path=record, field="width")
            camera = read.scene_camera(read.size, path=str(record))
            return SceneCamera(camera, given=True, file=record)
    return SceneCamera(constant)


LAYOUTS = {layout.name: layout for layout in (std_importer.DREDS_LAYOUT, std_importer.STD_LAYOUT)}

_CATEGORIES = {number: name for name, number in CATEGORY_CLASS_IDS.items()}


@dataclass(frozen=True)
class LayoutScenes:
    """Frames of one of the two layouts; see `DepthSource`.

    Attributes:
        layout: "dreds" or "std".
        truncated_ids: read ids of EXR masks as the authors' loader does: truncated, so that many
            are those of another object, or of none.
    """

    name: str
    layout: str
    index: loading.FrameIndex
    truncated_ids: bool = False
    _cameras: dict[str, SceneCamera] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.index)

    def keys(self) -> list[FrameKey]:
        return [FrameKey(scene.name, stem) for scene, stem in self.index]

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:
        """See `DepthSource`."""
        scene, stem = self.index.at(index)
        folder, needed = Path(scene.path), needed_files(LAYOUTS[self.layout])

        def path(what: str) -> Path:
            return loading.first_file(folder, tuple(stem + s for s in needed[what]), what)

        camera = self._camera(scene.path)
        true_path, mask_path, meta_path = (
            path(what) for what in ("ground-truth depth", "mask", "meta file")
        )
        true = loading.read_depth_map(true_path)
        mask = loading.read_id_mask(mask_path, truncated=self.truncated_ids)
        loading.check_same_size(mask_path, mask, true, "mask")
        size = (true.shape[1], true.shape[0])
        color, raw = loading.NO_COLOR, loading.NO_DEPTH
        if sensor:
            color_path, raw_path = path("colour"), path("raw depth")
            if stem in camera.without_depth:
                raise ToolkitError(
                    "the scene was recorded without depth: this file is a placeholder",
                    path=raw_path,
                )
            color, raw = read_color(color_path), loading.read_depth_map(raw_path)
            loading.check_proportions(color_path, color, size)
            loading.check_proportions(raw_path, raw, size)
        coord = folder / f"{stem}{NOCS[0]}"
        key = FrameKey(scene.name, stem)
        instances = tuple(_instance(x) for x in std_objects.read_meta(meta_path, any_class=True))
        if self.truncated_ids:
            mask[~np.isin(mask, [i.mask_id for i in instances])] = BACKGROUND
        try:
            return DepthFrame(
                scene=key.scene,
                name=key.name,
                color=color,
                depth_raw=raw,
                depth_true=true,
                mask=mask,
                camera=camera.of(stem, size, path=true_path),
                instances=instances,
                nocs=loading.read_coord_picture(coord, mask) if nocs and coord.is_file() else None,
            )
        except ToolkitError as error:
            raise loading.about(error, key, mask_path) from error

    def known_boxes(self, index: int) -> dict[int, KnownBox]:
        """See `BoxSource`; boxes of the CAD models next to the scenes."""
        scene, stem = self.index.at(index)
        folder = Path(scene.path)
        found = {}
        for line in std_objects.read_meta(
            loading.first_file(folder, (stem + META[0],), "meta file"), any_class=True
        ):
            if line.class_folder is not None and line.instance_folder is not None:
                names = line.class_folder, line.instance_folder
                sides = model_sides(folder, *names)
                if sides is not None:
                    handle = model_handle(folder, *names) if line.class_id == MUG else None
                    found[line.mask_id] = KnownBox(sides, handle=handle)
        return found

    def inputs(self, index: int, *, nocs: bool = False) -> dict[str, Path]:
        """See `DepthSource`."""
        scene, stem = self.index.at(index)
        folder = Path(scene.path)
        found = {
            what: next((p for s in suffixes if (p := folder / f"{stem}{s}").is_file()), None)
            or folder / f"{stem}{suffixes[0]}"
            for what, suffixes in needed_files(LAYOUTS[self.layout]).items()
        }
        try:
            camera, lines = self._camera(scene.path).file, []
            if nocs:
                found["NOCS"] = folder / f"{stem}{NOCS[0]}"
                lines = std_objects.read_meta(found["meta file"], any_class=True)
        except ToolkitError:  # reading the frame says what is wrong with these files
            return found
        if camera is not None:
            found["camera"] = camera
        for line in lines:
            if line.class_folder is not None and line.instance_folder is not None:
                names = line.class_folder, line.instance_folder
                for path in model_files(folder, *names):
                    found[f"{path.name} of {names[1]}"] = path
        return found

    def infrared(self, index: int) -> tuple[Path, Path] | None:
        """Return the left and right infrared image of a frame; None if it has none (STD)."""
        scene, stem = self.index.at(index)
        left, right = (Path(scene.path) / f"{stem}_ir_{side}.png" for side in ("l", "r"))
        return (left, right) if left.is_file() and right.is_file() else None

    def files(self) -> Iterator[SceneFiles]:
        """See `DepthSource`."""
        needed = needed_files(LAYOUTS[self.layout])
        for scene in self.index.scenes:
            empty = self._camera(scene.path).without_depth
            yield loading.scene_files(scene, needed, placeholders={"raw depth": empty})

    def _camera(self, folder: str) -> SceneCamera:
        found = self._cameras.get(folder)
        if found is None:
            found = read_scene_camera(Path(folder), LAYOUTS[self.layout])
            self._cameras[folder] = found
        return found


def needed_files(layout: std_importer.Layout) -> dict[str, tuple[str, ...]]:
    """Return the accepted suffixes of each file of a frame, by content."""
    return {
        "colour": COLOR,
        "raw depth": (layout.raw,),
        "ground-truth depth": layout.ground_truth,
        "mask": MASKS if layout.masks[0] == MASKS[0] else MASKS[::-1],
        "meta file": META,
    }


def frame_suffixes(layout: std_importer.Layout) -> tuple[str, ...]:
    """Return the file name suffixes that identify a frame."""
    return tuple(s for suffixes in needed_files(layout).values() for s in suffixes)


def _instance(line: std_objects.MetaLine) -> Instance:
    folder = line.class_folder or ""
    # DREDS names its folders by WordNet ids, exports of the toolkit by category.
    category = _CATEGORIES[line.class_id] if line.class_id or folder.isdigit() else folder
    return Instance(
        mask_id=line.mask_id,
        class_id=line.class_id,
        material=Material(MATERIAL_IDS[line.material]),
        category=category,
        model=line.instance_folder or "",
    )
