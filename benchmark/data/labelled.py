"""Labels of a data set as an audit reads them: poses, meshes and cameras; images on demand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import Material as Kind
from benchmark.data.splits import FrameKey
from std_toolkit.geometry import SE3, Camera
from std_toolkit.scene.model import Material, SymmetryModel

if TYPE_CHECKING:
    import trimesh

MATERIALS: dict[Kind, Material] = {
    Kind.RAW: "raw",
    Kind.DIFFUSE: "diffuse",
    Kind.TRANSPARENT: "transparent",
    Kind.SPECULAR: "specular",
}
NO_SYMMETRY = SymmetryModel()
_MESHES = (".obj", ".ply", ".glb", ".stl")


@dataclass(frozen=True)
class MeshFile:
    """A mesh of a data set.

    Attributes:
        path: of the file.
        unit: of its numbers.
        diagonal_m: of the bounding box in metres, for a mesh that is centred and scaled to it.
        mirrored: whether z is then flipped.
    """

    path: Path
    unit: str = "m"
    diagonal_m: float | None = None
    mirrored: bool = False

    def load(self) -> trimesh.Trimesh:
        """The mesh in metres, in the frame of the labels.

        Raises:
            ToolkitError: missing or damaged.
        """
        return _load(self)


@lru_cache(maxsize=64)
def _load(file: MeshFile) -> trimesh.Trimesh:
    from std_toolkit.geometry.mesh import load_mesh, nocs_frame

    mesh = load_mesh(file.path, unit=file.unit, any_size=file.diagonal_m is not None)
    if file.diagonal_m is not None:
        centre, diagonal = nocs_frame(mesh)
        mesh.vertices = (np.asarray(mesh.vertices) - centre) * (file.diagonal_m / diagonal)
    if file.mirrored:
        mesh.vertices = np.asarray(mesh.vertices) * (1, 1, -1)
        mesh.invert()  # keeps the outside out
    return mesh


@dataclass(frozen=True)
class LabelledObject:
    """One label of one frame.

    Attributes:
        name: unique within its scene, the same in all its frames.
        model: name of the CAD model.
        mesh: of the model; None where the set has none.
        T_cam_obj: the label, metres, OpenCV's axes.
        material: of the object.
        symmetry: of the model, as far as the set states it.
        rotation_off: largest entry of `R R^T - I` of the rotation as filed.
    """

    name: str
    model: str
    mesh: MeshFile | None
    T_cam_obj: SE3
    material: Material
    symmetry: SymmetryModel = NO_SYMMETRY
    rotation_off: float = 0.0


@dataclass(frozen=True)
class LabelledFrame:
    """The labels of a frame.

    Attributes:
        index: of the frame in its set.
        key: of the frame.
        objects: its labels.
        T_world_cam: pose of the camera in metres, where the set has it.
        has_images: whether there is a colour image.
    """

    index: int
    key: FrameKey
    objects: tuple[LabelledObject, ...]
    T_world_cam: SE3 | None = None
    has_images: bool = True


@dataclass(frozen=True)
class FrameImages:
    """The images of a frame.

    Attributes:
        camera: of both.
        color: (H, W, 3) uint8 RGB.
        depth: (H, W) float32 metres of the sensor, 0 = none; None without a sensor's depth.
    """

    camera: Camera
    color: NDArray[np.uint8]
    depth: NDArray[np.float32] | None


class LabelledSet(Protocol):
    """Labels of a data set. Sets can be pickled and sent to worker processes."""

    def keys(self) -> list[FrameKey]:
        """Return the keys of all frames, in order."""
        ...

    def labels(self, index: int) -> LabelledFrame:
        """Read the labels of a frame.

        Raises:
            ToolkitError: a file is missing or damaged.
        """
        ...

    def images(self, index: int) -> FrameImages:
        """Read the images of a frame.

        Raises:
            ToolkitError: a file is missing or damaged.
        """
        ...


def named_mesh(folder: Path, names: Sequence[str]) -> Path | None:
    """The mesh of a model by one of its names: NAME.ply, or NAME/NAME.obj and the like."""
    for name in names:
        for suffix in _MESHES:
            for place in (folder / f"{name}{suffix}", folder / name / f"{name}{suffix}",
                          folder / name / f"textured{suffix}"):  # fmt: skip
                if place.is_file():
                    return place
    return None
