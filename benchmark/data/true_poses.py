"""True poses of a frame's objects; box sides of CAD models; visible handles of mugs.

Where a data set tells exact poses (scenes of this toolkit), these; else, as the paper's evaluation
has it, the least-squares fit of the true coordinates to the true depth of all pixels of an object.
Of 803 objects in simulated frames whose poses are known, that fit is off by 0.8 degrees and 0.8 mm
at worst, by 0.02 as a rule, in spite of coordinates in 8 bits. Box sides are those of the CAD model
where it is there, else what can be seen of the object tells them.

Where a mug's handle is, and whether a frame shows it.

A mug whose handle is hidden looks the same from all sides: nobody can tell its turn about y. A mug
stands on y; its body is round, and as wide as the mug is across the handle.

Box sides of the CAD models that lie beside scenes in the layouts of DREDS and STD.

`cad_model/[PART/]CLASS/INSTANCE/bbox.txt` beside the scenes or up to three folders above; its two
rows are the corners of the model's bounding box. `model.obj` beside it tells where a mug's handle
is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import OTHER, DepthFrame, Instance
from benchmark.data.splits import DepthSource
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import umeyama, unproject_depth

if TYPE_CHECKING:
    import trimesh

# So much farther from the body's axis than the body is wide, a point belongs to the handle.
_BEYOND = 1.1

# A mug that is not longer than wide by so much has no handle, or one that sticks out nowhere.
_LEAST_LENGTH = 1.1

# Of the surface of a mug; more of it outside the body means that the body is at the other side.
_LARGEST_SHARE = 0.3

# So few pixels of a handle may be a rim that the renderer drew half a pixel too wide.
LEAST_HANDLE_PIXELS = 10

Floats = NDArray[np.float64]

# Of less than so many pixels with true depth nobody knows the pose, and nobody is asked for it.
LEAST_PIXELS = 30

FOLDER = "cad_model"

FILE, MESH = "bbox.txt", "model.obj"

_LEVELS_ABOVE = 4


@dataclass(frozen=True)
class MugHandle:
    """The body of a mug, in normalised coordinates with the middle of the box at 0.

    Attributes:
        axis: 0 or 2, along which the handle sticks out.
        centre: of the body along that axis.
        radius: of the body.
    """

    axis: int
    centre: float
    radius: float

    def pixels(self, coordinates: NDArray[np.floating]) -> int:
        """How many of the coordinates (N, 3) are of the handle."""
        return int((_distance(coordinates, self.axis, self.centre) > _BEYOND * self.radius).sum())

    def is_visible(self, coordinates: NDArray[np.floating]) -> bool:
        """Whether the coordinates (N, 3) of a mug's pixels show its handle."""
        return self.pixels(coordinates) >= LEAST_HANDLE_PIXELS


def find_handle(points: NDArray[np.floating], areas: NDArray[np.floating]) -> MugHandle | None:
    """The handle of a mug.

    Args:
        points: (N, 3) on its surface, in normalised coordinates with the middle of the box at 0.
        areas: (N,) of the surface that each stands for.

    Returns:
        None where nothing sticks out of a round body.
    """
    p, a = np.asarray(points, np.float64), np.asarray(areas, np.float64)
    half = np.abs(p).max(axis=0)
    axis = 0 if half[0] > half[2] else 2
    radius = float(half[2 - axis])
    if not half[axis] > _LEAST_LENGTH * radius > 0:
        return None
    offset = float(half[axis] - radius)
    shares = {
        centre: a[_distance(p, axis, centre) > _BEYOND * radius].sum() / a.sum()
        for centre in (-offset, offset)
    }
    centre = min(shares, key=lambda c: shares[c])
    if not 0 < shares[centre] < _LARGEST_SHARE:
        return None
    return MugHandle(axis, centre, radius)


def _distance(points: NDArray[np.floating], axis: int, centre: float) -> Floats:
    """(N,) from the body's axis."""
    return np.hypot(points[:, axis] - centre, points[:, 2 - axis]).astype(np.float64)


@dataclass(frozen=True, eq=False)
class KnownBox:
    """What a data set knows of an object besides its maps.

    Attributes:
        sides: (3,) of its bounding box in normalised coordinates, of length 1 together.
        RT: (4, 4) its exact pose, the diagonal in metres inside; None where nobody tells.
        handle: of a mug whose mesh is there.
    """

    sides: Floats
    RT: Floats | None = None
    handle: MugHandle | None = None


@runtime_checkable
class BoxSource(Protocol):
    """A source that knows more of its objects than their maps."""

    def known_boxes(self, index: int) -> dict[int, KnownBox]:
        """Boxes of the objects of a frame, by mask id; objects nothing is known of are missing.

        Raises:
            ToolkitError: a file that tells them is damaged.
        """
        ...


