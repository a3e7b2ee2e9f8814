"""GraspNet's average precision: do a planner's best grasps hold, and hit nothing?"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.metrics.grasp import collision, force_closure, grasp, gripper, sdf_contacts
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3

Floats = NDArray[np.float64]

# Where fingers meet an object: on its mesh, or as in graspnetAPI, see `sdf_contacts`.
ContactKind = Literal["exact", "sdf"]

TOP = 50
PER_OBJECT = 10
VOXEL_M = 0.008
_SPACING_M = 0.004
# Points of the scene farther from an object's bounding box than this are ignored.
_AROUND_M = 0.05
LEAST_BETWEEN = 10


@dataclass(frozen=True, eq=False)
class JudgedObject:
    """An object that grasps are judged on.

    Attributes:
        vertices, faces: (V, 3) metres and (F, 3) of its mesh.
        points: (P, 3) of its surface, in the mesh's frame; the vertices of a finely meshed model
            are such points.
    """

    vertices: Floats
    faces: NDArray[np.int64]
    points: Floats

    @classmethod
    def of_mesh(cls, vertices: Floats, faces: NDArray[np.int64]) -> JudgedObject:
        """An object of any mesh, with points 4 mm apart."""
        return cls(vertices, faces, force_closure.even_points(vertices, faces, _SPACING_M))

    @cached_property
    def thinned(self) -> Floats:
        """The points, one for each cell of 8 mm."""
        return collision.voxel_means(self.points, VOXEL_M)

    @cached_property
    def mesh(self) -> force_closure.GraspedMesh:
        """What fingers close on."""
        return force_closure.GraspedMesh(self.vertices, self.faces)

    @cached_property
    def sdf(self) -> sdf_contacts.SdfMesh:
        """The same as graspnetAPI has it."""
        return sdf_contacts.SdfMesh(self.vertices, self.faces)


@dataclass(frozen=True, eq=False)
class Judged:
    """Results of the counted grasps of one image, best first.

    Attributes:
        grasps: (N) those, in the frame of the camera; `object_ids` is the place of the object in
            the list.
        collided: (N,) bool they hit the scene.
        empty: (N,) bool there is nothing between the fingers.
        friction: (N,) at which they hold, -1 for none, a collision or an empty grasp.
    """

    grasps: grasp.Grasps
    collided: NDArray[np.bool_]
    empty: NDArray[np.bool_]
    friction: Floats


def judge_grasps(
    grasps: grasp.Grasps,
    objects: Sequence[JudgedObject],
    poses: Sequence[SE3],
    T_cam_table: SE3 | None = None,
    *,
    contacts: ContactKind = "exact",
) -> Judged:
    """Judge a planner's grasps of an image as GraspNet does.

    Widths are cut to [0, 0.1]. Of grasps nearer than 3 cm and 30 degrees the best stays. Each goes
    to the object whose point is nearest, which keeps its best ten; of all, the best fifty stay. A
    grasp fails if a point of the scene is inside the hand, if fewer than ten are between its
    fingers, or if the fingers do not hold the object with a friction of 1.2.

    Args:
        grasps: in the camera's frame.
        objects: of the scene.
        poses: T_cam_obj of each.
        T_cam_table: the table, z = 0; None where there is none.
        contacts: `sdf` gives the figures of graspnetAPI, with its quantised normals and the flat
            faces that it misses.

    Returns:
        The grasps that count, best first, and what became of each.

    Raises:
        ToolkitError: no objects, or another number of poses.

    >>> import trimesh
    >>> from benchmark.metrics.grasp.grasp import Grasps
    >>> box = trimesh.creation.box((0.04, 0.04, 0.04))
    >>> target = JudgedObject.of_mesh(np.asarray(box.vertices), np.asarray(box.faces))
    >>> grasps = Grasps.make(np.eye(3)[None], [[0, 0, 0]], widths=0.06, depths=0.02)
    >>> judge_grasps(grasps, [target], [SE3.identity()]).friction.tolist()
    [0.2]
    """
    if not objects or len(objects) != len(poses):
        raise ToolkitError("needs objects and a pose for each", value=(len(objects), len(poses)))
    counted = _counted(grasps, objects, poses)
    clouds = [T @ o.thinned for o, T in zip(objects, poses, strict=True)]
    things = np.concatenate(clouds)
    count = len(counted)
    collided, empty = np.zeros(count, bool), np.zeros(count, bool)
    friction = np.full(count, force_closure.NO_CLOSURE)
    for number, (obj, T, cloud) in enumerate(zip(objects, poses, clouds, strict=True)):
        mine = np.flatnonzero(counted.object_ids == number)
        if not len(mine):
            continue
        low, high = cloud.min(axis=0) - _AROUND_M, cloud.max(axis=0) + _AROUND_M
        scene = [things] if T_cam_table is None else [things, _table_around(T_cam_table, low, high)]
        near = collision.Cloud(np.concatenate([_between(part, low, high) for part in scene]))
        its = counted[mine]
        collided[mine] = near.hit_by(its, gripper.GRASPNET)
        empty[mine] = near.count_between(its, gripper.GRASPNET) < LEAST_BETWEEN
        mesh = obj.sdf if contacts == "sdf" else obj.mesh
        free = mine[~(collided | empty)[mine]]
        friction[free] = mesh.friction_scores(counted[free].transformed(T.inverse()))
    return Judged(counted, collided, empty, friction)


def _counted(
    grasps: grasp.Grasps, objects: Sequence[JudgedObject], poses: Sequence[SE3]
) -> grasp.Grasps:
    """Those that count, best first, with the place of their object."""
    from scipy.spatial import cKDTree

    cut = grasps.replaced(widths=np.clip(grasps.widths, 0, gripper.GRASPNET.max_width))
    kept = grasp.suppress_similar(cut)
    if not len(kept):
        return kept
    clouds = [T @ o.thinned for o, T in zip(objects, poses, strict=True)]
    owner = np.repeat(np.arange(len(clouds)), [len(c) for c in clouds])
    nearest = owner[cKDTree(np.concatenate(clouds)).query(kept.translations)[1]]
    # Best first already: the rank within an object is how many of its own came before.
    rank = np.array([(nearest[:i] == n).sum() for i, n in enumerate(nearest)])
    best = kept.replaced(object_ids=nearest)[rank < PER_OBJECT]
    if len(best) > TOP:
        best = best[best.scores >= best.scores[TOP - 1]]
    return best


def _between(points: Floats, low: Floats, high: Floats) -> Floats:
    for axis in range(3):
        along = points[:, axis]
        points = points[(along > low[axis]) & (along < high[axis])]
    return points


# Places of the points of the table: 1 m x 1 m x 5 cm, 8 mm apart, its top at z = 0.
_TABLE = np.linspace(-0.5, 0.5, 125), np.linspace(-0.5, 0.5, 125), np.linspace(-0.05, 0, 6)


def _table_around(T_cam_table: SE3, low: Floats, high: Floats) -> Floats:
    """Points of the table, at least those within a box of the camera's frame."""
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    reach = T_cam_table.inverse() @ corners
    ends = reach.min(axis=0), reach.max(axis=0)
    places = [p[(p > a) & (p < b)] for p, a, b in zip(_TABLE, *ends, strict=True)]
    return T_cam_table @ np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 3)


