"""Force closure: contacts on a mesh, the friction that they need, and surface points."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.metrics.grasp.grasp import Grasps
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster

Floats = NDArray[np.float64]

FRICTIONS = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2)

NO_CLOSURE = -1.0

# Of a coefficient: a face at exactly the angle of friction holds, whatever float32 makes of it.
_ROUNDING = 1e-4


def even_points(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], spacing: float
) -> NDArray[np.float64]:
    """Points of a surface, evenly spaced; the same mesh gives the same points.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3).
        spacing: metres between neighbours, about.

    Returns:
        (n, 3) metres.

    >>> square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    >>> even_points(square, np.array([[0, 1, 2], [0, 2, 3]]), 0.25).shape
    (16, 3)
    """
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    count = max(64, round(6 * float(mesh.area) / spacing**2))
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=0)
    # One of each cube: the one nearest to its middle, so that they keep apart.
    cubes = np.floor(np.asarray(points) / spacing)
    apart = np.linalg.norm(points - (cubes + 0.5) * spacing, axis=1)
    order = np.argsort(apart, kind="stable")
    first = np.unique(cubes[order], axis=0, return_index=True)[1]
    return np.asarray(points)[order[first]]


@dataclass(frozen=True, eq=False)
class Contacts:
    """Where the fingers of N grasps meet the object when they close.

    Attributes:
        found: (N,) bool both fingers meet it.
        points: (N, 2, 3) metres, of the finger at -y and the one at +y; 0 where not found.
        normals: (N, 2, 3) unit normals of the mesh there; 0 where not found.
    """

    found: NDArray[np.bool_]
    points: Floats
    normals: Floats


class GraspedMesh:
    """A mesh that fingers close on.

    Args:
        vertices: (V, 3) metres, in the frame of the grasps.
        faces: (F, 3). Which way they are turned matters only where they enclose a volume: a finger
            that would have to come out of it finds no contact.

    Raises:
        ToolkitError: no faces.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        import trimesh

        f = np.ascontiguousarray(faces, dtype=np.uint32)
        if f.ndim != 2 or not len(f):
            raise ToolkitError("the mesh holds no faces", value=f.shape)
        self._caster = RayCaster(vertices, f, threads=1)
        corners = np.asarray(vertices, dtype=np.float64)[np.asarray(faces)]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
        self._solid = bool(trimesh.Trimesh(vertices, f, process=False).is_volume)

    def contacts(self, grasps: Grasps) -> Contacts:
        """Close the fingers along the line between their tips until they touch.

        As in GraspNet's evaluation each fingertip is a point that moves to the middle between
        both at most.

        Args:
            grasps: in the frame of the mesh.
        """
        return self.contacts_of(grasps.tips, grasps.closings, grasps.widths)

    def contacts_of(self, tips: Floats, closings: Floats, widths: Floats) -> Contacts:
        """As `contacts`, of fingers given by middle (N, 3), direction (N, 3) and opening (N,)."""
        half = np.asarray(widths, dtype=np.float64)[:, None] / 2
        directions = np.stack([closings, -closings], axis=1)
        starts = tips[:, None] - half[:, None] * directions
        hits = self._caster.cast(np.concatenate([starts, directions], axis=-1))
        distance = hits.distance.astype(np.float64)
        met = distance <= half
        normals = self._normals[np.where(met, hits.face, 0)]
        if self._solid:
            met &= np.einsum("nki,nki->nk", normals, directions) < 0
        found = np.asarray(met.all(axis=1))
        reach = np.where(found[:, None], distance, 0)
        points = starts + reach[..., None] * directions
        nothing = ~found[:, None, None]
        return Contacts(found, np.where(nothing, 0, points), np.where(nothing, 0, normals))

    def friction_scores(self, grasps: Grasps) -> Floats:
        """(N,) smallest friction of 0.2, 0.4, ... 1.2 at which each grasp holds, -1 if none."""
        return friction_scores(self.contacts(grasps))


def needed_friction(contacts: Contacts) -> Floats:
    """Smallest coefficient of friction at which two contacts are in force closure.

    Two contacts with friction hold an object if the line between them lies in both friction cones
    (Nguyen 1988): the coefficient is the tangent of the larger angle between the line and a
    normal. The sign of the normals is ignored.

    Args:
        contacts: of N grasps.

    Returns:
        (N,) coefficients; infinite where the fingers meet nothing, or both one point.

    >>> facing = np.array([[[0, -1.0, 0], [0, 1.0, 0]]])
    >>> tilted = np.array([[[0, -1.0, 0], [0, 1.0, 1.0]]]) / np.array([1, 2**0.5])[:, None]
    >>> needed_friction(Contacts(np.array([True]), 0.02 * facing, tilted)).round(6).tolist()
    [1.0]
    """
    line = contacts.points[:, 1] - contacts.points[:, 0]
    along = np.abs(np.einsum("nki,ni->nk", contacts.normals, line))
    across = np.linalg.norm(np.cross(contacts.normals, line[:, None]), axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        friction = (across / along).max(axis=1)
    lost = ~contacts.found | ~(np.linalg.norm(line, axis=1) > 0) | np.isnan(friction)
    return np.where(lost, np.inf, friction)


def friction_scores(contacts: Contacts, frictions: tuple[float, ...] = FRICTIONS) -> Floats:
    """Smallest of some coefficients of friction that holds.

    Args:
        contacts: of N grasps.
        frictions: coefficients in rising order.

    Returns:
        (N,) one of `frictions`, -1 where none holds.

    >>> facing = np.array([[[0, -1.0, 0], [0, 1.0, 0]]])
    >>> box = Contacts(np.array([True]), 0.02 * facing, facing)
    >>> friction_scores(box).tolist()
    [0.2]
    """
    steps = np.append(np.asarray(frictions, dtype=np.float64), NO_CLOSURE)
    return steps[np.searchsorted(steps[:-1] + _ROUNDING, needed_friction(contacts))]
