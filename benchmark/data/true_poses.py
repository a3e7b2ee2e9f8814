"""True poses of a frame's objects; box sides of CAD models; visible handles of mugs.

If a data set has exact poses (scenes of this toolkit), these are used. Otherwise the pose is the
least-squares fit of the true coordinates to the true depth of all pixels of an object, as in the
paper's evaluation. For 803 objects in simulated frames with known poses, the largest error of that
fit is 0.8 degrees and 0.8 mm, the typical error 0.02, with 8-bit coordinates. Box sides are those
of the CAD model if it exists, otherwise they are estimated from the visible part of the object.

The rotation of a mug about y is ambiguous if its handle is hidden. The axis of a mug is y; its body
is round, and its diameter is the width of the mug across the handle.

In the layouts of DREDS and STD, `cad_model/[PART/]CLASS/INSTANCE/bbox.txt` next to the scenes or up
to three folders above has the corners of the bounding box of a model in two rows. The handle of a
mug is found in `model.obj` next to it.
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

# Points farther from the axis than this factor times the radius of the body are on the handle.
_BEYOND = 1.1

# Smallest ratio of length to width of a mug with a protruding handle.
_LEAST_LENGTH = 1.1

# Largest fraction of the surface of a mug outside its body; with more, the body is on the other
# side.
_LARGEST_SHARE = 0.3

# Fewer handle pixels may be a rim that is rendered half a pixel too wide.
LEAST_HANDLE_PIXELS = 10

Floats = NDArray[np.float64]

# Objects with fewer pixels with true depth have no determinable pose and are not scored.
LEAST_PIXELS = 30

FOLDER = "cad_model"

FILE, MESH = "bbox.txt", "model.obj"

_LEVELS_ABOVE = 4


@dataclass(frozen=True)
class MugHandle:
    """The body of a mug, in normalised coordinates with the centre of the box at 0.

    Attributes:
        axis: 0 or 2, the axis along which the handle protrudes.
        centre: centre of the body along that axis.
        radius: radius of the body.
    """

    axis: int
    centre: float
    radius: float

    def pixels(self, coordinates: NDArray[np.floating]) -> int:
        """Return how many of the coordinates (N, 3) are on the handle."""
        return int((_distance(coordinates, self.axis, self.centre) > _BEYOND * self.radius).sum())

    def is_visible(self, coordinates: NDArray[np.floating]) -> bool:
        """Whether the coordinates (N, 3) of a mug's pixels show its handle."""
        return self.pixels(coordinates) >= LEAST_HANDLE_PIXELS


def find_handle(points: NDArray[np.floating], areas: NDArray[np.floating]) -> MugHandle | None:
    """Find the handle of a mug.

    Args:
        points: (N, 3) on its surface, in normalised coordinates with the centre of the box at 0.
        areas: (N,) surface areas represented by the points.

    Returns:
        The handle; None if nothing protrudes from a round body.
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
    """(N,) distances from the axis of the body."""
    return np.hypot(points[:, axis] - centre, points[:, 2 - axis]).astype(np.float64)


@dataclass(frozen=True, eq=False)
class KnownBox:
    """Information of a data set on an object besides its maps.

    Attributes:
        sides: (3,) sides of its bounding box in normalised coordinates, with norm 1.
        RT: (4, 4) its exact pose, including the diagonal in metres as scale; None if unknown.
        handle: handle of a mug whose mesh exists.
        handle_visible: whether it is visible, as the set states it; None if it does not.
    """

    sides: Floats
    RT: Floats | None = None
    handle: MugHandle | None = None
    handle_visible: bool | None = None


@runtime_checkable
class BoxSource(Protocol):
    """A source with information on its objects besides their maps."""

    def known_boxes(self, index: int) -> dict[int, KnownBox]:
        """Return the boxes of the objects of a frame, by mask id, without unknown objects.

        Raises:
            ToolkitError: a file with them is damaged.
        """
        ...


@dataclass(frozen=True, eq=False)
class TruePose:
    """An object of a frame.

    Attributes:
        instance: the instance.
        RT: (4, 4) object to camera; its scale is the diagonal of the box in metres.
        size: (3,) sides of its box before RT, with norm 1.
        pixels: number of pixels with true depth.
        handle_visible: whether the handle of a mug is visible; true for all other objects, and for
            mugs without a mesh.
        box_known: whether `size` is that of the CAD model.
    """

    instance: Instance
    RT: Floats
    size: Floats
    pixels: int
    handle_visible: bool = True
    box_known: bool = True


def known_boxes(source: DepthSource, index: int) -> dict[int, KnownBox]:
    """Return the known boxes of a frame; empty for sources without boxes.

    Raises:
        ToolkitError: a file with them is damaged.
    """
    return source.known_boxes(index) if isinstance(source, BoxSource) else {}


def true_poses(frame: DepthFrame, boxes: Mapping[int, KnownBox]) -> list[TruePose]:
    """Return the visible objects of a frame that belong to a class.

    Args:
        frame: frame with NOCS.
        boxes: known boxes, by mask id.

    Returns:
        The objects in the order of `frame.instances`, without those that have fewer than
        `LEAST_PIXELS` pixels or whose pixels do not determine a pose.

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
            stated = None if known is None else known.handle_visible
            if stated is None:
                stated = handle is None or handle.is_visible(coordinates)
            found.append(
                TruePose(
                    instance, RT, sides / diagonal, pixels, stated, box_known=known is not None
                )
            )
    return found


def model_sides(scene: Path, class_folder: str, instance_folder: str) -> NDArray[np.float64] | None:
    """Return the sides (3,) of a model's bounding box, with norm 1; None if it does not exist.

    Args:
        scene: folder of the scene.
        class_folder, instance_folder: names in the meta file of the scene.

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
    """Return the handle of a mug; None if the model does not exist or has no handle.

    Args:
        scene: folder of the scene.
        class_folder, instance_folder: names in the meta file of the scene.

    Raises:
        ToolkitError: a damaged mesh.
    """
    for place in _places(scene.resolve()):
        path = place / class_folder / instance_folder / MESH
        if path.is_file():
            return _read_handle(path)
    return None


def model_files(scene: Path, class_folder: str, instance_folder: str) -> list[Path]:
    """Return the files that `model_sides` and `model_handle` read."""
    places = [p / class_folder / instance_folder for p in _places(scene.resolve())]
    found = (
        next((p / name for p in places if (p / name).is_file()), None) for name in (FILE, MESH)
    )
    return [path for path in found if path is not None]


def mesh_handle(mesh: trimesh.Trimesh) -> MugHandle | None:
    """Find the handle of a mug in its mesh, of any unit."""
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
