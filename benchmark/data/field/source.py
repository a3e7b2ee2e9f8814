"""What the readers of the field's data sets have in common.

A reader lists its scenes and names the files of a frame; the frame is made from them. Beside what
`DepthSource` asks for, it gives poses, meshes and the infrared pair, where the set has them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND, DepthFrame, Instance
from benchmark.data.labelled import MeshFile
from benchmark.data.loading import NO_COLOR, NO_DEPTH, FrameIndex, SceneFolder, about
from benchmark.data.splits import DepthSource, FrameKey, SceneFiles, Split, where_to_get
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.importers.depth_files import read_foreign_depth
from std_toolkit.importers.depth_survey import DepthSurveySettings
from std_toolkit.io.images import image_size, read_color, read_depth, read_png

# Files of a frame by content; those whose content is listed in `optional` may be missing.
Files = dict[str, Path]

COLOR, RAW, TRUTH, MASK = "colour", "raw depth", "ground-truth depth", "mask"


@dataclass(frozen=True)
class Maps:
    """The maps of a frame beside colour and raw depth.

    Attributes:
        true: (k, l) float32 metres, 0 where there is no ground truth.
        mask: (k, l) uint8 instance ids, `BACKGROUND` elsewhere.
        camera: of these maps.
        instances: the objects of the mask.
    """

    true: NDArray[np.float32]
    mask: NDArray[np.uint8]
    camera: Camera
    instances: tuple[Instance, ...]


@dataclass(frozen=True)
class FieldFrames:
    """Frames of a split of one of the sets; see `DepthSource`.

    Attributes:
        name: of the split.
        index: scenes and frames.
        unit: metres per number of raw depth.
    """

    name: str
    index: FrameIndex
    unit: float = 0.001
    _kept: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.index)

    def keys(self) -> list[FrameKey]:
        """See `DepthSource`."""
        return [FrameKey(scene.name, stem) for scene, stem in self.index]

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        """Return the files of a frame by content, which need not exist.

        Without a file of raw depth, no sensor measured any: it is 0 everywhere.
        """
        raise NotImplementedError

    def documents(self, scene: SceneFolder, stem: str) -> Files:  # noqa: ARG002
        """Return the other files that a frame is made from."""
        return {}

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:
        """Read the ground truth of a frame.

        Raises:
            ToolkitError: a file is missing, damaged or inconsistent with another.
        """
        raise NotImplementedError

    def raw(self, scene: SceneFolder, stem: str, path: Path) -> NDArray[np.float32]:  # noqa: ARG002
        """Read the sensor's depth, metres."""
        return read_field_depth(path, self.unit)

    def coordinates(
        self,
        scene: SceneFolder,  # noqa: ARG002
        stem: str,  # noqa: ARG002
        mask: NDArray[np.uint8],  # noqa: ARG002
    ) -> NDArray[np.float32] | None:
        """Read the normalised coordinates of the objects, where the set has them."""
        return None

    def color(self, path: Path) -> NDArray[np.uint8]:
        """Read the colour image, (H, W, 3) RGB."""
        return read_color(path)

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:
        """See `DepthSource`."""
        scene, stem = self.index.at(index)
        files = self.paths(scene, stem)
        absent = next((w for w, p in files.items() if not p.is_file()), None)
        if absent is not None:
            raise ToolkitError(
                f"the frame has no {absent}: no such file",
                path=files[absent],
                hint="is the download complete? `std-bench check-data` lists all that is missing",
            )
        found = self.maps(scene, stem, files)
        color, raw = NO_COLOR, NO_DEPTH
        if sensor:
            color = self.color(files[COLOR])
            raw = np.zeros(color.shape[:2], np.float32)
            if RAW in files:
                raw = self.raw(scene, stem, files[RAW])
            for what, image in ((COLOR, color), (RAW, raw)):
                _check_shape(files.get(what, files[COLOR]), image, found.camera)
        key = FrameKey(scene.name, stem)
        try:
            return DepthFrame(
                scene=key.scene,
                name=key.name,
                color=color,
                depth_raw=raw,
                depth_true=found.true,
                mask=found.mask,
                camera=found.camera,
                instances=found.instances,
                nocs=self.coordinates(scene, stem, found.mask) if nocs else None,
            )
        except ToolkitError as error:
            raise about(error, key, files.get(MASK, Path(scene.path))) from error

    def inputs(self, index: int, *, nocs: bool = False) -> Files:  # noqa: ARG002
        """See `DepthSource`."""
        scene, stem = self.index.at(index)
        try:
            more = self.documents(scene, stem)
        except ToolkitError:  # reading the frame says what is wrong with them
            more = {}
        return self.paths(scene, stem) | more

    def files(self) -> Iterator[SceneFiles]:
        """See `DepthSource`."""
        for scene in self.index.scenes:
            missing: dict[str, list[str]] = {}
            for stem in scene.stems:
                for what, path in self.paths(scene, stem).items():
                    if not path.is_file():
                        name = str(path.relative_to(scene.path))
                        missing.setdefault(what, []).append(name)
            yield SceneFiles(scene.name, scene.path, len(scene.stems), missing)

    def poses(self, index: int) -> dict[int, SE3]:  # noqa: ARG002
        """Return the poses of objects, `T_cam_obj` in metres and OpenCV's axes, by mask id."""
        return {}

    def meshes(self, index: int) -> dict[int, MeshFile]:  # noqa: ARG002
        """Return the meshes of objects by mask id, where the set has them."""
        return {}

    def camera_pose(self, index: int) -> SE3 | None:  # noqa: ARG002
        """Return `T_world_cam` in metres, or None."""
        return None

    def infrared_images(self, index: int) -> tuple[Path, Path] | None:  # noqa: ARG002
        """Return the left and right image with the projected pattern, or None."""
        return None

    def notes(self) -> Sequence[str]:
        """Return what the set's own counts say of the frames that are here."""
        return ()