@dataclass(frozen=True, eq=False)
class TruePose:
    """An object of a frame.

    Attributes:
        instance: which it is.
        RT: (4, 4) object to camera; the scale inside is the diagonal of its box in metres.
        size: (3,) of its box before RT, of length 1.
        pixels: with true depth.
        handle_visible: whether the handle of a mug can be seen; true of everything else, and of
            mugs whose mesh is not there.
        box_known: whether `size` is that of the CAD model.
    """

    instance: Instance
    RT: Floats
    size: Floats
    pixels: int
    handle_visible: bool = True
    box_known: bool = True


def known_boxes(source: DepthSource, index: int) -> dict[int, KnownBox]:
    """What a source knows of the boxes of a frame; nothing for one that knows nothing.

    Raises:
        ToolkitError: a file that tells them is damaged.
    """
    return source.known_boxes(index) if isinstance(source, BoxSource) else {}


def true_poses(frame: DepthFrame, boxes: Mapping[int, KnownBox]) -> list[TruePose]:
    """The objects of a frame that belong to a class and can be seen.

    Args:
        frame: with NOCS.
        boxes: what the data set knows, by mask id.

    Returns:
        The objects in the order of `frame.instances`, without those that have fewer than
        `LEAST_PIXELS` pixels or whose pixels determine no pose.

    Raises:
        ToolkitError: the frame has no NOCS.
    """
    if frame.nocs is None:
        raise ToolkitError(
            "the frame has no normalised coordinates, hence no true poses",
            path=frame.key,
            hint="pose needs a category-known split with *_coord.png, or rendered scenes",
        )
    points = unproject_depth(frame.depth_true, frame.camera)
    found = []
    for instance in frame.instances:
        chosen = (frame.mask == instance.mask_id) & (frame.depth_true > 0)
        pixels = int(chosen.sum())
        if instance.class_id == OTHER or pixels < LEAST_PIXELS:
            continue
        coordinates = frame.nocs[chosen].astype(np.float64) - 0.5
        known = boxes.get(instance.mask_id)
        seen = 2 * np.abs(coordinates).max(axis=0)
        sides = seen if known is None else known.sides
        diagonal = float(np.linalg.norm(sides))
        if known is not None and known.RT is not None:
            RT = known.RT
        else:
            try:
                RT = umeyama(coordinates, points[chosen]).matrix()
            except ToolkitError:
                continue
            RT[:3, :3] *= diagonal
        if np.linalg.det(RT[:3, :3]) > 0:
            handle = None if known is None else known.handle
            shown = handle is None or handle.is_visible(coordinates)
            found.append(
                TruePose(instance, RT, sides / diagonal, pixels, shown, box_known=known is not None)
            )
    return found


def model_sides(scene: Path, class_folder: str, instance_folder: str) -> NDArray[np.float64] | None:
    """Sides (3,) of a model's bounding box, of length 1 together; None where it is not there.

    Args:
        scene: folder of the scene.
        class_folder, instance_folder: as the scene's meta file names them.

    Raises:
        ToolkitError: a damaged file.
    """
    for place in _places(scene.resolve()):
        path = place / class_folder / instance_folder / FILE
        sides = _read(path)
        if sides is not None:
            return sides
    return None


def model_handle(scene: Path, class_folder: str, instance_folder: str) -> MugHandle | None:
    """Where the handle of a mug is; None where the model is not there, or has none.

    Args:
        scene: folder of the scene.
        class_folder, instance_folder: as the scene's meta file names them.

    Raises:
        ToolkitError: a damaged mesh.
    """
    for place in _places(scene.resolve()):
        path = place / class_folder / instance_folder / MESH
        if path.is_file():
            return _read_handle(path)
    return None


def mesh_handle(mesh: trimesh.Trimesh) -> MugHandle | None:
    """Where the handle of a mug is, from its mesh of any unit."""
    from std_toolkit.geometry.mesh import nocs_frame

    centre, diagonal = nocs_frame(mesh)
    return find_handle((mesh.triangles_center - centre) / diagonal, mesh.area_faces)


@lru_cache(maxsize=4096)
def _read_handle(path: Path) -> MugHandle | None:
    from std_toolkit.geometry.mesh import load_mesh

    return mesh_handle(load_mesh(path))


@lru_cache(maxsize=4096)
def _read(path: Path) -> NDArray[np.float64] | None:
    if not path.is_file():
        return None
    try:
        corners = np.loadtxt(path, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise ToolkitError("cannot read the box", path=path) from error
    if corners.shape != (2, 3) or not np.isfinite(corners).all():
        raise ToolkitError("a box is two rows of three numbers", path=path, value=corners.shape)
    sides = np.abs(corners[0] - corners[1])
    length = float(np.linalg.norm(sides))
    if not length > 0:
        raise ToolkitError("the box has no extent", path=path)
    return sides / length


@cache
def _places(scene: Path) -> tuple[Path, ...]:
    found: list[Path] = []
    for above in list(scene.parents)[:_LEVELS_ABOVE]:
        top = above / FOLDER
        if top.is_dir():
            found += [top, *sorted(p for p in top.iterdir() if p.is_dir())]
    return tuple(found)
