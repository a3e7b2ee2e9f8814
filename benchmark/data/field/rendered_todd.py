"""Syn-TODD as its authors' programs render it; see `syn_todd` for depth, axes and sources.

<root>/SCENE/Camera_C_EmptyVessel_Frame_0_RGB_L.jpg, ..._Depth.exr
<root>/SCENE/segmentation_Camera_C_OBJECT_visible_L.png       grey 206 where this object is seen
<root>/SCENE/BoundingBox.json                                 cameras and poses by name

Masks have the first 38 letters of the names.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.data.field.source import COLOR, TRUTH, FieldFrames, Files, Maps
from benchmark.data.field.syn_todd import (
    field_of,
    folders_in,
    image_camera,
    opencv_pose,
    true_depth,
    world_pose,
)
from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.data.loading import SceneFolder, index_of
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.exr import read_exr_channel
from std_toolkit.io.foreign_files import read_json
from std_toolkit.io.images import read_color
from std_toolkit.io.plain_pickle import array_in

CAMERAS = 56
_NAME_LETTERS = 38
_LARGEST_JSON = 2**26
_LEFT = "Camera_{}_EmptyVessel_Frame_0_RGB_L.jpg"
_DEPTH = "Camera_{}_EmptyVessel_Frame_0_Depth.exr"


@dataclass(frozen=True)
class RenderedTodd(FieldFrames):
    """Frames as rendered; mask ids are the places of the objects by name, from 1."""

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        top = Path(scene.path)
        files = {COLOR: top / _LEFT.format(stem), TRUTH: top / _DEPTH.format(stem)}
        seen = _visible(top, stem)
        try:
            names = sorted(self._objects(scene, stem))
        except ToolkitError:  # reading the frame says what is wrong with it
            names = []
        wanted = f"segmentation_Camera_{stem}_{{}}_visible_L.png"
        return files | {f"mask of {n}": seen.get(n, top / wanted.format(n)) for n in names}

    def documents(self, scene: SceneFolder, stem: str) -> Files:  # noqa: ARG002
        return {"camera and poses": Path(scene.path) / "BoundingBox.json"}

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:
        path = files[TRUTH]
        true = true_depth(read_exr_channel(path, require_equal=True), path)
        camera = image_camera(self._camera(scene, stem), true.shape, self._document(scene))
        names = sorted(self._objects(scene, stem))
        mask = np.full(true.shape, BACKGROUND, np.uint8)
        for i, name in enumerate(names, 1):
            picture = read_color(files[f"mask of {name}"], size=camera.size)
            # This object is (206, 206, 206), others (177, 0, 7), the table black; edges blend them.
            mask[(picture[..., 0] > 110) & (picture[..., 1] >= 100)] = i
        instances = tuple(
            Instance(i, 0, Material.TRANSPARENT, model=name) for i, name in enumerate(names, 1)
        )
        return Maps(true, mask, camera, instances)

    def poses(self, index: int) -> dict[int, SE3]:
        """See `FieldFrames`."""
        scene, stem = self.index.at(index)
        path = self._document(scene)
        objects = self._objects(scene, stem)
        return {
            i: opencv_pose(array_in(field_of(objects[name], path, "6dpose_c_obj"), path, name),
                           path, name)
            for i, name in enumerate(sorted(objects), 1)
        }  # fmt: skip

    def camera_pose(self, index: int) -> SE3 | None:
        """See `FieldFrames`."""
        scene, stem = self.index.at(index)
        return world_pose(self._camera(scene, stem), self._document(scene))

    def notes(self) -> Sequence[str]:
        """See `FieldFrames`."""
        less = [s.name for s in self.index.scenes if len(s.stems) != CAMERAS]
        return [f"scenes without all {CAMERAS} cameras: {len(less)}"] if less else []

    def _document(self, scene: SceneFolder) -> Path:
        return Path(scene.path) / "BoundingBox.json"

    def _camera(self, scene: SceneFolder, stem: str) -> dict[str, Any]:
        path = self._document(scene)
        if scene.path not in self._kept:
            document = read_json(path, largest_bytes=_LARGEST_JSON)
            self._kept.clear()
            self._kept[scene.path] = document
        found = field_of(self._kept[scene.path], path, f"Camera_{stem}")
        if not isinstance(found, dict):
            raise ToolkitError("must be an object", path=path, field=f"Camera_{stem}")
        return found

    def _objects(self, scene: SceneFolder, stem: str) -> dict[str, Any]:
        """What is filed of each object, by its name as masks have it."""
        found: dict[str, Any] = {}
        for key, value in self._camera(scene, stem).items():
            if not (isinstance(value, dict) and "6dpose_c_obj" in value):
                continue
            name = key.split("transparent_")[-1][:_NAME_LETTERS]
            if name in found or "/" in name:
                raise ToolkitError(
                    f"two objects with these first {_NAME_LETTERS} letters, or no name",
                    path=self._document(scene), field=f"Camera_{stem}", value=name,
                )  # fmt: skip
            found[name] = value
        if len(found) >= BACKGROUND:
            raise ToolkitError(
                "more objects than a mask has ids", path=self._document(scene), value=len(found)
            )
        return found


def _visible(top: Path, stem: str) -> dict[str, Path]:
    """Masks of what is seen of each object, by the first letters of its name."""
    first, last = f"segmentation_Camera_{stem}_", "_visible_L.png"
    return {
        path.name.removeprefix(first).removesuffix(last)[:_NAME_LETTERS]: path
        for path in sorted(top.glob(f"{first}*{last}"))
        if "_Content_" not in path.name
    }


def open_rendered_todd(name: str, root: Path) -> RenderedTodd:
    """List the cameras of scenes as rendered.

    Args:
        name: of the split.
        root: folder of the scenes, or one above it.
    """
    forms = [re.compile(re.escape(n).replace(r"\{\}", r"(\d+)")) for n in (_LEFT, _DEPTH)]
    scenes: dict[Path, tuple[str, ...]] = {}
    for folder in (p for top in (root, *folders_in(root)) for p in (top, *folders_in(top))):
        stems = {
            match[1]
            for path in folder.glob("Camera_*_EmptyVessel_Frame_0_*")
            for form in forms
            if (match := form.fullmatch(path.name))
        }
        if stems:
            scenes[folder] = tuple(sorted(stems, key=natural_key))
    found = sorted(scenes.items(), key=lambda item: natural_key(str(item[0])))
    return RenderedTodd(name, index_of(root, found))