def field_split(opened: Callable[[Path], FieldFrames], **known: Any) -> Split:
    """A split whose folder must have a frame of it; `known` are the fields of `Split`."""

    def open_root(root: Path) -> DepthSource:
        found = opened(root)
        if not len(found):
            hint = where_to_get(split)
            raise ToolkitError(
                "nothing of this split is here", path=root, value=split.name, hint=hint
            )
        return found

    split = Split(open=open_root, **known)
    return split


def _check_shape(path: Path, image: NDArray[Any], camera: Camera) -> None:
    if image.shape[1] * camera.height != image.shape[0] * camera.width:
        raise ToolkitError(
            f"has other proportions than the ground truth's {camera.width}x{camera.height}",
            path=path,
            value=f"{image.shape[1]}x{image.shape[0]}",
        )


def read_field_depth(path: Path, unit: float, *, two_bytes: bool = False) -> NDArray[np.float32]:
    """Read 16-bit depth in metres.

    Args:
        path: of a PNG file of one channel.
        unit: metres per number.
        two_bytes: see `read_foreign_depth`.

    Raises:
        ToolkitError: unreadable, or its median says another unit.
    """
    if two_bytes:
        stored = read_foreign_depth(path, size=image_size(path), two_bytes=True).values
        depth = stored.astype(np.float32) * np.float32(unit)
    else:
        depth = read_depth(path, scale=unit)
    sample = depth[::8, ::8]
    measured = sample[sample > 0]
    if measured.size and np.median(measured) > DepthSurveySettings.current().farthest_m:
        raise ToolkitError(
            f"the median depth is implausible: the set is known to store {unit:g} m per number",
            path=path,
            value=f"{np.median(measured):.4g} m",
        )
    return depth


def read_ids(path: Path, channel: int | None = None) -> NDArray[np.integer[Any]]:
    """Read an image of whole numbers of one channel.

    Args:
        path: of a PNG file.
        channel: of a colour image that holds them; None for equal channels.

    Raises:
        ToolkitError: unreadable, or channels that differ.
    """
    image = read_png(path)
    if image.ndim == 3:
        if channel is None and not (image == image[..., :1]).all():
            raise ToolkitError("the channels of the mask differ", path=path)
        image = np.ascontiguousarray(image[..., channel or 0])
    if image.dtype.kind != "u":
        raise ToolkitError("a mask holds whole numbers", path=path, value=str(image.dtype))
    return image  # type: ignore[return-value]


def known_ids(mask: NDArray[np.integer[Any]], ids: Sequence[int]) -> NDArray[np.uint8]:
    """Return a mask of these ids, `BACKGROUND` elsewhere."""
    return np.where(np.isin(mask, list(ids)), mask, BACKGROUND).astype(np.uint8)


def render_objects(
    camera: Camera, placed: Mapping[int, tuple[MeshFile, SE3]]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Render meshes at their poses, for sets without true depth.

    Args:
        camera: of the frame.
        placed: mesh and `T_cam_obj` by mask id.

    Returns:
        (H, W) metres, 0 off the objects; (H, W) mask ids, `BACKGROUND` off the objects. Occluders
        that are no objects are not known.

    Raises:
        ToolkitError: a mesh is missing or damaged.
    """
    from std_toolkit.rendering.maps import compose
    from std_toolkit.rendering.renderer import PlacedMesh

    ids = list(placed)
    drawn = [
        PlacedMesh(i + 1, _mesh(file) if file.diagonal_m is None else _scaled(file), pose)
        for i, (file, pose) in enumerate(placed.values())
    ]
    found = compose(_renderer(), camera, drawn)
    table = np.array([*ids, BACKGROUND], np.uint8)
    return found.depth, table[found.index]


@lru_cache(maxsize=256)
def _mesh(file: MeshFile) -> Any:
    from std_toolkit.geometry.mesh import load_mesh
    from std_toolkit.rendering.mesh import prepare_mesh

    return prepare_mesh(load_mesh(file.path, unit=file.unit, corners=False))


def _scaled(file: MeshFile) -> Any:
    """A mesh whose size differs from frame to frame: only its file is kept."""
    from std_toolkit.rendering.mesh import prepare_mesh

    mesh = replace(file, diagonal_m=1.0).load().copy()
    return prepare_mesh(mesh.apply_scale(file.diagonal_m))


@lru_cache(maxsize=1)
def _renderer() -> Any:
    from std_toolkit.rendering.raycast import RaycastRenderer

    return RaycastRenderer()