def precision_at(
    friction: ArrayLike, frictions: Sequence[float] = force_closure.FRICTIONS
) -> Floats:
    """Share of the best 1, 2, ... 50 grasps that hold at each friction.

    Where there are fewer grasps, those that lack count as failures.

    Args:
        friction: (N,) of the grasps, best first, -1 for those that fail.
        frictions: M coefficients.

    Returns:
        (50, M) shares, 0 to 1.

    >>> precision_at([0.4, -1, 0.2], [0.2, 0.4])[:4].round(3).tolist()
    [[0.0, 1.0], [0.0, 0.5], [0.333, 0.667], [0.25, 0.5]]
    """
    best = np.asarray(friction, dtype=np.float64)[:TOP, None]
    holds = np.zeros((TOP, len(frictions)))
    # Frictions come from the same list; the slack is for files that round them.
    holds[: len(best)] = (best > 0) & (best <= np.asarray(frictions) + 1e-6)
    return holds.cumsum(axis=0) / np.arange(1, TOP + 1)[:, None]


@dataclass(frozen=True)
class GraspPrecision:
    """GraspNet's three figures, in percent.

    Attributes:
        ap: mean over frictions 0.2 to 1.2.
        ap08, ap04: at friction 0.8 and 0.4.
        frames: images that they are means of.
    """

    ap: float
    ap08: float
    ap04: float
    frames: int


def average_precision(tables: Iterable[Floats]) -> GraspPrecision:
    """GraspNet's figures over many images.

    Args:
        tables: (50, 6) of each image, as `precision_at` gives them for `FRICTIONS`.

    Returns:
        Means over the images, in percent.

    Raises:
        ToolkitError: no image.

    >>> all_hold = precision_at(np.full(50, 0.6))
    >>> average_precision([all_hold])
    GraspPrecision(ap=66.66666666666667, ap08=100.0, ap04=0.0, frames=1)
    """
    by_friction = [table.mean(axis=0) for table in tables]
    if not by_friction:
        raise ToolkitError("no image to take the average precision of")
    mean = 100 * np.mean(by_friction, axis=0)
    at = dict(zip(force_closure.FRICTIONS, mean.tolist(), strict=True))
    return GraspPrecision(float(mean.mean()), at[0.8], at[0.4], len(by_friction))
