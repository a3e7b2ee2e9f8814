"""Intrinsics of scenes in the DREDS and STD layouts, which have no place for them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.sidecar import find_sidecar
from std_toolkit.geometry.camera import Camera
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.importers.std import Layout


@dataclass(frozen=True)
class SceneCamera:
    """Cameras of the label maps of a scene.

    Attributes:
        usual: of every frame that `by_stem` does not name.
        by_stem: of single frames.
        given: read from a file, so that it fits one image size only; else the layout's constant.
        without_depth: stems of frames whose raw depth is a placeholder.
    """

    usual: Camera
    by_stem: dict[str, Camera] = field(default_factory=dict)
    given: bool = False
    without_depth: frozenset[str] = frozenset()

    def of(self, stem: str, size: tuple[int, int], *, path: Path) -> Camera:
        """Camera of a frame whose label maps are of `size`; `path` is one of them.

        Raises:
            ToolkitError: the intrinsics do not belong to this size.
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


def read_scene_camera(folder: Path, layout: Layout) -> SceneCamera:
    """The cameras of a scene folder.

    Raises:
        ToolkitError: a sidecar or a record is there, but damaged.
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
        )
    place = folder.resolve()
    for top in list(place.parents)[:4]:
        record = top / "parameters" / place.parent.name / f"{place.name}.json"
        if record.is_file():
            read = read_intrinsics(str(record))
            if read.size is None:
                raise ToolkitError("the record tells no image size", path=record, field="width")
            return SceneCamera(read.camera(read.size, path=str(record)), given=True)
    return SceneCamera(constant)
